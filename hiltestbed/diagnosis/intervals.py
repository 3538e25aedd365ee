"""Stage "decide": 95 % intervals with valid coverage: the curvature of chi-square where it is
smooth, widened where the runs disagree.

An interval by the Jacobian alone assumes that the model is exact. Here the covariance is the
sandwich of the runs' gradients (each run, that is each contact, is one independent sample) where
that is wider, and a lower limit allows for another sub-stepping of the same rig. Where the misfits
of neighbouring rows are correlated (a position, the double integral of a force), stretches of a run
are the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from hiltestbed.diagnosis.fit import Bounds, Fit, Trials, effects_at
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.frames import Array

# chosen: of an estimate: half-width that allows for the discretisation of a rig
MIN_RELATIVE_WIDTH = 1e-3
# derived: standard deviations on each side that hold 95 % of a normal distribution
NORMAL_95 = 1.96
CHI2_95 = 3.84  # derived: of chi-square, 95 % of one parameter
FLAT_CURVATURE = 1e-14  # chosen: of the largest curvature
WIDE_STEP = 2e-3  # chosen: of the scale, for derivatives that average over the jumps at whole ticks


@dataclass(frozen=True, eq=False)
class Spread:
    """The uncertainty of the estimates of a fit.

    Attributes:
        ends: (P, 2) lower and upper ends of the 95 % intervals, clipped to the bounds of the
            search.
        normal: (P, P) normal matrix J'J in scaled parameters; an undetermined parameter has the row
            and column of the unit matrix.
        determined: (P,) whether chi-square changes with a parameter at all, nearby. misfit:
            chi-square per sample, at least 1.
    """

    ends: Array
    normal: Array
    determined: np.ndarray
    misfit: float

    @property
    def correlation(self) -> Array:
        """(P, P) correlation of the estimates; NaN for an undetermined parameter."""
        covariance = inverted(self.normal)
        root = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        out = np.clip(covariance / np.outer(root, root), -1.0, 1.0)
        out[~self.determined], out[:, ~self.determined] = np.nan, np.nan
        return out


def inverted(normal: Array) -> Array:
    """Inverse of a normal matrix, regularised against singularity."""
    return np.asarray(
        np.linalg.inv(normal + 1e-12 * np.max(np.diag(normal), initial=0.0) * np.eye(len(normal))),
        dtype=float,
    )


def intervals(residual: Residual, found: Fit) -> Spread:
    """The 95 % intervals of a fit's parameters, with the normal matrix they follow from."""
    causes, theta = found.causes, found.theta
    if len(theta) == 0:
        return Spread(np.zeros((0, 2)), np.zeros((0, 0)), np.zeros(0, bool), 1.0)
    bounds, count = Bounds.of(causes), len(theta)
    normal, middle = np.zeros((count, count)), np.zeros((count, count))
    squares, samples = 0.0, 0
    jacobians = derivatives_by_run(residual, found)
    for r, jacobian in jacobians:
        normal += np.einsum("mi,mj->ij", jacobian, jacobian)
        gradient = np.einsum("mi,m->i", jacobian, r)
        middle += np.outer(gradient, gradient)
        squares += float(np.einsum("m,m->", r, r))
        samples += int(np.count_nonzero(r))
    misfit = max(1.0, squares / max(1, samples))
    determined = np.diag(normal) > FLAT_CURVATURE * max(
        1.0, float(np.max(np.diag(normal)))
    )  # determined: chi-square changes with it, nearby
    normal[~determined], normal[:, ~determined], middle[~determined], middle[:, ~determined] = (
        0.0,
        0.0,
        0.0,
        0.0,
    )
    normal[~determined, ~determined] = 1.0
    inverse = inverted(normal)
    runs = len(residual.runs)
    plain = np.diag(inverse) * misfit
    between = np.diag(inverse @ middle @ inverse) * runs / max(1, runs - 1)
    spread = (
        np.sqrt(np.maximum(np.maximum(plain, stretch_variance(residual, jacobians, inverse)), 0.0))
        * NORMAL_95
    )
    if runs > 2:
        spread = np.maximum(
            spread,
            np.sqrt(np.maximum(between, 0.0)) * min(2.2, float(student.ppf(0.975, runs - 1))),
        )
    half = spread * bounds.scales(theta) + MIN_RELATIVE_WIDTH * np.abs(theta)
    ends = np.column_stack([bounds.clip(theta - half), bounds.clip(theta + half)])
    rough = [c.effect.jumps == name for c in causes for name in c.names]
    for j in np.flatnonzero(np.array(rough) | ~determined):
        profile = [
            _crossing(residual, found, int(j), sign, squares + CHI2_95 * misfit, bound)
            for sign, bound in ((-1.0, bounds.low[j]), (1.0, bounds.high[j]))
        ]
        ends[j] = (
            (profile[0], profile[1])
            if not determined[j]
            else (min(ends[j, 0], profile[0]), max(ends[j, 1], profile[1]))
        )
    return Spread(ends, normal, determined, misfit)


def derivatives_by_run(residual: Residual, found: Fit) -> list[tuple[Array, Array]]:
    """Of each run, the misfits (M,) and their derivatives by the scaled parameters (M, P)."""
    out = []
    for i in residual.runs:
        trials = Trials(residual.on([i]), found.causes)
        r = trials([found.theta])[0]
        out.append((r, trials.slopes(found.theta, r, WIDE_STEP)))
    return out


def stretch_variance(
    residual: Residual, jacobians: Sequence[tuple[Array, Array]], inverse: Array
) -> Array:
    """(P,) variance of scaled parameters by how much stretches of the runs disagree; zeros where
    each row is an independent sample.

    The sandwich of the stretches' gradients; of the link's stretch lengths, the one that gives the
    most. A few stretches give a poor estimate of their own scatter: the variance is that of the
    normal distribution whose 95 % interval equals Student's.
    """
    count = len(inverse)
    out = np.zeros(count)
    for span in residual.link.witnesses:
        middle, stretches = np.zeros((count, count)), 0
        for i, (r, jacobian) in zip(residual.runs, jacobians, strict=True):
            rows = max(1, round(span / residual.link.runs[i].scenario.tick))
            gradients = np.add.reduceat(jacobian * r[:, None], np.arange(0, len(r), rows), axis=0)
            middle += np.einsum("mi,mj->ij", gradients, gradients)
            stretches += len(gradients)
        if stretches > count:
            wider = (float(student.ppf(0.975, stretches - count)) / NORMAL_95) ** 2
            out = np.maximum(
                out, np.diag(inverse @ middle @ inverse) * stretches / (stretches - count) * wider
            )
    return out


def _crossing(
    residual: Residual, found: Fit, j: int, sign: float, most: float, bound: float
) -> float:
    """Where chi-square exceeds `most` as parameter j moves, for one in which it has steps."""
    step = MIN_RELATIVE_WIDTH
    theta = found.theta.copy()
    while step < 1.0:
        theta[j] = found.theta[j] + sign * step * max(abs(found.theta[j]), 1e-12)
        if sign * (theta[j] - bound) >= 0.0:
            return float(bound)
        if square(residual(effects_at(found.causes, theta))) > most:
            return float(theta[j])
        step *= 1.5
    return float(theta[j])
