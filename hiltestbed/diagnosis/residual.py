"""Stage "replay": the residual of a link, in units of its noise, as a function of a hypothesis (a
list of effects).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links import ModelLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.noise import softened
from hiltestbed.diagnosis.nuisances import Aside
from hiltestbed.frames import Array

MAX_RESIDUAL = 1e6  # chosen: [sigma] stands for a prediction that is not finite


class Residual:
    """Measured less predicted, over the noise. It is immutable: other runs give another
    `Residual`.

    Attributes:
        link: that is replayed. runs: indices of the runs that count.
        weight: (N, C) of each run of the link, one over the noise, 0 where not measured.
    """

    def __init__(self, link: ModelLink, runs: Sequence[int] | None = None) -> None:
        self.link = link
        self.runs = tuple(range(len(link.runs)) if runs is None else runs)
        self.weight = tuple([r.weight for r in link.runs])
        self._aside: dict[int, Aside] = {}

    def on(self, runs: Sequence[int]) -> Residual:
        """On a subset of the runs."""
        return Residual(self.link, runs)

    def by_run(self, hypotheses: Sequence[Effects]) -> list[list[Array]]:
        """(N, C) for each hypothesis and run; clipped to MAX_RESIDUAL where a prediction is not
        finite, so that misfits can be sorted.
        """
        shown = self.link.predict([(i, effects) for effects in hypotheses for i in self.runs])
        out, at = [], 0
        for _ in hypotheses:
            rows = []
            for i in self.runs:
                r = softened(self.left(i, shown[at]) * self.weight[i], self.link.runs[i].heavy)
                rows.append(
                    r
                    if np.isfinite(r).all()
                    else np.clip(np.nan_to_num(r, nan=MAX_RESIDUAL), -MAX_RESIDUAL, MAX_RESIDUAL)
                )
                at += 1
            out.append(rows)
        return out

    def left(self, i: int, shown: Array) -> Array:
        """(N, C) of run i: measured less ``shown`` (N, C), whitened against its nuisance terms."""
        run = self.link.runs[i]
        left = run.measured - shown
        if run.nuisances is None and run.shared is None:
            return left
        if i not in self._aside:
            self._aside[i] = Aside(self.weight[i], run.nuisances, run.shared)
        return left - self._aside[i].of(left)

    def of_run(self, i: int, effects: Effects) -> Array:
        """(N, C) of run i."""
        return self.on([i]).by_run([effects])[0][0]

    def compared(self, i: int, effects: Effects) -> Array:
        """(M,) of run i, as its owner would compare them: in contact, where there is one."""
        z, counts = self.of_run(i, effects), self.weight[i] > 0.0
        inside = counts & self.link.runs[i].touching[:, None]
        return np.asarray(z[inside if inside.any() else counts])

    def many(self, hypotheses: Sequence[Effects]) -> Array:
        """(H, M) of all runs, one hypothesis a row."""
        return np.stack(
            [np.concatenate([r.ravel() for r in rows]) for rows in self.by_run(hypotheses)]
        )

    def __call__(self, effects: Effects) -> Array:
        """(M,) of all runs."""
        return self.many([effects])[0]


def square(r: Array) -> float:
    """Sum of squares."""
    return float(np.einsum("m,m->", r, r))
