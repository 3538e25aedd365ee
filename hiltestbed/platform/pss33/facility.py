"""The 3-3 PSS platform of ``models/pss33``, below the frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.models import load
from hiltestbed.platform.facilities.facility import (
    MOUNT,
    MOUNT_HOME,
    UPRIGHT,
    Facility,
    Response,
    add_carrier,
    frame_of,
)
from hiltestbed.platform.facilities.kinematics import Axis
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

    def drives(
        self,
        model: mujoco.MjModel,
        settings: Sequence[Any],
        tick: float,
        substeps: int,
        feed: NDArray[np.bool_],
        tool: str = MOUNT,
    ) -> SliderDrives:
        return SliderDrives(model, self.kinematics(model, tool), tick, substeps, settings, feed)

    def response(self, rate: float, feed: bool) -> Response:
        s = self.settings
        return Response(
            (s.bandwidth,) * 6, (s.damping_ratio,) * 6, s.command.lag(rate), followed=feed
        )
