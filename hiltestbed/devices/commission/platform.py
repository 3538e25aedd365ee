"""The platform's response to its commands: delay, scale of each axis, and compliance under load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hiltestbed.frames import Array

LONGEST = 0.2  # [s] largest delay that is fitted
# half widths of its 95 % interval by which an estimate has to differ from its neutral value: 3.92
# standard deviations, as by chance one in 11,000
SIGNIFICANT = 2.0


@dataclass(frozen=True)
class TestedPath:
    """A motion from rest: command (N, 7), row k for t_(k+1); pose (N, 7) and wrench (N, 6), in P,
    at t_k; the pose (7,) at which it was to start; whether it touches.
    """

    command: Array
    pose: Array
    wrench: Array
    start: Array
    touches: bool


@dataclass(frozen=True)
class PlatformFit:
    """Estimates with the half width of their 95 % interval.

    Attributes:
        delay: [s]. compliance: (3,) [m/N] of each axis. scale: (3,) reached over commanded; None
            without a motion in free space: in contact force is proportional to position, so that
            scale and compliance cannot be separated. residual: rms [m].
    """

    delay: float
    delay_ci95: float
    compliance: list[float]
    compliance_ci95: list[float]
    scale: list[float] | None
    scale_ci95: list[float] | None
    residual: float


def fit_platform(paths: Sequence[TestedPath], tick: float) -> PlatformFit:
    """Delay, scale and compliance that fit all ``paths`` best: pose(t) = scale command(t - delay) +
    offset - compliance force.
    """

    def parts(delay: float) -> list[tuple[Array, Array, Array]]:
        out = []
        for path in paths:
            rows = np.arange(len(path.command))
            at = np.arange(len(path.pose), dtype=float) - 1.0 - delay / tick
            told = [np.interp(at, rows, path.command[:, j]) for j in range(3)]
            out.append((np.stack(told, axis=1), path.pose[:, :3], path.wrench[:, :3]))
        return out

    def residuals(p: Array) -> Array:
        scale = p[4:] if len(p) > 4 else np.ones(3)
        rest = []
        for told, pose, force in parts(p[0] * 1e-3):
            error = pose - scale * told + 1e-8 * p[1:4] * force
            rest.append((error - error.mean(axis=0)).ravel())
        return np.concatenate(rest) * 1e6

    # without free motion, scale and compliance cannot be separated
    free = [] if all(path.touches for path in paths) else [1.0, 1.0, 1.0]
    delays = np.arange(0.0, LONGEST, 0.002)
    starts = [np.array([1e3 * delay, 0.0, 0.0, 0.0, *free]) for delay in delays]
    best = min(starts, key=lambda p: float(np.linalg.norm(residuals(p))))
    fit = least_squares(residuals, best, x_scale=[1.0] * 4 + [1e-2] * len(free))
    spread = spread_of(fit.jac, 2.0 * fit.cost)
    return PlatformFit(
        delay=float(fit.x[0] * 1e-3),
        delay_ci95=float(spread[0] * 1e-3),
        compliance=(1e-8 * fit.x[1:4]).tolist(),
        compliance_ci95=(1e-8 * spread[1:4]).tolist(),
        scale=fit.x[4:].tolist() or None,
        scale_ci95=spread[4:].tolist() or None,
        residual=float(np.sqrt(np.mean(fit.fun**2)) * 1e-6),
    )


def spread_of(jacobian: Array, square: float) -> Array:
    """(n,) half widths of the 95 % intervals of a fit with the ``square`` sum of its residuals."""
    rows, columns = jacobian.shape
    variance = np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * square / max(rows - columns, 1)
    return 1.96 * np.sqrt(variance)
