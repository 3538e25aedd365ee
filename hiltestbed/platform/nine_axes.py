"""The nine-axis rig: the lower platform's six axes and the upper one's three realise one relative
pose.

Over a tick the upper platform's coordinates follow the cubic that reaches the allocated ones
(:mod:`hiltestbed.platform.facilities.prs3`) at t_(k+1) and leaves them with their velocity there.
It is clamped SETTLE after it has come to rest at home, and released as soon as it is commanded to
move: docking takes place against a platform that cannot yield. The lower one is commanded to the
resulting pose of A in W. Ports can touch only while the upper platform is clamped at home, where W
and P coincide and the lower platform's command equals that without an upper one, bit for bit. The
sensor's wrench is that of the contact plus the uncompensated rest of the moving payload:
`payload_left` in a run's summary, some 0.05 N of 1177 N.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import copied, interpreted, njit
from hiltestbed.contact.wrench import relate
from hiltestbed.frames import Array, pose_compose, pose_step, twist_between
from hiltestbed.platform.driven import ServoTracking
from hiltestbed.platform.facilities.limbs import slider
from hiltestbed.platform.facilities.motion import GRAVITY
from hiltestbed.platform.facilities.prs3 import Upper, place, share
from hiltestbed.platform.facilities.upper_drives import UpperDrives
from hiltestbed.platform.ideal import IdealTracking
from hiltestbed.platform.parameters import RigParameters

SETTLE = 0.1  # [s] after which an error of a critically damped 25 Hz loop has decayed to 3e-6


class UpperMotion(NamedTuple):
    """The motion of n upper platforms.

    Attributes:
        x, rate, speed: (n, 3) coordinates, their mean rate over the last tick, and the velocity of
            the cubic at its end. still: (n,) ticks at home. away, was_away: (n,) bool, not clamped
            in this tick and in the last one. xs: (n, m, 3) coordinates at the ends of the substeps.
        planned (n, 7), slope (n, 6): P in W at the end, and its slope over the tick. sliders: (n,
            3) at the end. reached (n, 7), twist (n, 6), slid (n, 3): these, or what drives reach.
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
def _plan(upper, h, settle, pose, diverged, motion):
    """Advance to the coordinates for ``pose`` (n, 7); returns whether a run is or was away."""
    x, rate, speed, xs = motion.x, motion.rate, motion.speed, motion.xs
    still, away, planned, slope = motion.still, motion.away, motion.planned, motion.slope
    sliders = motion.sliders
    m = xs.shape[1]
    busy = False
    goal, before, arm = np.empty(3), np.empty(7), np.empty(3)
    for i in range(pose.shape[0]):
        copied(x[i], goal)
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
        copied(planned[i], before)
        if moves:
            copied(goal, x[i])
            place(upper.shape, goal, planned[i])
            twist_between(before, planned[i], h, slope[i])
            for j in range(3):
                sliders[i, j] = slider(upper.limbs[j], planned[i], arm)
        else:
            slope[i] = 0.0
            sliders[i] = 0.0
        copied(planned[i], motion.reached[i])
        copied(slope[i], motion.twist[i])
        copied(sliders[i], motion.slid[i])
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
        motion: while clamped, reached is exactly home. drives: None if
            they are not simulated.
        residual: (n, m, 6) residual of the payload in the sensor's reading, at the m instants of
            the tick, in P [N, N m].
    """

    def __init__(self, parameters: RigParameters, nthread: int) -> None:
        runs, n = parameters.runs, len(parameters.start)
        self.tick, m = runs.tick, runs.substeps
        self._settle = math.ceil(SETTLE / runs.tick)
        self.drives = drives = None
        if parameters.upper == "servo":
            mechanism = parameters.structure.mechanism
            self.drives = drives = UpperDrives(mechanism, runs.tick, m, n, nthread)
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
            reached=drives.pose if drives else np.zeros((n, 7)),
            twist=drives.twist if drives else np.zeros((n, 6)),
            slid=drives.joints if drives else np.zeros((n, 3)),
        )
        at = Upper.load(), self.tick, self._settle
        self._planned = Call(_plan, *at, GIVEN, GIVEN, self.motion)
        self.residual = drives.residual if drives else np.zeros((n, m, 6))

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the coordinates for the relative ``pose`` (n, 7) and ``twist`` (n, 6)."""
        upper, motion = Upper.load(), self.motion
        interpreted(_begin)(upper.shape, pose, twist, self.tick, motion)
        motion.speed[:] = motion.rate
        motion.away[:] = motion.was_away[:] = motion.x.any(axis=1)
        motion.still[:] = np.where(motion.away, 0, self._settle + 1)
        motion.reached[:], motion.twist[:] = motion.planned, motion.slope
        arm = np.empty(3)
        for pose_P, sliders in zip(motion.planned, motion.sliders, strict=True):
            sliders[:] = [slider(limb, pose_P, arm) for limb in upper.limbs]
        motion.slid[:] = motion.sliders
        self.residual[:] = 0.0
        if self.drives:
            self.drives.left[:] = 0.0
            for i in range(len(pose)):
                self.drives.start(i, motion.x[i], motion.rate[i])

    def advance(self, pose: Array, diverged: NDArray[np.bool_]) -> bool:
        """One tick towards the relative ``pose`` (n, 7); returns whether a run diverged."""
        drives, motion = self.drives, self.motion
        if not self._planned.on(pose, diverged)() or drives is None:
            return False
        # now clamped: its next motion starts from home
        for i in np.flatnonzero(motion.was_away & ~motion.away & ~diverged):
            drives.start(int(i), np.zeros(3), np.zeros(3))
        motion.was_away[:] = motion.away
        drives.run(motion.away, motion.xs)
        return drives.look(motion.away, diverged)


