"""The 3-3 PSS platform of ``models/pss33``, below the frame."""

from __future__ import annotations

import mujoco

from hiltestbed.config.models import load
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    UPRIGHT,
    Facility,
    add_carrier,
    frame_of,
)
from hiltestbed.platform.facilities.kinematics import Axis
from hiltestbed.platform.facilities.mover import Runs
from hiltestbed.platform.pss33.kinematics import SliderKinematics
from hiltestbed.platform.pss33.servo import SliderDrives
from hiltestbed.platform.pss33.settings import Pss33


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

    def kinematics(self, model: mujoco.MjModel, tool: str = MOUNT) -> SliderKinematics:
        origin = MOUNT_HOME[:3] if tool == MOUNT else UPRIGHT[:3]
        return SliderKinematics(model, tool, self.axes, origin)

    def drives(self, model: mujoco.MjModel, runs: Runs, tool: str = MOUNT) -> SliderDrives:
        return SliderDrives(model, self.kinematics(model, tool), runs)

    def bandwidth(self) -> float:
        return self.settings.bandwidth
