"""Limit monitoring of a facility's joints, as by its own electronics.

Travel, speed, acceleration and force of every driven joint are compared with the limits of the
facility, and the command with its reach. Quantities are ratios to their limits: above 1 a limit is
exceeded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import Axis

TRAVEL, SPEED, ACCELERATION, FORCE, REACH = range(5)
UNREACHED = 1e-6  # [m], [rad] largest distance of a command from the reach


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
        self._axes, self._home, self._tick, joints = tuple(axes), home, tick, len(axes)
        self._unwatched = np.zeros((n, 5), dtype=bool) if watched is None else ~watched
        bounded = [(a.low, a.high) if a.high - a.low < math.inf else (0.0, 0.0) for a in axes]
        self._middle = 0.5 * np.sum(bounded, axis=1)
        limits = [[0.5 * (a.high - a.low), a.speed, a.acceleration, a.force] for a in axes]
        self._limits = np.array(limits).T.copy()
        self._before, self._ticks = np.zeros((n, joints)), np.zeros(1, dtype=np.int64)
        self._places, self._shares = np.zeros((n, joints)), np.zeros((n, 5, joints))

    def passed(
        self,
        joints: Array,
        rates: Array,
        forces: Array,
        missed: Array,
        columns: NDArray[np.int64] | slice = slice(None),
    ) -> bool:
        """Whether a run has exceeded a limit: ``joints`` from home, ``rates`` and drive ``forces``
        (n, J), ``missed`` (n,) by the command.

        ``columns``: (J,) columns of the drives' forces in ``forces``; by default all.
        """
        self._places[:] = joints + self._home
        change = (rates - self._before) / self._tick * (self._ticks[0] > 0)
        found = self._places - self._middle, rates, change, forces[:, columns]
        for k, (values, limit) in enumerate(zip(found, self._limits, strict=True)):
            np.divide(np.abs(values), limit, out=self._shares[:, k])
        self._shares[:, REACH] = missed[:, None] / UNREACHED
        self._shares[self._unwatched] = 0.0
        self._before[:] = rates
        self._ticks += 1
        return bool((self._shares > 1.0).any())

    def reason(self, i: int) -> str | None:
        """The limit that run ``i`` has exceeded, with joint and value; None: none."""
        shares = np.where(self._shares[i] > 1.0, self._shares[i], 0.0)
        worst, j = np.unravel_index(int(np.argmax(shares)), shares.shape)
        share, axis = shares[worst, j], self._axes[j]
        if not share:
            return None
        if worst == REACH:
            return f"the command is {share * UNREACHED:.3g} m or rad out of the facility's reach"
        turns = axis.unit == "rad"
        turn, unit, newton = (math.degrees(1.0), "deg", "N m") if turns else (1.0, "m", "N")
        if worst == TRAVEL:
            value = self._places[i, j] * turn
            travel = f"{axis.low * turn:.4g} to {axis.high * turn:.4g} {unit}"
            return f"joint {axis.joint} is at {value:.4g} {unit}; its travel is {travel}"
        what, top, per = {
            SPEED: ("joint {} moves at", axis.speed * turn, f"{unit}/s"),
            ACCELERATION: ("joint {} accelerates at", axis.acceleration * turn, f"{unit}/s^2"),
            FORCE: ("the drive of joint {} exerts", axis.force, newton),
        }[int(worst)]
        value = f"{share * top:.4g} {per}; its limit is {top:.4g} {per}"
        return f"{what.format(axis.joint)} {value}"