@njit(cache=True)
def _command(h, upper, command, pose, twist, accel):
    """The command in W for that of A in P; ``upper`` is at the end of the tick.

    command: was_home (n,) whether the upper platform's coordinates were 0 at the start of the tick;
    pose (n, 7) and slope (n, 6) of the last tick's command; pose, twist and accel of this one.
    """
    x, (was_home, before, slope, goal, speed, bend) = upper.x, command
    for i in range(pose.shape[0]):
        home = x[i, 0] == 0.0 and x[i, 1] == 0.0 and x[i, 2] == 0.0
        if home and was_home[i]:
            copied(pose[i], goal[i])
            copied(twist[i], speed[i])
            copied(accel[i], bend[i])
        else:
            pose_compose(upper.planned[i], pose[i], goal[i])
            twist_between(before[i], goal[i], h, speed[i])
            for j in range(6):
                bend[i, j] = (speed[i, j] - slope[i, j]) / h
        was_home[i] = home
        copied(goal[i], before[i])
        copied(speed[i], slope[i])


@njit(cache=True)
def _together(ideal, h, residual, upper, lower, both):
    """Relative pose and twist from those of A and of P in W, and the sensor's wrench as the sum of
    contact and payload ``residual``.

    ideal: while the upper platform is away from home, the twist is the slope of the relative pose
        over the tick ``h``. lower: pose and twist of A in W, contact wrench; both: relative pose,
        twist and wrench.
    """
    pose_W, twist_W, contact = lower
    pose, twist, wrench = both
    before = pose.copy()
    relate(pose_W, twist_W, upper.reached, upper.twist, pose, twist)
    for i in range(pose.shape[0]):
        if ideal and upper.away[i]:
            twist_between(before[i], pose[i], h, twist[i])
        for s in range(wrench.shape[1]):
            for j in range(6):
                wrench[i, s, j] = contact[i, s, j] + residual[i, s, j]


