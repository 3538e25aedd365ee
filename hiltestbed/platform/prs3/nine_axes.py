"""The nine-axis rig: the lower platform's six axes and the upper one's three realise one relative
pose.

The upper platform moves to the pose given by the allocation
(:mod:`hiltestbed.platform.prs3.allocation`); the lower one is commanded to the resulting pose of A
in W. Ports can touch only while the upper platform is clamped at home, where W and P coincide and
the lower platform's command equals that without an upper one, bit for bit. The sensor's wrench is
that of the contact plus the uncompensated rest
of the moving payload: `payload_left` in a run's summary, some 0.05 N of 1177 N.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from hiltestbed.compiled.bound import GIVEN, Call, bound
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.wrench import relate
from hiltestbed.frames import Array, pose_compose, pose_step, twist_between
from hiltestbed.platform.driven import ServoTracking
from hiltestbed.platform.ideal import IdealTracking
from hiltestbed.platform.payload import GRAVITY
from hiltestbed.platform.prs3.geometry import Upper, place
from hiltestbed.platform.prs3.upper import MovingUpper

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario


@njit(cache=True)
def _command(h, planned, x, pose, twist, accel, *given):
    """The lower platform's command in W for that of A in P, ``pose`` (n, 7), ``twist`` and
    ``accel`` (n, 6).

    planned (n, 7), x (n, 3): P in W and the upper platform's coordinates at the end of the tick.
    given: was_home (n,), whether these were 0 at its start; before (n, 7), slope (n, 6), the
        command of the last tick and its slope; all updated; and that command's pose_W, twist_W and
        accel_W.
    """
    was_home, before, slope, pose_W, twist_W, accel_W = given
    for i in range(pose.shape[0]):
        home = x[i, 0] == 0.0 and x[i, 1] == 0.0 and x[i, 2] == 0.0
        if home and was_home[i]:
            pose_W[i], twist_W[i], accel_W[i] = pose[i], twist[i], accel[i]
        else:
            pose_compose(planned[i], pose[i], pose_W[i])
            twist_between(before[i], pose_W[i], h, twist_W[i])
            for j in range(6):
                accel_W[i, j] = (twist_W[i, j] - slope[i, j]) / h
        was_home[i] = home
        before[i] = pose_W[i]
        slope[i] = twist_W[i]


@njit(cache=True)
def _together(ideal, h, away, residual, *given):
    """Relative pose and twist from those of A and of P in W, and the sensor's wrench as the sum of
    contact and payload ``residual``.

    ideal: while the upper platform is away from home, the twist is the slope of the relative pose
        over the tick ``h``. given: pose, twist and wrench of the lower platform in W; pose and
        twist of P; relative pose, twist and wrench.
    """
    pose_W, twist_W, lower_wrench, place_P, motion_P, pose, twist, wrench = given
    before = pose.copy()
    relate(pose_W, twist_W, place_P, motion_P, pose, twist)
    for i in range(pose.shape[0]):
        if ideal and away[i]:
            twist_between(before[i], pose[i], h, twist[i])
        for s in range(wrench.shape[1]):
            for j in range(6):
                wrench[i, s, j] = lower_wrench[i, s, j] + residual[i, s, j]


class NineAxes:
    """The rigs of `n` runs with both platforms; arrays as in
    :class:`hiltestbed.platform.plant.Plant`.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], lower: ServoTracking | IdealTracking, nthread: int
    ) -> None:
        n, first = len(scenarios), scenarios[0]
        self.lower, self.upper = lower, MovingUpper(scenarios, nthread)
        self.tick = first.tick
        self.contacts, self.causes, self.diverged = lower.contacts, lower.causes, lower.diverged
        self.contact_now, self.slider_cmd, self.slider_act = (
            lower.contact_now,
            lower.slider_cmd,
            lower.slider_act,
        )
        self.pose_act, self.twist_act = np.zeros((n, 7)), np.zeros((n, 6))
        self.wrench_sub = np.zeros_like(lower.wrench_sub)
        self._before, self._slope = np.zeros((n, 7)), np.zeros((n, 6))  # of the command in W
        self._pose_W, self._twist_W, self._accel_W = (
            np.zeros((n, 7)),
            np.zeros((n, 6)),
            np.zeros((n, 6)),
        )
        self._was_home = np.zeros(n, dtype=bool)
        self._left = np.zeros((n, 6))  # residual of the payload in the reading at t_k
        self.upper_cmd, self.upper_act = np.zeros((n, 3)), np.zeros((n, 3))

        self._commanded = Call(
            _command,
            self.tick,
            self.upper.planned,
            self.upper.x,
            *(GIVEN,) * 3,
            self._was_home,
            self._before,
            self._slope,
            self._pose_W,
            self._twist_W,
            self._accel_W,
        )
        self._joined = bound(
            _together,
            isinstance(lower, IdealTracking),
            self.tick,
            self.upper.away,
            self.upper.residual,
            lower.pose_act,
            lower.twist_act,
            lower.wrench_sub,
            self.upper.pose,
            self.upper.twist,
            self.pose_act,
            self.twist_act,
            self.wrench_sub,
        )

    @property
    def model(self) -> mujoco.MjModel:
        """The lower platform's model, which is the one stepped while the ports touch."""
        return self.lower.model

    def bare_steps(self, count: int) -> None:
        """``count`` steps of the lower platform."""
        self.lower.bare_steps(count)

    def reset(self, pose: Array, twist: Array) -> None:
        """Start at the relative ``pose`` (n, 7), moving with the uniform relative ``twist`` (n,
        6).
        """
        self.upper.reset(pose, twist)
        before, x, place_before = np.empty(7), np.zeros(3), np.empty(7)
        for i in range(len(pose)):
            pose_compose(self.upper.planned[i], pose[i], self._before[i])
            pose_step(pose[i], twist[i], -self.tick, before)
            x[:] = self.upper.x[i] - self.tick * self.upper.rate[i]
            place(Upper.load().shape, x, place_before)
            pose_compose(place_before, before, self._pose_W[i])
            twist_between(self._pose_W[i], self._before[i], self.tick, self._slope[i])
        self._was_home[:] = ~self.upper.away
        self._slope[self._was_home] = twist[self._was_home]
        for i in range(len(pose)):
            self.lower.path.begin(i, self._before[i, :3], self._slope[i, :3])
        self.lower.reset(self._before, self._slope)
        relate(
            self.lower.pose_act,
            self.lower.twist_act,
            self.upper.pose,
            self.upper.twist,
            self.pose_act,
            self.twist_act,
        )
        self.wrench_sub[:] = self.lower.wrench_sub
        self.upper_cmd[:], self.upper_act[:] = self.upper.slider_cmd, self.upper.slider_act

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Start the tick towards the relative ``pose_cmd`` (n, 7), with ``twist_cmd`` and
        ``accel_cmd`` (n, 6).

        The upper platform's tick is computed at once; its published state stays that of t_k until
        :meth:`finish`.
        """
        upper, lower = self.upper, self.lower
        self._left[:] = upper.residual[:, -1]
        if upper.advance(pose_cmd, self.diverged):
            for i in np.flatnonzero(self.diverged):
                self.causes[i] = (
                    self.causes[i] or "the upper platform moves faster than 1000 m/s or rad/s"
                )
        self._commanded.on(pose_cmd, twist_cmd, accel_cmd)()
        lower.begin(self._pose_W, self._twist_W, self._accel_W)
        np.add(lower.wrench_sub[:, -1], self._left, out=self.wrench_sub[:, -1])

    def finish(self) -> None:
        """The rest of the tick."""
        upper, lower = self.upper, self.lower
        lower.finish()
        self._joined()
        self.upper_cmd[:], self.upper_act[:] = upper.slider_cmd, upper.slider_act

    def payload_left(self, i: int) -> dict[str, float] | None:
        """Largest residual of the passive side's weight and inertia in the sensor's reading of run
        ``i``; None: not simulated.
        """
        drives = self.upper.drives
        if drives is None:
            return None
        weight = float(drives.payload[0] * GRAVITY)
        force, torque = (float(v) for v in drives.left[i])
        return {"weight": weight, "force": force, "torque": torque, "share": force / weight}
