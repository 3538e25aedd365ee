"""Stage "decide": the gain on left-out runs: each run left out of the fit in turn, compared with a
placebo of as many parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, fit
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.result import Heldout

RESAMPLES = 2000  # chosen: draws of the bootstrap over runs


def heldout(residual: Residual, found: Fit, placebo: Fit | None, seed: int = 0) -> Heldout | None:
    """The gain of ``found`` fitted to the other runs; None with one run, or without a cause."""
    runs = residual.runs
    if len(runs) < 2 or not found.causes:
        return None
    judged = residual.as_judged()
    before = {i: mean_square(judged, i, ()) for i in runs}
    after = {i: left_out(residual, i, found, judged) for i in runs}
    wrong = (
        {i: left_out(residual, i, placebo, judged) for i in runs}
        if placebo is not None
        else dict(before)
    )
    return resampled(runs, before, after, wrong, seed)


def resampled(
    runs: Sequence[int],
    before: Mapping[int, float],
    after: Mapping[int, float],
    wrong: Mapping[int, float],
    seed: int = 0,
) -> Heldout:
    """The gain from the mean squares of each run; its interval by bootstrap over runs."""
    a, b, w = (np.array([x[i] for i in runs]) for x in (before, after, wrong))
    draws = np.random.default_rng(seed).integers(0, len(runs), (RESAMPLES, len(runs)))
    gains = 1.0 - np.sqrt(b[draws].sum(axis=1) / a[draws].sum(axis=1))
    low, high = np.percentile(gains, [2.5, 97.5])
    reduction, placebo = (1.0 - _rms(x) / _rms(a) for x in (b, w))
    per_run = {i: (math.sqrt(before[i]), math.sqrt(after[i])) for i in runs}
    ends = (float(low), float(high))
    return Heldout(tuple(runs), _rms(a), _rms(b), reduction, ends, placebo, per_run)


def _rms(squares: np.ndarray) -> float:
    return float(np.sqrt(np.mean(squares)))


def left_out(residual: Residual, i: int, found: Fit, judged: Residual | None = None) -> float:
    """Mean square on run i of ``found`` fitted to the other runs; judged: in place of that form."""
    judged = judged or residual
    others = residual.on([j for j in residual.runs if j != i])
    # jitter changes the variance, not the mean
    smooth = [c for c in found.causes if c.kind != JITTER]
    theta = found.theta[: sum(len(c.names) for c in smooth)]
    if not smooth:
        return mean_square(judged, i, ())
    return mean_square(judged, i, fit(others, smooth, [theta], tries=1).effects())


def mean_square(residual: Residual, i: int, effects: Effects) -> float:
    """Mean square of run i in units of the noise: in contact, where there is one."""
    z = residual.of_run(i, effects)
    counts = residual.weight[i] > 0
    inside = counts & residual.link.runs[i].touching[:, None]
    use = inside if inside.any() else counts
    return float(np.mean(z[use] ** 2)) if use.any() else 0.0


def placebo_of(fits: Sequence[Fit], found: Fit) -> Fit | None:
    """A wrong effect with about as many parameters: the worst fitted, not the next best."""
    own = set(found.kinds)
    count = sum(len(c.names) for c in found.causes)
    wrong = [
        f
        for f in fits
        if f.causes and not own & set(f.kinds) and JITTER not in f.kinds and math.isfinite(f.score)
    ]
    if not wrong:
        return None
    return min(wrong, key=lambda f: (abs(sum(len(c.names) for c in f.causes) - count), -f.score))
