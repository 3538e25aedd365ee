"""The upper platform of `n` rigs: pose of the passive port, tick by tick, and clamping.

Over a tick its coordinates follow the cubic that reaches the allocated ones
(:mod:`hiltestbed.platform.prs3.allocation`) at t_(k+1) and leaves them with their velocity there.
It is clamped SETTLE after it has come to rest at home, and released as
soon as it is commanded to move: docking takes place against a platform that cannot yield.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.frames import Array, pose_step, twist_between
from hiltestbed.platform.prs3.allocation import share
from hiltestbed.platform.prs3.drives import UpperDrives, UpperMotion
from hiltestbed.platform.prs3.geometry import Upper, inverse, place, slider

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario

SETTLE = 0.1  # [s] after which an error of a critically damped 25 Hz loop has decayed to 3e-6


@njit(cache=True)
def _plan(upper, h, settle, pose, diverged, motion):
    """Advance to the coordinates for ``pose`` (n, 7); returns whether a run is or was away."""
    x, rate, speed, xs = motion.x, motion.rate, motion.speed, motion.xs
    still, away, planned, slope = motion.still, motion.away, motion.planned, motion.slope
    sliders = motion.sliders
    m = xs.shape[1]
    busy = False
    goal, before, arm = np.empty(3), np.empty(7), np.empty(3)
    for i in range(pose.shape[0]):
        goal[:] = x[i]
        share(pose[i], goal)
        moves = False
        for j in range(3):
            moves = moves or goal[j] != 0.0 or x[i, j] != 0.0
            new = (goal[j] - x[i, j]) / h
            leave = new + 0.5 * (new - rate[i, j])
            for s in range(m):
                t = (s + 1.0) / m
                a = goal[j] - x[i, j]
                b, c = h * speed[i, j], h * leave
                xs[i, s, j] = x[i, j] + t * (
                    b + t * ((3.0 * a - 2.0 * b - c) + t * (b + c - 2.0 * a))
                )
            xs[i, m - 1, j] = goal[j]
            rate[i, j], speed[i, j] = new, leave
        still[i] = 0 if moves else still[i] + 1
        away[i] = still[i] <= settle and not diverged[i]
        busy = busy or away[i] or motion.was_away[i]
        before[:] = planned[i]
        if moves:
            x[i] = goal
            place(upper.shape, goal, planned[i])
            twist_between(before, planned[i], h, slope[i])
            for j in range(3):
                sliders[i, j] = slider(upper.legs[j], planned[i], arm)
        else:
            slope[i] = 0.0
            sliders[i] = 0.0
        motion.reached[i] = planned[i]
        motion.twist[i] = slope[i]
        motion.slid[i] = sliders[i]
    return busy


def _begin(shape, pose, twist, h, motion):
    """Coordinates, rates, pose and twist of P for ports that have moved uniformly."""
    x, planned = motion.x, motion.planned
    before, x_before, place_before = np.empty(7), np.zeros(3), np.empty(7)
    for i in range(pose.shape[0]):
        x[i] = 0.0
        x_before[:] = 0.0
        pose_step(pose[i], twist[i], -h, before)
        share(pose[i], x[i])
        share(before, x_before)
        for j in range(3):
            motion.rate[i, j] = (x[i, j] - x_before[j]) / h
        place(shape, x[i], planned[i])
        place(shape, x_before, place_before)
        twist_between(place_before, planned[i], h, motion.slope[i])


class MovingUpper:
    """The upper platforms of `n` runs.

    Attributes:
        motion: see :class:`UpperMotion`; while clamped, reached is exactly home. drives: None if
            they are not simulated.
        residual: (n, m, 6) residual of the payload in the sensor's reading, at the m instants of
            the tick, in P [N, N m].
    """

    def __init__(self, scenarios: Sequence[Scenario], nthread: int) -> None:
        first, n = scenarios[0], len(scenarios)
        self.tick, m = first.tick, first.substeps
        self._settle = math.ceil(SETTLE / first.tick)
        self.motion = UpperMotion(
            x=np.zeros((n, 3)),
            rate=np.zeros((n, 3)),
            speed=np.zeros((n, 3)),
            still=np.zeros(n, dtype=np.int64),
            away=np.zeros(n, dtype=bool),
            was_away=np.zeros(n, dtype=bool),
            xs=np.zeros((n, m, 3)),
            planned=np.zeros((n, 7)),
            slope=np.zeros((n, 6)),
            sliders=np.zeros((n, 3)),
            reached=np.zeros((n, 7)),
            twist=np.zeros((n, 6)),
            slid=np.zeros((n, 3)),
        )
        servo = first.rig.upper.tracking == "servo"
        self.drives = UpperDrives(scenarios, nthread, self.motion) if servo else None
        at = Upper.load(), self.tick, self._settle
        self._planned = Call(_plan, *at, GIVEN, GIVEN, self.motion)
        self.residual = self.drives.residual if self.drives else np.zeros((n, m, 6))

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the coordinates for the relative ``pose`` (n, 7) and ``twist`` (n, 6)."""
        upper, motion = Upper.load(), self.motion
        interpreted(_begin)(upper.shape, pose, twist, self.tick, motion)
        motion.speed[:] = motion.rate
        motion.away[:] = motion.was_away[:] = motion.x.any(axis=1)
        motion.still[:] = np.where(motion.away, 0, self._settle + 1)
        motion.reached[:], motion.twist[:] = motion.planned, motion.slope
        interpreted(inverse)(upper.legs, motion.planned, motion.sliders)
        motion.slid[:] = motion.sliders
        self.residual[:] = 0.0
        if self.drives:
            self.drives.left[:] = 0.0
            for i in range(len(pose)):
                self.drives.settle(i, motion.x[i], motion.rate[i])

    def advance(self, pose: Array, diverged: NDArray[np.bool_]) -> bool:
        """One tick towards the relative ``pose`` (n, 7); returns whether a run diverged."""
        drives, motion = self.drives, self.motion
        if not self._planned.on(pose, diverged)() or drives is None:
            return False
        # now clamped: its next motion starts from home
        for i in np.flatnonzero(motion.was_away & ~motion.away & ~diverged):
            drives.settle(int(i), np.zeros(3), np.zeros(3))
        motion.was_away[:] = motion.away
        drives.run(np.flatnonzero(motion.away))
        return drives.observe(diverged)
