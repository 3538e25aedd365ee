"""The platform's response to its commands: delay, scale of each axis, and compliance under load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hiltestbed.frames import Array

LONGEST = 0.2  # [s] largest delay that is fitted


@dataclass(frozen=True)
class Path:
    """A motion from rest: command (N, 7), row k for t_(k+1); pose (N, 7) and wrench (N, 6), in P,
    at t_k; whether it made contact.
    """

    command: Array
    pose: Array
    wrench: Array
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


def fit_platform(paths: Sequence[Path], tick: float) -> PlatformFit:
    """Delay, scale and compliance that fit all ``paths`` best: pose(t) = scale command(t - delay) +
    offset - compliance force.
    """

    def parts(delay: float) -> list[tuple[Array, Array, Array]]:
        out = []
        for path in paths:
            k = np.arange(len(path.pose), dtype=float)
            told = np.stack(
                [
                    np.interp(
                        k - 1.0 - delay / tick, np.arange(len(path.command)), path.command[:, j]
                    )
                    for j in range(3)
                ],
                axis=1,
            )
            out.append((told, path.pose[:, :3], path.wrench[:, :3]))
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
    starts = [
        np.array([1e3 * delay, 0.0, 0.0, 0.0, *free]) for delay in np.arange(0.0, LONGEST, 0.002)
    ]
    fit = least_squares(
        residuals,
        min(starts, key=lambda p: _square(residuals(p))),
        x_scale=[1.0] * 4 + [1e-2] * len(free),
    )
    columns = fit.jac.shape[1]
    spread = 1.96 * np.sqrt(
        np.diag(np.linalg.pinv(fit.jac.T @ fit.jac))
        * 2.0
        * fit.cost
        / max(len(fit.fun) - columns, 1)
    )
    return PlatformFit(
        delay=float(fit.x[0] * 1e-3),
        delay_ci95=float(spread[0] * 1e-3),
        compliance=(1e-8 * fit.x[1:4]).tolist(),
        compliance_ci95=(1e-8 * spread[1:4]).tolist(),
        scale=fit.x[4:].tolist() or None,
        scale_ci95=spread[4:].tolist() or None,
        residual=float(np.sqrt(np.mean(fit.fun**2)) * 1e-6),
    )


def _square(values: Array) -> float:
    return float(values @ values)
