"""The nine-axis rig for drawing: one model of both platforms, and its joints at recorded poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.contact.composition import ACTIVE
from hiltestbed.frames import Array, pose_compose, quat_to_mujoco, rotation_matrix
from hiltestbed.platform.build import facility_of
from hiltestbed.platform.model import UPPER, nine_axis_scene
from hiltestbed.platform.prs3.allocation import upper_coordinates
from hiltestbed.platform.prs3.geometry import Upper, place, revolute, slider

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiltestbed.scenario.like import ScenarioLike as Scenario


class DrawnNineAxes:
    """Both platforms with their mechanisms, at poses that they have reached; the interface is that
    of :class:`hiltestbed.platform.facilities.drawing.DrawnFacility`.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.model = m = nine_axis_scene(scenario.mechanism)
        self._lower = facility_of(scenario).kinematics(m, ACTIVE + "A")
        self._upper = Upper.load()
        self._legs = [int(m.joint(f"{UPPER}slider_{j}").qposadr[0]) for j in range(3)]
        self._free = int(m.joint(f"{UPPER}platform").qposadr[0])

    def port_poses(self, rows: NDArray[np.intp], pose_cmd: Array, pose: Array) -> Array:
        """``(frames, 7)`` planned poses of P in W at the rows of ``pose_cmd`` (ticks, 7)."""
        out = np.empty((len(rows), 7))
        # commanded one tick before it is reached
        for goal, x in zip(out, upper_coordinates(pose_cmd[np.maximum(rows - 1, 0)]), strict=True):
            place(self._upper.shape, x, goal)
        return out

    def joints(self, pose: Array, pose_P: Array) -> Array:
        """Joint positions ``(frames, nq)`` at the poses ``(frames, 7)`` of A in P and of P in W."""
        out, pose_A, arm = np.empty((len(pose), self.model.nq)), np.empty(7), np.empty(3)
        offset = self.model.qpos0[self._free : self._free + 3]
        for q, at, port in zip(out, pose, pose_P, strict=True):
            pose_compose(port, at, pose_A)
            q[:] = self._lower.solve(pose_A)[0]
            for j, leg in zip(self._legs, self._upper.legs, strict=True):
                q[j] = slider(leg, port, arm)
                q[j + 1] = revolute(leg, port, arm)
            q[self._free : self._free + 3] = port[:3] + rotation_matrix(port[3:]) @ offset
            q[self._free + 3 : self._free + 7] = quat_to_mujoco(port[3:])
        return out
