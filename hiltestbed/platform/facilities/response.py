"""A platform modelled by its response alone: a second- or third-order system with a delay, on six
axes, without mass or geometry.

Each axis follows its command u, the position or the component of the rotation vector, as

    order 2   x'' = w^2 (u - x) - 2 zeta w x'
    order 3   x''' = w^2 (K (u - x) - x') - 2 zeta w x''
              (a hydraulic leg: K its gain, w, zeta the oil with its mass)

u is linear over each tick and delayed by any time. Both are advanced exactly for a linear input
(matrix exponential of the system and its input), so that the result does not depend on the number
of substeps. The motion starts at the start pose less the distance travelled during the delay, with
the approach velocity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, quat_exp, rotation_vectors
from hiltestbed.platform.kinds import ResponseSettings
from hiltestbed.platform.response import ring_at


def six(value: float | Sequence[float]) -> tuple[float, ...]:
    """One number for all axes, or one for each."""
    return (value,) * 6 if isinstance(value, (int, float)) else tuple(value)


def advance_matrices(order: int, w: float, zeta: float, gain: float, dt: float) -> Array:
    """``(3, 5)``: the state (x, x', x'') after ``dt`` [s] from the state (3) and the input before,
    and the input's change over the step.
    """
    from scipy.linalg import expm

    a = np.zeros((5, 5))  # state, input, slope of the input
    a[0, 1] = 1.0
    if order == 2:
        a[1, :4] = [-w * w, -2.0 * zeta * w, 0.0, w * w]
    else:
        a[1, 2] = 1.0
        a[2, :4] = [-gain * w * w, -w * w, -2.0 * zeta * w, gain * w * w]
    a[3, 4] = 1.0
    out = np.asarray(expm(a * dt), dtype=float)[:3].copy()
    out[:, 4] /= dt
    return out


@njit(cache=True)
def _piece(ring, axis, begin, end, e, x, state):
    """Advance one axis while its delayed command is linear, from ``begin`` to ``end`` [ticks]."""
    before = ring_at(ring, axis, begin)
    rise = ring_at(ring, axis, end) - before
    for c in range(3):
        x[c] = e[c, 3] * before + e[c, 4] * rise
        for d in range(3):
            x[c] += e[c, d] * state[d]
    for c in range(3):
        state[c] = x[c]


@njit(cache=True)
def _advance(k, pose_cmd, turn_cmd, axes):
    """One tick: store the command at t_(k+1), then advance every axis over the m substeps.

    axes: late (n,) delay [ticks]; bend (n,) time within the tick at which the delayed command
    passes from one linear piece to the next [ticks]; step (n, 6, 3, 3, 5) matrices of a whole
    substep, and of the parts before and after the bend of the substep that contains it; ring (n,
    slots, 6) commands, that for t_j in slot j modulo their number; state (n, 6, 3) of each axis;
    path (n, m, 7) pose of A in P at the m instants of the tick, the last of which is t_(k+1).
    """
    late_by, bends, step, ring, state, path = axes
    m = path.shape[1]
    r, x = np.empty(3), np.empty(3)
    for i in range(pose_cmd.shape[0]):
        slot, late, bend = (k + 1) % ring.shape[1], late_by[i], bends[i]
        for c in range(3):
            ring[i, slot, c] = pose_cmd[i, c]
            ring[i, slot, 3 + c] = turn_cmd[i, c]
        parted = int(bend * m) if bend > 0.0 else -1
        for s in range(m):
            begin, end, middle = k + s / m - late, k + (s + 1.0) / m - late, k + bend - late
            for axis in range(6):
                if s == parted:
                    _piece(ring[i], axis, begin, middle, step[i, axis, 1], x, state[i, axis])
                    _piece(ring[i], axis, middle, end, step[i, axis, 2], x, state[i, axis])
                else:
                    _piece(ring[i], axis, begin, end, step[i, axis, 0], x, state[i, axis])
            for c in range(3):
                path[i, s, c] = state[i, c, 0]
                r[c] = state[i, 3 + c, 0]
            quat_exp(r, path[i, s, 3:7])


class ResponsePath:
    """Platforms of `n` runs modelled by their response alone."""

    def __init__(self, settings: Sequence[ResponseSettings], tick: float, substeps: int) -> None:
        n, late = len(settings), np.array([s.delay for s in settings]) / tick
        self.tick = tick
        self._late, bend, step = late, late - np.floor(late), np.zeros((n, 6, 3, 3, 5))
        self._ring = np.zeros((n, math.ceil(float(late.max())) + 3, 6))
        self._state, self._path = np.zeros((n, 6, 3)), np.zeros((n, substeps, 7))
        for i, s in enumerate(settings):
            # part before the bend of the substep that contains it
            before = math.modf(bend[i] * substeps)[0] / substeps
            parts = (1.0 / substeps, before, 1.0 / substeps - before)
            for axis, (band, zeta, gain) in enumerate(
                zip(six(s.bandwidth), six(s.damping_ratio), six(s.gain), strict=True)
            ):
                w = 2.0 * math.pi * band
                for part, share in enumerate(parts):
                    if share > 0.0:
                        step[i, axis, part] = advance_matrices(s.order, w, zeta, gain, tick * share)
                    else:  # no time passes
                        step[i, axis, part, :, :3] = np.eye(3)
        self._ticks, self._turn = np.zeros(1, dtype=np.int64), np.zeros((n, 3))
        axes = late, bend, step, self._ring, self._state, self._path
        self._advance = Call(_advance, ..., GIVEN, self._turn, axes)

    def begin(self, pose: Array, twist: Array) -> None:
        """Start a uniform motion with ``twist`` (n, 6), behind ``pose`` (n, 7) by the delay."""
        slots = self._ring.shape[1]
        self._ticks[0] = 0
        start = np.hstack([pose[:, :3], rotation_vectors(pose[:, 3:])])
        for back in range(slots):
            self._ring[:, -back % slots] = start - twist * (self.tick * back)
        self._state[:, :, 0] = start - twist * (self._late * self.tick)[:, None]
        self._state[:, :, 1], self._state[:, :, 2] = twist, 0.0

    def advance(self, pose_cmd: Array) -> Array:
        """The path (n, m, 7) over the tick for whose end ``pose_cmd`` (n, 7) is commanded."""
        self._turn[:] = rotation_vectors(pose_cmd[:, 3:])
        self._advance.on(pose_cmd)(int(self._ticks[0]))
        self._ticks[0] += 1
        return self._path
