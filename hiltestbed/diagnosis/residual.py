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
    """Measured less predicted, over the noise. It is immutable: other weights or runs give another
    `Residual`.

    Attributes:
        link: that is replayed. runs: indices of the runs that count.
        weight: (N, C) of each run of the link, one over the noise, 0 where not measured.
    """

    def __init__(
        self,
        link: ModelLink,
        runs: Sequence[int] | None = None,
        weight: Sequence[Array] | None = None,
    ) -> None:
        self.link = link
        self.runs = tuple(range(len(link.runs)) if runs is None else runs)
        self.weight = tuple([r.weight for r in link.runs] if weight is None else weight)
        self._aside: dict[int, Aside] = {}

    def downweighted(self, effects: Effects) -> Residual:
        """With less weight on what the prediction under ``effects`` leaves open; or itself."""
        doubts = {i: self.link.doubt(i, effects) for i in self.runs}
        scaled = {i: d * self.weight[i] for i, d in doubts.items() if d is not None}
        if not any(np.any(u > 1.0) for u in scaled.values()):
            return self
        weight = [
            w / np.sqrt(1.0 + scaled[i] ** 2) if i in scaled else w
            for i, w in enumerate(self.weight)
        ]
        return Residual(self.link, self.runs, weight)

    def with_noise(self, noise: Array) -> Residual:
        """With additional ``noise`` (C,) in every sample [units of the channels]."""
        return Residual(
            self.link, self.runs, [w / np.sqrt(1.0 + (w * noise) ** 2) for w in self.weight]
        )

    def on(self, runs: Sequence[int]) -> Residual:
        """On a subset of the runs."""
        return Residual(self.link, runs, self.weight)

    def parts(self) -> dict[int, slice]:
        """Of a concatenated residual (M,), each run."""
        sizes = [self.link.runs[i].measured.size for i in self.runs]
        ends = np.cumsum(sizes).tolist()
        return {
            i: slice(end - size, end) for i, size, end in zip(self.runs, sizes, ends, strict=True)
        }

    def through(self, link: ModelLink) -> Residual:
        """Of another interpretation of the link, with the same weights."""
        return Residual(link, self.runs, self.weight)

    def as_judged(self) -> Residual:
        """Of the form of the link on which adequacy is judged, if another one was fitted."""
        return self if self.link.whole is self.link else Residual(self.link.whole, self.runs)

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

    def smoothed_away(self, effects: Effects) -> float:
        """Chi-square that ``effects`` are expected to take off by smoothing the noise of the input
        on record, whether they act or not.

        Least squares with errors in the variables prefer a response that smooths (W. A. Fuller,
        Measurement Error Models, 1987).
        """
        out = 0.0
        for i in self.runs if effects else ():
            believed = self.link.passed_from_input(i, ())
            found = self.link.passed_from_input(i, effects)
            if believed is not None and found is not None:
                out += float(np.sum(self.weight[i] ** 2 * (believed - found)))
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
