"""Stage "decide": the gain on left-out runs: each run left out of the fit in turn, compared with a
placebo of as many parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Heldout
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import LeftOut
from hiltestbed.inference.likelihood import PosteriorFit

RESAMPLES = 2000  # draws of the bootstrap over runs: its ends are known to a percent of its width


def heldout(e: Explanation, found: PosteriorFit | None = None) -> Heldout | None:
    """The gain of ``found``, by default of the explanation, fitted to the other runs; None with one
    run, or without a cause.
    """
    found = e.fit if found is None else found
    if len(e.model.members) < 2 or not found.causes:
        return None
    held = LeftOut(e.likelihood, e.model.folds())
    before, after = held.rms(e.conclusion.null), held.rms(found)
    placebo = _placebo(e, found)
    wrong = before if placebo is None else held.rms(placebo)
    runs = e.model.members
    return resampled(
        runs, *(dict(zip(runs, (x**2).tolist(), strict=True)) for x in (before, after, wrong))
    )


def resampled(
    runs: Sequence[int],
    before: Mapping[int, float],
    after: Mapping[int, float],
    wrong: Mapping[int, float],
) -> Heldout:
    """The gain from the mean squares of each run; its interval by bootstrap over runs."""
    a, b, w = (np.array([x[i] for i in runs]) for x in (before, after, wrong))
    draws = np.random.default_rng(0).integers(0, len(runs), (RESAMPLES, len(runs)))
    gains = 1.0 - np.sqrt(b[draws].sum(axis=1) / a[draws].sum(axis=1))
    low, high = np.percentile(gains, [2.5, 97.5])
    reduction, placebo = (1.0 - _rms(x) / _rms(a) for x in (b, w))
    per_run = {i: (float(np.sqrt(before[i])), float(np.sqrt(after[i]))) for i in runs}
    ends = (float(low), float(high))
    return Heldout(tuple(runs), _rms(a), _rms(b), reduction, ends, placebo, per_run)


def _rms(squares: Array) -> float:
    return float(np.sqrt(np.mean(squares)))


def mean_square(residual: Residual, i: int, effects: Effects) -> float:
    """Mean square of run i in units of the noise: in contact, where there is one."""
    z = residual.compared(i, effects)
    return float(np.mean(z**2)) if len(z) else 0.0


def _placebo(e: Explanation, found: PosteriorFit) -> PosteriorFit | None:
    """A wrong effect with about as many parameters: the worst fitted, not the next best."""
    own, count = {c.kind for c in found.causes}, len(found.of.theta)
    wrong = [f for f in e.singles() if not own & {c.kind for c in f.causes}]
    return min(wrong, key=lambda f: (abs(len(f.of.theta) - count), f.evidence), default=None)
