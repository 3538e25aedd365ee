"""Limit monitoring of a facility's joints, as by its own electronics.

Travel, speed, acceleration and force of every driven joint are compared with the limits of the
facility, and the command with its reach. Quantities are ratios to their limits: above 1 a limit is
exceeded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import Axis

TRAVEL, SPEED, ACCELERATION, FORCE, REACH = range(5)
UNREACHED = 1e-6  # [m], [rad] largest distance of a command from the reach


class Monitored(NamedTuple):
    """What n runs are compared with, and the result.

    Attributes:
        tick: [s]. limits: (5, J) low and high as joint positions, speed, acceleration, force.
            home: (J,). watched: (n, 5) which quantities of a run are monitored.
        before: (n, J) rates at the previous tick. ticks: (n,) so far. joints (n, J), missed (n,):
            copies of the last ones.
        shares: (n, 5) largest ratio to the limit of travel, speed, acceleration, force and reach,
            at this tick. which: (n, 5) index of the joint with this ratio.
    """

    tick: float
    limits: Array
    home: Array
    watched: Array
    before: Array
    ticks: NDArray[np.int64]
    joints: Array
    missed: Array
    shares: Array
    which: NDArray[np.int64]


@njit(cache=True)
def _watch(now, joints, rates, forces, columns, missed):
    limits, shares, passed = now.limits, now.shares, False
    for i in range(joints.shape[0]):
        shares[i] = 0.0
        now.missed[i] = missed[i]
        for j in range(joints.shape[1]):
            now.joints[i, j] = joints[i, j]
            value = joints[i, j] + now.home[j]
            middle, half = 0.5 * (limits[0, j] + limits[1, j]), 0.5 * (limits[1, j] - limits[0, j])
            travel = abs(value - middle) / half if half < math.inf else 0.0
            accel = abs(rates[i, j] - now.before[i, j]) / now.tick if now.ticks[i] > 0 else 0.0
            now.before[i, j] = rates[i, j]
            found = (
                travel,
                abs(rates[i, j]) / limits[2, j],
                accel / limits[3, j],
                abs(forces[i, columns[j]]) / limits[4, j],
            )
            for k in range(4):
                if now.watched[i, k] * found[k] > shares[i, k]:
                    shares[i, k] = found[k]
                    now.which[i, k] = j
        shares[i, 4] = now.watched[i, 4] * missed[i] / UNREACHED
        now.ticks[i] += 1
        for k in range(5):
            passed = passed or shares[i, k] > 1.0
    return passed


class Watch:
    """Limit monitoring of `n` runs of a facility."""

    def __init__(
        self,
        axes: Sequence[Axis],
        home: Array,
        n: int,
        tick: float,
        watched: NDArray[np.bool_] | None = None,
    ) -> None:
        """``watched``: (n, 5) which quantities of a run are monitored; all by default."""
        self._axes, joints = tuple(axes), len(axes)
        limits = [[a.low, a.high, a.speed, a.acceleration, a.force] for a in axes]
        self._now = Monitored(
            tick=tick,
            limits=np.array(limits).T.copy(),
            home=np.asarray(home, dtype=float),
            watched=np.ones((n, 5)) if watched is None else np.asarray(watched, dtype=float),
            before=np.zeros((n, joints)),
            ticks=np.zeros(n, dtype=np.int64),
            joints=np.zeros((n, joints)),
            missed=np.zeros(n),
            shares=np.zeros((n, 5)),
            which=np.zeros((n, 5), dtype=np.int64),
        )
        self._columns = np.arange(joints)
        self._watch = Call(_watch, self._now, *(GIVEN,) * 5)

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
        """The limit that run ``i`` has exceeded, with joint and value; None: none."""
        now = self._now
        worst = int(np.argmax(now.shares[i]))
        share = now.shares[i, worst]
        if not share > 1.0:
            return None
        if worst == REACH:
            return f"the command is {now.missed[i]:.3g} m or rad out of the facility's reach"
        j = int(now.which[i, worst])
        axis = self._axes[j]
        turns = axis.unit == "rad"
        turn, unit, newton = (math.degrees(1.0), "deg", "N m") if turns else (1.0, "m", "N")
        if worst == TRAVEL:
            value = (now.joints[i, j] + now.home[j]) * turn
            travel = f"{axis.low * turn:.4g} to {axis.high * turn:.4g} {unit}"
            return f"joint {axis.joint} is at {value:.4g} {unit}; its travel is {travel}"
        what, top, per = {
            SPEED: ("joint {} moves at", axis.speed * turn, f"{unit}/s"),
            ACCELERATION: ("joint {} accelerates at", axis.acceleration * turn, f"{unit}/s^2"),
            FORCE: ("the drive of joint {} exerts", axis.force, newton),
        }[worst]
        value = f"{share * top:.4g} {per}; its limit is {top:.4g} {per}"
        return f"{what.format(axis.joint)} {value}"
