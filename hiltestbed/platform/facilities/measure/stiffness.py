"""Compliance of a rig to a wrench at A: static, and for a sine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array, rotation_vectors
from hiltestbed.platform.facilities.facility import Facility
from hiltestbed.platform.facilities.measure.frequency_response import CYCLES, LEAD_IN, _grown
from hiltestbed.platform.facilities.stand import Stand

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

FORCE, TORQUE = 200.0, 60.0  # [N], [N m]
_SIZE = np.array([FORCE] * 3 + [TORQUE] * 3)


def static_compliance(
    facility: Facility,
    *,
    friction: bool = False,
    settle: float = 3.0,
    rate: float = 2000.0,
    substeps: int = 2,
) -> Array:
    """``(6, 6)`` displacement of A, relative to P, for a unit force or torque on each axis, after
    ``settle`` [s] [m/N, rad/N, ...].

    Half the difference between push and pull, so that the weight cancels.
    """
    stand = Stand(facility, 12, rate=rate, substeps=substeps)
    if not friction:
        stand.drives.release()
    pose, still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (12, 1)), np.zeros((12, 6))
    stand.reset(pose, still)
    ticks = round(settle * rate)
    for k in range(ticks):
        share = _grown(k / rate)
        for i in range(6):
            stand.wrench[i, i], stand.wrench[6 + i, i] = share * _SIZE[i], -share * _SIZE[i]
        stand.advance(pose, still, still)
    place = np.hstack([stand.pose[:, :3], rotation_vectors(stand.pose[:, 3:])])
    return ((place[:6] - place[6:]) / (2.0 * _SIZE[:, None])).T


def dynamic_stiffness(
    facility: Facility,
    frequency: Array | Sequence[float],
    *,
    friction: bool = False,
    rate: float = 2000.0,
    substeps: int = 2,
    mechanism: Mechanism | None = None,
) -> NDArray[np.complex128]:
    """``(6, F)`` complex stiffness of each axis at A, force over displacement, with a constant
    command [N/m, N m/rad].
    """
    f = np.asarray(frequency, dtype=float)
    n = 6 * len(f)
    stand = Stand(facility, n, rate=rate, substeps=substeps, mechanism=mechanism)
    if not friction:
        stand.drives.release()
    axis, w = np.repeat(np.arange(6), len(f)), 2.0 * math.pi * np.tile(f, 6)
    pose, still, runs = (
        np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1)),
        np.zeros((n, 6)),
        np.arange(n),
    )
    stand.reset(pose, still)
    ticks = math.ceil((LEAD_IN + CYCLES / f.min()) * rate)
    record = np.empty((ticks, n))
    for k in range(ticks):
        t = (k + 0.5) / rate  # the wrench is constant over a tick
        stand.wrench[runs, axis] = _grown(t) * _SIZE[axis] * np.sin(w * t)
        stand.advance(pose, still, still)
        record[k] = np.hstack([stand.pose[:, :3], rotation_vectors(stand.pose[:, 3:])])[runs, axis]
    out, t = np.empty((6, len(f)), dtype=complex), np.arange(1, ticks + 1) / rate
    for i in range(n):
        window = t > t[-1] - 2.0 * math.pi * CYCLES / w[i]
        basis = np.column_stack(
            [np.sin(w[i] * t[window]), np.cos(w[i] * t[window]), np.ones(window.sum())]
        )
        fit = np.linalg.lstsq(basis, record[window, i], rcond=None)[0]
        out[axis[i], i % len(f)] = _SIZE[axis[i]] / (fit[0] + 1j * fit[1])
    return out
