"""95 % intervals that hold: the curvature of chi-square where it is smooth, widened by what the runs say of one another.

A plain Jacobian interval takes the model for exact. Here the covariance is the sandwich of the runs' own gradients (each run, that is
each contact, is one independent witness) where that is wider, and a floor stands for what another sub-stepping of the same rig does. Where
the misfit of neighbouring rows is one and the same (a position, of which a force is integrated twice), stretches of a run are witnesses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from hiltestbed.diagnosis.fit import Fit, bounds_of, differences, effects_at, scales
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.frames import Array

LEAST = 1e-3  # of an estimate: what is left to how a rig is discretised
NORMAL = 1.96  # standard deviations to each side that hold 95 % of a normal distribution
RISE = 3.84  # of chi-square: 95 % of one parameter
FLAT = 1e-14  # of the largest curvature
WIDE_STEP = 2e-3  # of the scale, for derivatives that average over the jumps at whole ticks


@dataclass(frozen=True, eq=False)
class Spread:
    """How sure the estimates of a fit are.

    Attributes:
        ends: (P, 2) lower and upper ends of the 95 % intervals, clipped to the bounds of the search.
        normal: (P, P) of the residual in scaled parameters, J'J; the row and column of a parameter that nothing is told of are those of the
            unit matrix. told: (P,) chi-square changes with it at all, nearby. misfit: sum of squares a sample, at least 1.
    """

    ends: Array
    normal: Array
    told: np.ndarray
    misfit: float

    @property
    def correlation(self) -> Array:
        """(P, P) of the estimates, by the plain inverse of `normal`; NaN beside a parameter that nothing is told of."""
        covariance = inverted(self.normal)
        root = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        out = np.clip(covariance / np.outer(root, root), -1.0, 1.0)
        out[~self.told], out[:, ~self.told] = np.nan, np.nan
        return out


def inverted(normal: Array) -> Array:
    """Inverse of normal equations, kept from dividing by zero."""
    return np.asarray(np.linalg.inv(normal + 1e-12 * np.max(np.diag(normal)) * np.eye(len(normal))), dtype=float)


def intervals(residual: Residual, found: Fit) -> Spread:
    """The 95 % intervals of a fit's parameters, and what they were made from."""
    causes, theta = found.causes, found.theta
    if len(theta) == 0:
        return Spread(np.zeros((0, 2)), np.zeros((0, 0)), np.zeros(0, bool), 1.0)
    low, high, log = bounds_of(causes)
    scale = scales(theta, low, high, log)
    count = len(theta)
    normal, middle = np.zeros((count, count)), np.zeros((count, count))
    squares, samples = 0.0, 0
    jacobians: list[tuple[Array, Array]] = []
    for i in residual.runs:
        one = residual.on([i])
        r = one(effects_at(causes, theta))

        def moved(thetas: Sequence[Array] | Array, one: Residual = one) -> Array:
            return one.many([effects_at(causes, x) for x in thetas])

        jacobian = differences(moved, theta, r, scale, low, high, WIDE_STEP)
        jacobians.append((r, jacobian))
        normal += np.einsum("mi,mj->ij", jacobian, jacobian)
        gradient = np.einsum("mi,m->i", jacobian, r)
        middle += np.outer(gradient, gradient)
        squares += float(np.einsum("m,m->", r, r))
        samples += int(np.count_nonzero(r))
    misfit = max(1.0, squares / max(1, samples))
    told = np.diag(normal) > FLAT * max(1.0, float(np.max(np.diag(normal))))  # chi-square changes with it at all, nearby
    normal[~told], normal[:, ~told], middle[~told], middle[:, ~told] = 0.0, 0.0, 0.0, 0.0
    normal[~told, ~told] = 1.0
    inverse = inverted(normal)
    runs = len(residual.runs)
    plain = np.diag(inverse) * misfit
    between = np.diag(inverse @ middle @ inverse) * runs / max(1, runs - 1)
    spread = np.sqrt(np.maximum(np.maximum(plain, witnessed(residual, jacobians, inverse)), 0.0)) * NORMAL
    if runs > 2:
        spread = np.maximum(spread, np.sqrt(np.maximum(between, 0.0)) * min(2.2, float(student.ppf(0.975, runs - 1))))
    half = spread * scale + LEAST * np.abs(theta)
    ends = np.column_stack([np.clip(theta - half, low, high), np.clip(theta + half, low, high)])
    rough = [c.effect.jumps == name for c in causes for name in c.names]
    for j in np.flatnonzero(np.array(rough) | ~told):
        profile = [_rise(residual, found, int(j), sign, squares + RISE * misfit, bound) for sign, bound in ((-1.0, low[j]), (1.0, high[j]))]
        ends[j] = (profile[0], profile[1]) if not told[j] else (min(ends[j, 0], profile[0]), max(ends[j, 1], profile[1]))
    return Spread(ends, normal, told, misfit)


def witnessed(residual: Residual, jacobians: Sequence[tuple[Array, Array]], inverse: Array) -> Array:
    """(P,) variance of scaled parameters by what stretches of the runs say of one another; zeros where each row is a witness of its own.

    The sandwich of the stretches' gradients, for those of the link's stretches that make the most of it. Few stretches know their own
    scatter poorly: the variance is that of the normal distribution whose 95 % end where those of Student's do.
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
            wider = (float(student.ppf(0.975, stretches - count)) / NORMAL) ** 2
            out = np.maximum(out, np.diag(inverse @ middle @ inverse) * stretches / (stretches - count) * wider)
    return out


def _rise(residual: Residual, found: Fit, j: int, sign: float, most: float, bound: float) -> float:
    """Where chi-square passes `most` as parameter j moves off its estimate: of a dead zone, say, it has steps and no slope."""
    step = LEAST
    theta = found.theta.copy()
    while step < 1.0:
        theta[j] = found.theta[j] + sign * step * max(abs(found.theta[j]), 1e-12)
        if sign * (theta[j] - bound) >= 0.0:
            return float(bound)
        if square(residual(effects_at(found.causes, theta))) > most:
            return float(theta[j])
        step *= 1.5
    return float(theta[j])
