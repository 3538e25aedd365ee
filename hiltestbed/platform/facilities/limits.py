"""Limit monitoring of a facility's joints, as by its own electronics.

Travel, speed, acceleration and force of every driven joint are compared with the limits of the
facility, and the command with
its reach. Quantities are ratios to their limits: above 1 a limit is exceeded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import Axis

TRAVEL, SPEED, ACCELERATION, FORCE, REACH = range(5)
UNREACHED = 1e-6  # [m], [rad] largest distance of a command from the reach


@njit(cache=True)
def _watch(
    h,
    limits,
    home,
    joints,
    rates,
    forces,
    columns,
    missed,
    before,
    ticks,
    watched,
    stood,
    left,
    shares,
    which,
):
    """limits: (5, J) low and high as joint positions, speed, acceleration, force. stood (n, J),
    left (n,): stored copies of ``joints``
    and ``missed``. shares, which: (n, 5).
    """
    passed = False
    for i in range(joints.shape[0]):
        shares[i] = 0.0
        left[i] = missed[i]
        for j in range(joints.shape[1]):
            stood[i, j] = joints[i, j]
            value = joints[i, j] + home[j]
            middle, half = 0.5 * (limits[0, j] + limits[1, j]), 0.5 * (limits[1, j] - limits[0, j])
            travel = abs(value - middle) / half if half < math.inf else 0.0
            accel = abs(rates[i, j] - before[i, j]) / h if ticks[i] > 0 else 0.0
            before[i, j] = rates[i, j]
            found = (
                travel,
                abs(rates[i, j]) / limits[2, j],
                accel / limits[3, j],
                abs(forces[i, columns[j]]) / limits[4, j],
            )
            for k in range(4):
                if watched[i, k] * found[k] > shares[i, k]:
                    shares[i, k] = found[k]
                    which[i, k] = j
        shares[i, 4] = watched[i, 4] * missed[i] / UNREACHED
        ticks[i] += 1
        for k in range(5):
            passed = passed or shares[i, k] > 1.0
    return passed


class Watch:
    """Limit monitoring of `n` runs of a facility.

    Attributes:
        shares: (n, 5) largest ratio to the limit of travel, speed, acceleration, force and reach,
            at this tick. which: (n, 5) index of the joint with this ratio.
    """

    def __init__(
        self, axes: Sequence[Axis], home: Array, n: int, tick: float, watched: Array | None = None
    ) -> None:
        """``watched``: (n, 5) which quantities of a run are monitored; all by default."""
        self._watched = np.ones((n, 5)) if watched is None else np.asarray(watched, dtype=float)
        self._axes, self._home, self._tick = tuple(axes), np.asarray(home, dtype=float), tick
        self._limits = np.array(
            [[a.low, a.high, a.speed, a.acceleration, a.force] for a in axes]
        ).T.copy()
        self.shares, self.which = np.zeros((n, 5)), np.zeros((n, 5), dtype=np.int64)
        self._before, self._ticks = np.zeros((n, len(self._axes))), np.zeros(n, dtype=np.int64)
        self._stood, self._missed, self._columns = (
            np.zeros((n, len(self._axes))),
            np.zeros(n),
            np.arange(len(self._axes)),
        )
        self._watch = Call(
            _watch,
            tick,
            self._limits,
            self._home,
            *(GIVEN,) * 5,
            self._before,
            self._ticks,
            self._watched,
            self._stood,
            self._missed,
            self.shares,
            self.which,
        )

    def passed(
        self,
        joints: Array,
        rates: Array,
        forces: Array,
        missed: Array,
        columns: NDArray[np.int64] | None = None,
    ) -> bool:
        """Whether a run has exceeded a limit: ``joints`` from home, ``rates`` and drive ``forces``
        (n, J), ``missed`` (n,) by the command.

        ``columns``: (J,) columns of the drives' forces in ``forces``; by default the first J.
        """
        return self._watch.on(
            joints, rates, forces, self._columns if columns is None else columns, missed
        )()

    def reason(self, i: int) -> str | None:
        """The limit that run ``i`` has exceeded, with joint and value; None if it has exceeded
        none.
        """
        worst = int(np.argmax(self.shares[i]))
        if not self.shares[i, worst] > 1.0:
            return None
        if worst == REACH:
            return f"the command is {self._missed[i]:.3g} m or rad out of the facility's reach"
        axis, j = self._axes[int(self.which[i, worst])], int(self.which[i, worst])
        turn = math.degrees(1.0) if axis.unit == "rad" else 1.0
        unit = "deg" if axis.unit == "rad" else axis.unit
        share = self.shares[i, worst]
        if worst == TRAVEL:
            value = (self._stood[i, j] + self._home[j]) * turn
            return (
                f"joint {axis.joint} is at {value:.4g} {unit}; its travel is "
                f"{axis.low * turn:.4g} to {axis.high * turn:.4g} {unit}"
            )
        if worst == SPEED:
            return (
                f"joint {axis.joint} moves at {share * axis.speed * turn:.4g} {unit}/s; "
                f"its limit is {axis.speed * turn:.4g} {unit}/s"
            )
        if worst == ACCELERATION:
            top = axis.acceleration * turn
            return (
                f"joint {axis.joint} accelerates at {share * top:.4g} {unit}/s^2; its "
                f"limit is {top:.4g} {unit}/s^2"
            )
        newton = "N m" if axis.unit == "rad" else "N"
        return (
            f"the drive of joint {axis.joint} exerts {share * axis.force:.4g} {newton}; "
            f"its limit is {axis.force:.4g} {newton}"
        )

    def buffers(self) -> dict[str, NDArray[Any]]:
        return {
            "shares": self.shares,
            "which": self.which,
            "before": self._before,
            "ticks": self._ticks,
        }
