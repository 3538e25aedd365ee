"""The 3-3 PSS platform with the interface of a facility, so that all measurements of facilities
work on it as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import MOUNT, Facility, Response, add_carrier, frame_of
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.pss33.servo import Servo
from hiltestbed.platform.pss33.settings import Pss33


class SliderDrives(Drives):
    """Drives of the six sliders: the servo of the plant, with A as the controlled point."""

    def __init__(
        self,
        model: mujoco.MjModel,
        kinematics: Kinematics,
        settings: Sequence[Pss33],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str,
    ) -> None:
        cycles, lates = (
            [s.command.cycle(1.0 / tick) for s in settings],
            [s.command.delay_cycles for s in settings],
        )
        super().__init__(model, kinematics, tick, substeps, cycles, lates, feed)
        self.servo = Servo(model, settings, tick, substeps, feed, tool)

    def settle(self, pose: Array, twist: Array, qpos: Array, qvel: Array) -> None:
        super().settle(pose, twist, qpos, qvel)
        self.servo.settle(pose, twist, qpos, qvel)

    def aim(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        self.servo.aim(pose_cmd, twist_cmd, accel_cmd)

    def push(self, sub: int, qpos: Array, qvel: Array, ctrl: Array) -> None:
        self.servo.push(sub, qpos, qvel, ctrl)

    def arrive(self) -> None:
        self.servo.arrive()
        self.reference[:] = self.servo.target

    def state(self) -> dict[str, NDArray[Any]]:
        return super().state() | self.servo.state()


class Pss33Facility(Facility):
    """The platform of ``models/pss33``."""

    settings: Pss33

    @property
    def axes(self) -> tuple[Axis, ...]:
        s = self.settings.limits
        return tuple(
            Axis(f"slider_{j}", "m", -s.stroke, s.stroke, s.speed, s.acceleration, s.force)
            for j in range(6)
        )

    def spec(self) -> mujoco.MjSpec:
        spec = load("pss33/pss33")
        frame_of(spec)
        add_carrier(spec.worldbody)
        spec.option.gravity = [0.0, 0.0, -9.81]
        return spec

    def drives(
        self,
        model: mujoco.MjModel,
        settings: Sequence[Any],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str = MOUNT,
    ) -> Drives:
        return SliderDrives(
            model, self.kinematics(model, tool), settings, tick, substeps, feed, tool
        )

    def response(self, rate: float, feed: bool) -> Response:
        s = self.settings
        return Response(
            (s.bandwidth,) * 6, (s.damping_ratio,) * 6, s.command.lag(rate), followed=feed
        )
