"""A rig for drawing: its model with all visual parts, and its joints at given relative poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.models import load
from hiltestbed.contact.composition import ACTIVE, add_side, drawn
from hiltestbed.frames import Array, pose_compose
from hiltestbed.platform.facilities.composed import TOOL, facility_model, facility_spec
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import MOUNT, TOOL_HOME, UPRIGHT, Facility, Runs
from hiltestbed.platform.facilities.prs3 import (
    Upper,
    place,
    upper_coordinates,
    upper_kinematics,
)
from hiltestbed.platform.facilities.upper_drives import add_upper_passive

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

STEP = 1e-3  # [s] nothing is stepped
UPPER = "upper_"  # prefix of the names of the upper platform


class DrawnFacility:
    """A facility with its mechanism, at poses that it has reached."""

    def __init__(self, facility: Facility, mechanism: Mechanism, runs: Runs) -> None:
        """``runs``: the one run whose drives have the facility's joints."""
        structure = drawn(mechanism)
        self.model = facility_spec(facility, structure, STEP).compile()
        stepped = facility_model(facility, structure, STEP)
        self._mover = facility.drives(stepped, runs, TOOL)
        self._last: tuple[Array, tuple[Array, Array]] | None = None

    def port_poses(self, rows: NDArray[np.intp], pose_cmd: Array, pose: Array) -> Array:
        """``(frames, 7)`` poses of P in W at the rows, at which A has ``pose`` (frames, 7) in P.

        For freely moving bodies P is drawn at home: a record contains only their relative pose.
        """
        return self._solved(pose)[1]

    def joints(self, pose: Array, pose_P: Array) -> Array:
        """Joint positions ``(frames, nq)`` at the poses ``(frames, 7)`` of A in P."""
        return self._solved(pose)[0]

    def _solved(self, pose: Array) -> tuple[Array, Array]:
        if self._last is not None and np.array_equal(self._last[0], pose):
            return self._last[1]
        qpos, place = np.tile(self.model.qpos0, (len(pose), 1)), np.tile(UPRIGHT, (len(pose), 1))
        for f in range(len(pose)):
            mover = self._mover
            if not isinstance(mover, Drives):
                qpos[f], _ = mover.kinematics.nearest(np.array([pose[f], UPRIGHT]))
                continue
            mover.follow(pose[f : f + 1], np.zeros((1, 6)))
            qpos[f] = mover.solution[0]
            if mover.poses.shape[1] > 1:
                place[f] = mover.poses[0, 1]
        self._last = (pose.copy(), (qpos, place))
        return qpos, place


class DrawnNineAxes:
    """Both platforms with their mechanisms; the interface is that of :class:`DrawnFacility`."""

    def __init__(self, facility: Facility, mechanism: Mechanism) -> None:
        spec = load("pss33/pss33")
        spec.modelname = f"pss33-prs3-{mechanism.kind}"
        spec.attach(load("prs3/prs3"), prefix=UPPER, frame=spec.worldbody.add_frame())
        site = spec.site(MOUNT)
        made_of, plane = drawn(mechanism), np.array(site.pos)
        add_side(spec, made_of.mechanism, ACTIVE, site.parent, plane, TOOL_HOME[:3])
        add_upper_passive(spec, mechanism, UPPER)
        self.model = spec.compile()
        self._lower = facility.kinematics(self.model, ACTIVE + "A")
        self._upper = upper_kinematics(self.model, UPPER)

    def port_poses(self, rows: NDArray[np.intp], pose_cmd: Array, pose: Array) -> Array:
        """``(frames, 7)`` planned poses of P in W at the rows of ``pose_cmd`` (ticks, 7)."""
        out = np.empty((len(rows), 7))
        # commanded one tick before it is reached
        for goal, x in zip(out, upper_coordinates(pose_cmd[np.maximum(rows - 1, 0)]), strict=True):
            place(Upper.load().shape, x, goal)
        return out

    def joints(self, pose: Array, pose_P: Array) -> Array:
        """Joint positions ``(frames, nq)`` at the poses ``(frames, 7)`` of A in P and of P in W."""
        out, pose_A = np.empty((len(pose), self.model.nq)), np.empty(7)
        for q, at, port in zip(out, pose, pose_P, strict=True):
            pose_compose(port, at, pose_A)
            q[:] = self._upper.solve(port, start=self._lower.solve(pose_A)[0])[0]
        return out
