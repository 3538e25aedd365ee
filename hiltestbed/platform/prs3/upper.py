"""The upper platform of `n` rigs: pose of the passive port, tick by tick, and clamping.

Over a tick its coordinates follow the cubic that reaches the allocated ones
(:mod:`hiltestbed.platform.prs3.allocation`) at t_(k+1) and leaves them with their velocity there.
It is clamped SETTLE after it has come to rest at home, and released as
soon as it is commanded to move: docking takes place against a platform that cannot yield.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, pose_step, twist_between
from hiltestbed.platform.prs3.allocation import share
from hiltestbed.platform.prs3.drives import UpperDrives
from hiltestbed.platform.prs3.geometry import Upper, inverse, place, slider

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario

SETTLE = 0.1  # [s] after which an error of a critically damped 25 Hz loop has decayed to 3e-6


class UpperMotion(NamedTuple):
    """The motion of n upper platforms.

    Attributes:
        x, rate, speed: (n, 3) coordinates, their mean rate over the last tick, and the velocity of
            the cubic at its end. still: (n,) ticks at home. away, was_away: (n,) bool, not clamped
            in this tick and in the last one. xs: (n, m, 3) coordinates at the ends of the substeps.
        planned (n, 7), slope (n, 6): P in W at the end, and its slope over the tick. sliders: (n,
            3) at the end. reached (n, 7), twist (n, 6) and slid (n, 3): set to these.
    """

    x: Array
    rate: Array
    speed: Array
    still: NDArray[np.int64]
    away: NDArray[np.bool_]
    was_away: NDArray[np.bool_]
    xs: Array
    planned: Array
    slope: Array
    sliders: Array
    reached: Array
    twist: Array
    slid: Array


@njit(cache=True)
def _plan(shape, legs, h, settle, pose, diverged, *given):
    """Advance to the coordinates for the relative poses ``(n, 7)`` at the end of the tick ``h``;
    returns whether a run is or was away. given: the fields of UpperMotion.
    """
    motion = UpperMotion(*given)
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
                xs[i, s, j] = (
                    goal[j]
                    if s == m - 1
                    else x[i, j] + t * (b + t * ((3.0 * a - 2.0 * b - c) + t * (b + c - 2.0 * a)))
                )
            rate[i, j], speed[i, j] = new, leave
        still[i] = 0 if moves else still[i] + 1
        away[i] = still[i] <= settle and not diverged[i]
        busy = busy or away[i] or motion.was_away[i]
        before[:] = planned[i]
        if moves:
            x[i] = goal
            place(shape, goal, planned[i])
            twist_between(before, planned[i], h, slope[i])
            for j in range(3):
                sliders[i, j] = slider(legs[j], planned[i], arm)
        else:
            slope[i] = 0.0
            sliders[i] = 0.0
        motion.reached[i] = planned[i]
        motion.twist[i] = slope[i]
        motion.slid[i] = sliders[i]
    return busy


@njit(cache=True)
def _begin(shape, pose, twist, h, x, rate, planned, planned_twist):
    """Coordinates, their rates and P's pose and twist for a rig whose ports have moved uniformly to
    ``pose`` with ``twist``.
    """
    before, x_before, place_before = np.empty(7), np.zeros(3), np.empty(7)
    for i in range(pose.shape[0]):
        x[i] = 0.0
        x_before[:] = 0.0
        pose_step(pose[i], twist[i], -h, before)
        share(pose[i], x[i])
        share(before, x_before)
        for j in range(3):
            rate[i, j] = (x[i, j] - x_before[j]) / h
        place(shape, x[i], planned[i])
        place(shape, x_before, place_before)
        twist_between(place_before, planned[i], h, planned_twist[i])


class MovingUpper:
    """The upper platforms of `n` runs.

    Attributes:
        planned: (n, 7) pose of P in W that is to be reached at t_(k+1).
        pose, twist: (n, 7), (n, 6) of P in W as reached; while clamped exactly home.
        slider_cmd, slider_act: (n, 3) its sliders [m], 0 at home.
        residual: (n, m, 6) residual of the payload in the sensor's reading, at the m instants of
            the tick, in P [N, N m].
        away: (n,) bool, not clamped. x: (n, 3) coordinates, heave [m] and tilts [rad]; rate: (n, 3)
            their mean rate over the last tick.
    """

    def __init__(self, scenarios: Sequence[Scenario], nthread: int) -> None:
        first, n = scenarios[0], len(scenarios)
        self.tick = first.tick
        self._settle = math.ceil(SETTLE / first.tick)
        self._shape, self._legs = Upper.load().shape, Upper.load().legs
        self.drives = (
            UpperDrives(scenarios, nthread) if first.rig.upper.tracking == "servo" else None
        )
        self.x, self.rate, self._speed = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self._still = np.zeros(n, dtype=np.int64)
        self.away = np.zeros(n, dtype=bool)
        self._was_away = np.zeros(n, dtype=bool)
        self._xs = np.zeros((n, first.substeps, 3))
        self.planned, self._slope = np.zeros((n, 7)), np.zeros((n, 6))
        self.pose, self.twist = np.zeros((n, 7)), np.zeros((n, 6))
        self.slider_cmd, self.slider_act = np.zeros((n, 3)), np.zeros((n, 3))
        self._planned = Call(
            _plan,
            self._shape,
            self._legs,
            self.tick,
            self._settle,
            GIVEN,
            GIVEN,
            *UpperMotion(
                x=self.x,
                rate=self.rate,
                speed=self._speed,
                still=self._still,
                away=self.away,
                was_away=self._was_away,
                xs=self._xs,
                planned=self.planned,
                slope=self._slope,
                sliders=self.slider_cmd,
                reached=self.pose,
                twist=self.twist,
                slid=self.slider_act,
            ),
        )
        self.residual = self.drives.residual if self.drives else np.zeros((n, first.substeps, 6))

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the coordinates for the relative ``pose`` (n, 7), with the rates for the uniform
        relative ``twist`` (n, 6).
        """
        _begin(self._shape, pose, twist, self.tick, self.x, self.rate, self.planned, self._slope)
        self._speed[:] = self.rate
        self.away[:] = self.x.any(axis=1)
        self._still[:] = np.where(self.away, 0, self._settle + 1)
        self._was_away[:] = self.away
        self.pose[:], self.twist[:] = self.planned, self._slope
        inverse(self._legs, self.planned, self.slider_cmd)
        self.slider_act[:] = self.slider_cmd
        self.residual[:] = 0.0
        if self.drives:
            self.drives.left[:] = 0.0
            for i in range(len(pose)):
                self.drives.settle(i, self.x[i], self.rate[i])

    def advance(self, pose: Array, diverged: NDArray[np.bool_]) -> bool:
        """One tick towards the relative ``pose`` (n, 7); returns whether a run has just
        ``diverged`` (n,).
        """
        busy = self._planned.on(pose, diverged)()
        return self._drive(self.drives, diverged) if busy and self.drives else False

    def _drive(self, drives: UpperDrives, diverged: NDArray[np.bool_]) -> bool:
        # now clamped: its next motion starts from home
        for i in np.flatnonzero(self._was_away & ~self.away & ~diverged):
            drives.settle(int(i), np.zeros(3), np.zeros(3))
        self._was_away[:] = self.away
        drives.run(self._xs, self.away, np.flatnonzero(self.away))
        return drives.observe(self.away, self.pose, self.twist, self.slider_act, diverged)
