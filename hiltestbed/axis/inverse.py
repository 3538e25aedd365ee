"""The inverse model of a record: the input that its motion takes, against the recorded one.

Both are filtered alike (M. Gautier, P. Poignet, Control Eng. Pract. 9, 2001): as the acceleration
of the motion is, and then averaged over blocks of rows until the noise of the acceleration, a
regressor, is a small share of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_coeffs

from hiltestbed.axis.motion import (
    ORDER,
    WINDOWS,
    Motion,
    States,
    averaged,
    motion_of,
    noise_of,
    weights_of,
)
from hiltestbed.frames import Array

# of the rows over which a motion was smoothed, every which is used: those between tell nothing new
ROWS_A_WINDOW = 4
# standard deviations of the speed below which the sign of a motion is not known
RESOLVED_SIGMA = 3.0
# of the rms of an acceleration, its noise: a mass is estimated too small by the square of that
# (W. A. Fuller, Measurement Error Models, 1987, 1.1)
NOISY = 0.02


class Blocks(NamedTuple):
    """Rows that are averaged, and by what factor that lowers the noise of an acceleration."""

    rows: int
    lowered: float


class InverseRecord(NamedTuple):
    """What is compared along the motion of one record.

    Attributes:
        motion: at the rows that are used. input: (N,) recorded there, averaged as the acceleration
            is. slope: (N,) of it [1/s]. moves: (N,) whether the axis moves: where dry friction
            holds it, its force is not that of a motion. rows: that are averaged. floor: noise of
            what is left, in the unit of the input.
    """

    motion: Motion
    input: Array
    slope: Array
    moves: np.ndarray
    rows: int
    floor: float

    @classmethod
    def of(cls, m: Motion, u: Array, shaken: float, blocks: Blocks) -> InverseRecord:
        """Of the motion ``m`` and the input ``u`` (N,), each value of which is held until the next
        row. shaken: standard deviation of the input that the noise of the accelerations takes.
        """
        few = rows_of(m)
        # what is held before and after each row
        driven = averaged(0.5 * (u + np.r_[u[:1], u[:-1]]), m.window)
        slope = motion_of(m.t, driven).v
        turned = m._replace(way=averaged(np.sign(m.v), m.window))
        reading = noise_of(u) * float(np.linalg.norm(weights_of(m.window)))
        floor = math.hypot(reading / math.sqrt(blocks.rows), blocks.lowered * shaken)
        return cls(
            turned.thinned(few), driven[few], slope[few], in_motion(m)[few], blocks.rows, floor
        )

    @property
    def blocks(self) -> int:
        """Averages that it gives."""
        return int(self.moves.sum()) // self.rows

    def left(self, shown: Array, late: float) -> Array:
        """(M,) averages of the input, ``late`` [s] after its stamps, less what is ``shown`` (N,).

        The input is shifted, by its slope: to shift what the motion shows would average the noise
        of neighbouring rows, and a fit would take that for an offset.
        """
        return self.averaged(self.input - late * self.slope - shown)

    def states(self, gain: float, turns: bool, place: str = "") -> States:
        """Where the axis is at each average; ``gain``: force per unit of the input."""
        m = self.motion
        each = (self.averaged(part) for part in (m.t, m.x, m.v, m.a, gain * self.input))
        return States(*each, scale=gain, place=place, turns=turns)

    def averaged(self, x: Array) -> Array:
        """(M,) averages of a signal (N,) over blocks of the rows in motion."""
        return x[self.moves][: self.blocks * self.rows].reshape(-1, self.rows).mean(axis=1)


def in_motion(m: Motion) -> np.ndarray:
    """(N,) whether an axis moves, but for the ends of its record."""
    moves, half = np.abs(m.v) > RESOLVED_SIGMA * m.resolved, m.window // 2
    moves[:half] = moves[len(moves) - half :] = False
    return moves


def rows_of(m: Motion) -> slice:
    """The rows of a motion that are used."""
    return slice(None, None, max(1, m.window // ROWS_A_WINDOW))


def blocks_of(m: Motion) -> Blocks:
    """The fewest rows whose average has an acceleration with no more noise than :data:`NOISY` of
    its rms. Measured and predicted are averaged alike, so that nothing else is lost than the time
    of an event.
    """
    one, step = savgol_coeffs(m.window, ORDER, deriv=2), rows_of(m).step
    most = NOISY * float(np.sqrt(np.mean(m.a * m.a))) / max(m.shaken, 1e-300)
    lowered = 1.0
    for rows in (1, *WINDOWS):
        spread = np.zeros((rows - 1) * step + 1)
        spread[::step] = 1.0 / rows
        lowered = float(np.linalg.norm(np.convolve(one, spread)) / np.linalg.norm(one))
        if lowered <= most:
            return Blocks(rows, lowered)
    return Blocks(WINDOWS[-1], lowered)
