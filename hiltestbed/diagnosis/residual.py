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
from hiltestbed.diagnosis.settings import UNKNOWN
from hiltestbed.frames import Array


def finite(residual: Array) -> Array:
    """Clipped to UNKNOWN, which stands for what is no number."""
    return np.clip(np.nan_to_num(residual, nan=UNKNOWN), -UNKNOWN, UNKNOWN)


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
        return Residual(self.link, runs)

    def by_run(self, hypotheses: Sequence[Effects]) -> list[list[Array]]:
        """(N, C) for each hypothesis and run; clipped to UNKNOWN where a prediction is not
        finite, so that misfits can be sorted.
        """
        shown = iter(self.link.predict([(i, effects) for effects in hypotheses for i in self.runs]))
        return [[self._in_sigma(i, next(shown)) for i in self.runs] for _ in hypotheses]

    def _in_sigma(self, i: int, shown: Array) -> Array:
        r = softened(self.left(i, shown) * self.weight[i], self.link.runs[i].heavy)
        return r if np.isfinite(r).all() else finite(r)

    def left(self, i: int, shown: Array) -> Array:
        """(N, C) of run i: measured less ``shown`` (N, C), whitened against its nuisance terms."""
        if i not in self._aside:
            self._aside[i] = Aside(self.weight[i], self.link.runs[i].terms)
        left = self.link.runs[i].measured - shown
        return left - self._aside[i].of(left)

    def of_run(self, i: int, effects: Effects) -> Array:
        """(N, C) of run i."""
        return self.on([i]).by_run([effects])[0][0]

    def counted(self, i: int) -> np.ndarray:
        """(N, C) bool: the samples of run i that its owner would compare: in contact, where there
        is one.
        """
        counts = self.weight[i] > 0.0
        inside = counts & self.link.runs[i].touching[:, None]
        return inside if inside.any() else counts

    def compared(self, i: int, effects: Effects) -> Array:
        """(M,) of run i, as its owner would compare them."""
        return np.asarray(self.of_run(i, effects)[self.counted(i)])

    def mean_square(self, i: int, effects: Effects) -> float:
        """Of run i: in contact, where there is one."""
        z = self.compared(i, effects)
        return float(np.mean(z**2)) if len(z) else 0.0

    def many(self, hypotheses: Sequence[Effects]) -> Array:
        """(H, M) of all runs, one hypothesis a row."""
        return np.stack(
            [np.concatenate([r.ravel() for r in rows]) for rows in self.by_run(hypotheses)]
        )

    def __call__(self, effects: Effects) -> Array:
        """(M,) of all runs."""
        return self.many([effects])[0]


def square(r: Array) -> float:
    return float(np.einsum("m,m->", r, r))