class NineAxes:
    """The rigs of `n` runs; arrays as in :class:`hiltestbed.platform.plant.Plant`."""

    def __init__(
        self, parameters: RigParameters, lower: ServoTracking | IdealTracking, nthread: int
    ) -> None:
        n, self.tick = len(parameters.start), parameters.runs.tick
        self.lower, self.upper = lower, MovingUpper(parameters, nthread)
        self.upper_cmd, self.upper_act = self.upper.motion.sliders.copy(), np.zeros((n, 3))
        self.pose_act, self.twist_act = np.zeros((n, 7)), np.zeros((n, 6))
        self.wrench_sub = np.zeros_like(lower.wrench_sub)
        self._left = np.zeros((n, 6))  # residual of the payload in the reading at t_k
        self._command = np.zeros(n, dtype=bool), *(np.zeros((n, k)) for k in (7, 6, 7, 6, 6))
        motion, ideal = self.upper.motion, isinstance(lower, IdealTracking)
        self._commanded = Call(_command, self.tick, motion, self._command, *(GIVEN,) * 3)
        self._joined = bound(
            _together,
            ideal,
            self.tick,
            self.upper.residual,
            motion,
            (lower.pose_act, lower.twist_act, lower.wrench_sub),
            (self.pose_act, self.twist_act, self.wrench_sub),
        )

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the relative ``pose`` (n, 7), moving with ``twist`` (n, 6)."""
        self.upper.reset(pose, twist)
        motion, (was_home, start, slope, goal, *_) = self.upper.motion, self._command
        before, x, place_before = np.empty(7), np.zeros(3), np.empty(7)
        for i in range(len(pose)):
            pose_compose(motion.planned[i], pose[i], start[i])
            pose_step(pose[i], twist[i], -self.tick, before)
            x[:] = motion.x[i] - self.tick * motion.rate[i]
            place(Upper.load().shape, x, place_before)
            pose_compose(place_before, before, goal[i])
            twist_between(goal[i], start[i], self.tick, slope[i])
        was_home[:] = ~motion.away
        slope[was_home] = twist[was_home]
        for i in range(len(pose)):
            self.lower.path.begin(i, start[i, :3], slope[i, :3])
        self.lower.reset(start, slope)
        at_A, at_P = (self.lower.pose_act, self.lower.twist_act), (motion.reached, motion.twist)
        relate(*at_A, *at_P, self.pose_act, self.twist_act)
        self.wrench_sub[:] = self.lower.wrench_sub
        self.upper_cmd[:], self.upper_act[:] = motion.sliders, motion.slid

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Start the tick towards the relative ``pose_cmd`` (n, 7), with ``twist_cmd`` and
        ``accel_cmd`` (n, 6).

        The upper platform's tick is computed at once; its published state stays that of t_k until
        :meth:`finish`.
        """
        upper, lower = self.upper, self.lower
        self._left[:] = upper.residual[:, -1]
        if upper.advance(pose_cmd, lower.diverged):
            for i in np.flatnonzero(lower.diverged):
                lower.causes[i] = (
                    lower.causes[i] or "the upper platform moves faster than 1000 m/s or rad/s"
                )
        self._commanded.on(pose_cmd, twist_cmd, accel_cmd)()
        lower.begin(*self._command[3:])
        np.add(lower.wrench_sub[:, -1], self._left, out=self.wrench_sub[:, -1])

    def finish(self) -> None:
        """The rest of the tick."""
        self.lower.finish()
        self._joined()
        self.upper_cmd[:], self.upper_act[:] = self.upper.motion.sliders, self.upper.motion.slid

    def payload_left(self, i: int) -> dict[str, float] | None:
        """Largest residual of the passive side's load in the reading of run ``i``, or None."""
        drives = self.upper.drives
        if drives is None:
            return None
        weight = float(drives.payload[0] * GRAVITY)
        force, torque = (float(v) for v in drives.left[i])
        return {"weight": weight, "force": force, "torque": torque, "share": force / weight}
