"""Errors that only the log of one channel has: the loop has used what is not on record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from scipy import signal

from tests.equipment.independent_rig.log import POSES, WRENCHES, Log

Error = Callable[[np.ndarray, Log, float, Generator], np.ndarray]

NEIGHBOURS = 0.9  # correlation of coloured errors from row to row
BEFORE = 200  # rows after which coloured noise is stationary
SPIKED = 1e-3  # fraction of the rows
LONGEST = 5  # rows that are held


def _coloured(values: np.ndarray, log: Log, size: float, rng: Generator) -> np.ndarray:
    """First order, of ``size`` m of the positions, or sigma of the wrench."""
    scale = np.full(3, size) if values.shape[1] == 7 else size * np.asarray(log.sigma)
    fresh = rng.standard_normal((len(values) + BEFORE, len(scale)))
    noise = signal.lfilter([np.sqrt(1.0 - NEIGHBOURS**2)], [1.0, -NEIGHBOURS], fresh, axis=0)
    return _plus(values, noise[BEFORE:] * scale)


def _steps(values: np.ndarray, log: Log, size: float, rng: Generator) -> np.ndarray:
    """Written in steps of ``size`` m or N."""
    return _plus(values, size * np.round(values[:, :3] / size) - values[:, :3])


def _spikes(values: np.ndarray, log: Log, size: float, rng: Generator) -> np.ndarray:
    """Of ``size`` m or N and either sign."""
    shape = (len(values), 3)
    return _plus(values, size * (rng.random(shape) < SPIKED) * rng.choice([-1.0, 1.0], shape))


def _held(values: np.ndarray, log: Log, size: float, rng: Generator) -> np.ndarray:
    """Rows that are held for one to five rows, a fraction ``size`` of all."""
    source = np.arange(len(values))
    for k in np.flatnonzero(rng.random(len(values)) < 2.0 * size / (1 + LONGEST)):
        held = source[k + 1 : k + 1 + int(rng.integers(1, LONGEST + 1))]
        held[held > k] = k  # of two that overlap, the second begins where the first ends
    return values[source]


def _share(values: np.ndarray, log: Log, size: float, rng: Generator) -> np.ndarray:
    """In proportion ``size`` to each reading."""
    return values * (1.0 + size * rng.standard_normal(values.shape))


def _plus(values: np.ndarray, error: np.ndarray) -> np.ndarray:
    out = values.copy()
    out[:, : error.shape[1]] += error
    return out


# to how to add it, and its sizes in a pose and in a wrench
ERRORS: dict[str, tuple[Error, tuple[float, ...], tuple[float, ...]]] = {
    "coloured": (_coloured, (2e-6, 2e-5), (0.5, 1.0)),
    "steps": (_steps, (2e-6, 1e-5), (0.2, 1.0)),
    "spikes": (_spikes, (1e-4, 1e-3), (10.0, 50.0)),
    "held": (_held, (0.05, 0.2), (0.05, 0.2)),
    "share": (_share, (), (0.002, 0.01)),
}


def log_errors() -> dict[str, tuple[tuple[float, ...], Callable[[Log, float, Generator], Log]]]:
    """Name, such as "pose_cmd coloured", to the sizes and what returns the log with the error."""

    def of(channel: str, error: Error) -> Callable[[Log, float, Generator], Log]:
        def apply(log: Log, size: float, rng: Generator) -> Log:
            return replace(log, **{channel: error(getattr(log, channel), log, size, rng)})

        return apply

    return {
        f"{channel} {name}": (sizes, of(channel, error))
        for channel in (*POSES, *WRENCHES)
        for name, (error, pose, wrench) in ERRORS.items()
        if (sizes := pose if channel in POSES else wrench)
    }
