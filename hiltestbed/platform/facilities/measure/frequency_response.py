"""Frequency response of a facility in six axes: stepped sines, one run of a batch for each axis and
frequency.

Ratio of reached to commanded pose of A, from a least-squares fit of sine, cosine and mean over
whole cycles after the transient. The motion of the other axes is the cross response. Command and
response are samples at t_k, without a hold in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array, rotation_vectors
from hiltestbed.platform.facilities.facility import Facility
from hiltestbed.platform.facilities.kinematics import LEVER
from hiltestbed.platform.facilities.stand import Stand

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

AMPLITUDE = 2e-3  # [m]; divided by LEVER for a rotation
PULL = 4.0  # [m/s^2] largest acceleration of a sine
CYCLES = 3  # number of cycles fitted
LEAD_IN = 1.0  # [s] transient, in the first half of which the sine's amplitude grows


@dataclass(frozen=True)
class FrequencyResponse:
    """Response of A to its command.

    Attributes:
        frequency: (F,) [Hz]. own: (6, F) complex ratio of each axis. cross: (6, F) largest relative
            amplitude of another axis.
    """

    frequency: Array
    own: NDArray[np.complex128]
    cross: Array

    def gain_db(self) -> Array:
        """(6, F) [dB]."""
        return 20.0 * np.log10(np.abs(self.own))

    def phase_deg(self) -> Array:
        """(6, F) [deg], unwrapped."""
        return np.degrees(np.unwrap(np.angle(self.own), axis=1))

    def delay(self, axis: int = 2) -> float:
        """Delay at the lowest frequency [s]."""
        return float(-np.angle(self.own[axis, 0]) / (2.0 * math.pi * self.frequency[0]))

    def bandwidth(self, axis: int = 2, phase_deg: float = 90.0) -> float:
        """Frequency [Hz] at which the response first lags by ``phase_deg`` or falls by 3 dB,
        interpolated; inf: above all measured.
        """
        low = np.minimum(3.0 + self.gain_db()[axis], phase_deg + self.phase_deg()[axis])
        below = np.flatnonzero(low < 0.0)
        if not len(below):
            return math.inf
        k = int(below[0])
        if k == 0:
            return float(self.frequency[0])
        f = np.log(self.frequency[k - 1 : k + 1])
        return float(np.exp(f[0] + (f[1] - f[0]) * low[k - 1] / (low[k - 1] - low[k])))


def frequency_response(
    facility: Facility,
    frequency: Array | Sequence[float],
    *,
    feed: bool = False,
    friction: bool = True,
    axes: Sequence[int] = range(6),
    rate: float = 2000.0,
    substeps: int = 2,
    amplitude: float = AMPLITUDE,
    settings: Any = None,
    mechanism: Mechanism | None = None,
) -> FrequencyResponse:
    """Measure at the frequencies [Hz], about home. Axes that are left out are NaN.

    Args:
        feed: feed-forward of velocity and acceleration. friction: of the drives; without it the
            response is linear.
    """
    f = np.asarray(frequency, dtype=float)
    count = len(axes) * len(f)
    stand = Stand(
        facility,
        count,
        feed=feed,
        rate=rate,
        substeps=substeps,
        settings=settings and [settings] * count,
        mechanism=mechanism,
    )
    if not friction:
        stand.drives.release()
    axis, w = np.repeat(np.asarray(axes), len(f)), 2.0 * math.pi * np.tile(f, len(axes))
    size = np.minimum(
        np.where(axis < 3, amplitude, amplitude / LEVER),
        np.where(axis < 3, PULL, PULL / LEVER) / w**2,
    )
    ticks = math.ceil((LEAD_IN + CYCLES / f.min()) * rate)
    record = _drive(stand, axis, w, size, ticks)
    own, cross = np.full((6, len(f)), np.nan, dtype=complex), np.full((6, len(f)), np.nan)
    t = np.arange(1, ticks + 1) / rate
    for i in range(count):
        window = t > t[-1] - 2.0 * math.pi * CYCLES / w[i]
        basis = np.column_stack(
            [np.sin(w[i] * t[window]), np.cos(w[i] * t[window]), np.ones(window.sum())]
        )
        fit = np.linalg.lstsq(basis, record[window, i], rcond=None)[0]
        ratio = (fit[0] + 1j * fit[1]) / size[i]
        others = (
            np.abs(ratio) * np.where(np.arange(6) < 3, 1.0, LEVER) / (1.0 if axis[i] < 3 else LEVER)
        )
        row, column = int(axis[i]), i % len(f)
        own[row, column] = ratio[row]
        cross[row, column] = np.delete(others, row).max()
    return FrequencyResponse(f, own, cross)


def _drive(stand: Stand, axis: NDArray[np.intp], w: Array, size: Array, ticks: int) -> Array:
    """``(ticks, n, 6)`` position and rotation vector of A under sines that grow smoothly."""
    n, h = len(axis), stand.tick
    runs = np.arange(n)
    place, speed, bend = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6))
    pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1))
    stand.reset(pose, speed)
    out = np.empty((ticks, n, 6))
    for k in range(1, ticks + 1):
        t = k * h
        # The velocity of a tick belongs to its middle, its acceleration to its start.
        place[runs, axis] = size * _grown(t) * np.sin(w * t)
        speed[runs, axis] = size * _grown(t) * w * np.cos(w * (t - 0.5 * h))
        bend[runs, axis] = -size * _grown(t) * w * w * np.sin(w * (t - h))
        pose[:, :3] = place[:, :3]
        half = 0.5 * np.linalg.norm(place[:, 3:], axis=1, keepdims=True)
        pose[:, 3:6] = 0.5 * place[:, 3:] * np.sinc(half / math.pi)
        pose[:, 6] = np.cos(half[:, 0])
        stand.advance(pose, speed, bend)
        out[k - 1, :, :3], out[k - 1, :, 3:] = (
            stand.pose[:, :3],
            rotation_vectors(stand.pose[:, 3:]),
        )
    return out


def _grown(t: float) -> float:
    """Fraction of the amplitude at time ``t`` [s]: a smooth start over half the lead-in."""
    u = min(2.0 * t / LEAD_IN, 1.0)
    return u * u * (3.0 - 2.0 * u)
