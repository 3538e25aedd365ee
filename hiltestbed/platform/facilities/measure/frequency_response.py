"""Response of a rig in six axes to sines: of its command, and of a wrench at A. One run of a batch
for each axis and frequency.

A sine and a cosine are fitted by least squares over whole cycles after the transient. Command and
response are samples at t_k, without a hold in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array, rotation_vectors
from hiltestbed.platform.facilities.kinematics import LEVER
from hiltestbed.platform.facilities.stand import Stand, Stands

AMPLITUDE = 2e-3  # [m]; divided by LEVER for a rotation
PULL = 4.0  # [m/s^2] largest acceleration of a sine
FORCE, TORQUE = 200.0, 60.0  # [N], [N m]
CYCLES = 3  # number of cycles fitted
LEAD_IN = 1.0  # [s] transient, in the first half of which the sine's amplitude grows
LEVERS = np.array([1.0] * 3 + [LEVER] * 3)  # a rotation times its lever is a length


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

    def bandwidth(self, axis: int = 2) -> float:
        """Frequency [Hz] at which the response first lags by 90 deg or falls by 3 dB,
        interpolated; inf: above all measured.
        """
        low = np.minimum(3.0 + self.gain_db()[axis], 90.0 + self.phase_deg()[axis])
        below = np.flatnonzero(low < 0.0)
        if not len(below):
            return math.inf
        k = int(below[0])
        if k == 0:
            return float(self.frequency[0])
        f = np.log(self.frequency[k - 1 : k + 1])
        return float(np.exp(f[0] + (f[1] - f[0]) * low[k - 1] / (low[k - 1] - low[k])))


def frequency_response(
    stands: Stands,
    frequency: Array | Sequence[float],
    axes: Sequence[int] = range(6),
    amplitude: float = AMPLITUDE,
) -> FrequencyResponse:
    """Ratio of reached to commanded pose of A at the frequencies [Hz], about home; the motion of
    the other axes is the cross response. Axes that are left out are NaN.
    """
    f = np.asarray(frequency, dtype=float)
    stand = stands(len(axes) * len(f))
    axis, w = np.repeat(np.asarray(axes), len(f)), 2.0 * math.pi * np.tile(f, len(axes))
    size = np.minimum(amplitude, PULL / w**2) / LEVERS[axis]
    ratios = _fitted(_command_sines(stand, axis, w, size), w, stand.tick) / size[:, None]
    own, cross = np.full((6, len(f)), np.nan, dtype=complex), np.full((6, len(f)), np.nan)
    for i, ratio in enumerate(ratios):
        row, column = int(axis[i]), i % len(f)
        own[row, column] = ratio[row]
        cross[row, column] = np.delete(np.abs(ratio) * LEVERS / LEVERS[row], row).max()
    return FrequencyResponse(f, own, cross)


def dynamic_stiffness(stands: Stands, frequency: Array | Sequence[float]) -> NDArray[np.complex128]:
    """``(6, F)`` complex stiffness of each axis at A, force over displacement, with a constant
    command and without friction [N/m, N m/rad].
    """
    f = np.asarray(frequency, dtype=float)
    n = 6 * len(f)
    stand = stands(n)
    stand.drives.release()
    axis, w, runs = np.repeat(np.arange(6), len(f)), 2.0 * math.pi * np.tile(f, 6), np.arange(n)
    size = np.where(axis < 3, FORCE, TORQUE)
    pose, still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((n, 6))
    stand.reset(pose, still)
    record = np.empty((_ticks(w, stand.tick), n, 6))
    for k in range(len(record)):
        t = (k + 0.5) * stand.tick  # the wrench is constant over a tick
        stand.wrench[runs, axis] = _grown(t) * size * np.sin(w * t)
        stand.advance(pose, still, still)
        record[k] = _placed(stand)
    moved = _fitted(record, w, stand.tick)[runs, axis]
    return (size / moved).reshape(6, len(f))


def _command_sines(stand: Stand, axis: NDArray[np.intp], w: Array, size: Array) -> Array:
    """``(ticks, n, 6)`` position and rotation vector of A under sines that grow smoothly."""
    n, h = len(axis), stand.tick
    runs = np.arange(n)
    place, speed, bend = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros((n, 6))
    pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1))
    stand.reset(pose, speed)
    out = np.empty((_ticks(w, h), n, 6))
    for k in range(1, len(out) + 1):
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
        out[k - 1] = _placed(stand)
    return out


def _placed(stand: Stand) -> Array:
    """``(n, 6)`` position and rotation vector of A."""
    return np.hstack([stand.pose[:, :3], rotation_vectors(stand.pose[:, 3:])])


def _ticks(w: Array, tick: float) -> int:
    return math.ceil((LEAD_IN + CYCLES * 2.0 * math.pi / w.min()) / tick)


def _fitted(record: Array, w: Array, tick: float) -> NDArray[np.complex128]:
    """``(n, 6)`` complex amplitudes of a record (ticks, n, 6) of sines of w (n,)."""
    t, out = np.arange(1, len(record) + 1) * tick, np.empty(record.shape[1:], dtype=complex)
    for i, w_i in enumerate(w):
        window = t > t[-1] - 2.0 * math.pi * CYCLES / w_i
        phase = w_i * t[window]
        basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones(len(phase))])
        fit = np.linalg.lstsq(basis, record[window, i], rcond=None)[0]
        out[i] = fit[0] + 1j * fit[1]
    return out


def _grown(t: float) -> float:
    """Fraction of the amplitude at time ``t`` [s]: a smooth start over half the lead-in."""
    u = min(2.0 * t / LEAD_IN, 1.0)
    return u * u * (3.0 - 2.0 * u)
