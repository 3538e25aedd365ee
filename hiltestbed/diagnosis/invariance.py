"""Stage "decide": whether the size of a cause is the same in every run, in and out of contact,
early and late.

The size of a cause is a constant of the rig. What stands in for an effect outside the vocabulary
grows or shrinks with the duration of a
run, with the force, with time, as that effect does: a mass that stands in for drag is larger in
longer runs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from hiltestbed.diagnosis.fit import Fit, bounds_of, scales
from hiltestbed.diagnosis.intervals import derivatives_by_run
from hiltestbed.diagnosis.links import LinkRun
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.settings import SMOOTHING_ROWS
from hiltestbed.frames import Array

# chosen: relative change of a size per unit of a condition; of a stand-in about 1, the share of it
# in a size
MIN_VARIATION = 0.25
# calibrated: of what is left, that a varying size explains: 16 causes up to 19 %, five stand-ins 27
# to 90 %, others less
MIN_SHARE = 0.25
# chosen: standard deviation of a condition between rows, below which it does not vary
MIN_CONDITION_SPREAD = 0.03


def varies(residual: Residual, chosen: Fit, index: int, sizes: list[int], neutral: float) -> bool:
    """Whether the size of a cause depends on a condition: a size in proportion to it, beside all
    parameters, explains much of what is left.

    Args:
        chosen: the fit. index: of the cause. sizes: its parameters in `Fit.part` that are its size.
            neutral: their value without it.
    """
    by_run = derivatives_by_run(residual, chosen)
    left, jacobian = (np.concatenate(parts) for parts in zip(*by_run, strict=True))
    low, high, log = bounds_of(chosen.causes)
    place, scale = chosen.place(index), scales(chosen.theta, low, high, log)
    relative = ((chosen.part(index)[sizes] - neutral) / scale[place][sizes])[:, None]
    # of the misfits, by the size relative to itself
    by_size = (jacobian[:, place][:, sizes] @ relative)[:, 0]
    weight = by_size**2
    if not weight.any():
        return False
    basis = np.linalg.qr(jacobian)[0]
    rest = _beside(basis, left)
    for condition in conditions(
        [residual.link.runs[i] for i in residual.runs], [len(r) for r, _ in by_run]
    ):
        offset = condition - np.average(condition, weights=weight)
        if np.sqrt(np.average(offset**2, weights=weight)) < MIN_CONDITION_SPREAD:
            continue
        varied = _beside(basis, by_size * offset)
        square = float(varied @ varied)
        # least squares beside all parameters
        change = -float(varied @ rest) / square if square > 0.0 else 0.0
        if change**2 * square > MIN_SHARE * float(left @ left) and abs(change) > MIN_VARIATION:
            return True
    return False


def conditions(runs: Sequence[LinkRun], rows: Sequence[int]) -> list[Array]:
    """(M,) of each condition at the misfits of runs, of which each has so many as ``rows`` says:
    the logarithms of the duration of the run, of that of its contacts and of its largest reading; 1
    in contact, 0 outside; the time, from 0 to 1; the way of the motion, 1 or -1.
    """
    of_run = [
        [float(np.log(len(r.measured))) for r in runs],
        [float(np.log(max(1, np.count_nonzero(r.touching)))) for r in runs],
        [float(np.log(max(np.abs(r.measured).max(initial=0.0), 1e-300))) for r in runs],
    ]
    of_row = [
        [r.touching.astype(float) for r in runs],
        [np.linspace(0.0, 1.0, len(r.measured)) for r in runs],
        [_way(r.measured) for r in runs],
    ]
    channels = [r.measured.shape[1] for r in runs]
    expanded = [
        np.concatenate([np.repeat(x, c) for x, c in zip(parts, channels, strict=True)])
        for parts in of_row
    ]
    return [np.repeat(values, rows) for values in of_run] + expanded


def _way(measured: Array) -> Array:
    """(N,) sign of the change of the channel that changes most."""
    most = measured[:, int(np.argmax(np.ptp(measured, axis=0)))]
    return np.sign(np.gradient(uniform_filter1d(most, SMOOTHING_ROWS)))


def _beside(basis: Array, column: Array) -> Array:
    """(M,) the part of a column (M,) that is orthogonal to a basis (M, P)."""
    return np.asarray(column - basis @ (basis.T @ column), dtype=np.float64)
