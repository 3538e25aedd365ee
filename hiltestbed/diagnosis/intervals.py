"""95 % intervals that hold: the curvature of chi-square where it is smooth, widened by what the runs say of one another.

A plain Jacobian interval takes the model for exact. Here the covariance is the sandwich of the runs' own gradients (each run, that is
each contact, is one independent witness) where that is wider, and a floor stands for what another sub-stepping of the same rig does.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from hiltestbed.diagnosis.fit import Fit, Residual, differences, effects_at, scales
from hiltestbed.frames import Array

LEAST = 1e-3  # of an estimate: what is left to how a rig is discretised
WIDE_STEP = 2e-3  # of the scale, for derivatives that average over the jumps at whole ticks


def intervals(residual: Residual, found: Fit) -> Array:
    """(P, 2) lower and upper ends, clipped to the bounds of the search."""
    causes, theta = found.causes, found.theta
    if len(theta) == 0:
        return np.zeros((0, 2))
    low, high = np.concatenate([c.low for c in causes]), np.concatenate([c.high for c in causes])
    log = np.concatenate([c.log for c in causes]).astype(bool)
    scale = scales(theta, low, high, log)
    count = len(theta)
    normal, middle = np.zeros((count, count)), np.zeros((count, count))
    squares, samples = 0.0, 0
    for i in residual.runs:
        one = residual.on([i])
        r = one(effects_at(causes, theta))
        jacobian = differences(lambda x, one=one: one(effects_at(causes, x)), theta, r, scale, low, high, WIDE_STEP)
        normal += np.einsum("mi,mj->ij", jacobian, jacobian)
        gradient = np.einsum("mi,m->i", jacobian, r)
        middle += np.outer(gradient, gradient)
        squares += float(np.einsum("m,m->", r, r))
        samples += int(np.count_nonzero(r))
    ridge = 1e-12 * max(float(np.trace(normal)), 1e-300) * np.eye(count)
    inverse = np.linalg.inv(normal + ridge)
    misfit = max(1.0, squares / max(1, samples))
    runs = len(residual.runs)
    plain = np.diag(inverse) * misfit
    between = np.diag(inverse @ middle @ inverse) * runs / max(1, runs - 1)
    spread = np.sqrt(np.maximum(plain, 0.0)) * 1.96
    if runs > 2:
        spread = np.maximum(spread, np.sqrt(np.maximum(between, 0.0)) * min(2.2, float(student.ppf(0.975, runs - 1))))
    half = spread * scale + LEAST * np.abs(theta)
    return np.column_stack([np.clip(theta - half, low, high), np.clip(theta + half, low, high)])
