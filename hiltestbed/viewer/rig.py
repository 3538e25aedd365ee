"""The rig in 3-D: bodies drawn once, their poses at the frames.

Coordinates are in the rig's world W: its origin is the position of P (with an upper platform, its
home position), its z axis the insertion. Each moving body is an entity with its pose in W; bodies
that are welded to it are drawn in its frame. Whatever belongs to P, such as the contact force, is
below an entity with the pose of P.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hiltestbed.contact.composition import ACTIVE, PASSIVE
from hiltestbed.frames import Array, quat_from_mujoco
from hiltestbed.platform.build import facility_of, runs_of
from hiltestbed.platform.drawing import DrawnFacility, DrawnNineAxes
from hiltestbed.scenario import Scenario
from hiltestbed.signals import JOINT, RunTrace
from hiltestbed.viewer import colors
from hiltestbed.viewer.drawing import GLASS, log_solid, send_poses
from hiltestbed.viewer.solids import Solid, arrow, geom_solid

ROOT = "rig"
AT_P = f"{ROOT}/at_P"
CONTACT_FORCE = f"{AT_P}/contact_force"
PORT_NAMES = (f"{ROOT}/platform/port_A/name", f"{AT_P}/port_P/name")
DRAWN_GROUPS = 3  # geom groups 0 to 2 are drawn, as in MuJoCo's own viewer; 3 is for collision
TRIAD = 0.1  # [m] length of a port's axes


class RigScene:
    """The drawn model of a rig, and the joint positions for given poses of its ports."""

    def __init__(self, scenario: Scenario) -> None:
        facility, mechanism = facility_of(scenario), scenario.mechanism
        self._rig = (
            DrawnNineAxes(facility, mechanism)
            if scenario.rig.upper.kind == "prs3"
            else DrawnFacility(facility, mechanism, runs_of([scenario]))
        )
        self.model = self._rig.model
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.moving = sorted({int(b) for b in self.model.body_weldid if b > 0})

    def path(self, body: int) -> str:
        """Entity of a body: under the moving body that carries it, if any."""
        root = int(self.model.body_weldid[body])
        name = self.model.body(body).name or ("world" if body == 0 else f"body_{body}")
        if root == body and root > 0:
            return f"{ROOT}/{name}"
        named = (self.model.body(root).name or f"body_{root}") if root > 0 else "fixed"
        return f"{ROOT}/{named}/{name}"

    def draw(self, rec: rr.RecordingStream) -> None:
        """Draws everything that is constant in its own frame."""
        rec.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for body, solid in self.solids():
            opacity = GLASS if self.model.body(body).name.startswith(PASSIVE) else 1.0
            log_solid(rec, f"{self.path(body)}/shape", solid, opacity)
        site = self.model.site(ACTIVE + "A").id
        carrier = int(self.model.body_weldid[self.model.site_bodyid[site]])
        position, rotation = self._relative(
            carrier, self.data.site_xpos[site], self.data.site_xmat[site]
        )
        _log_triad(rec, f"{self.path(carrier)}/port_A", position, rotation, "A")
        _log_triad(rec, f"{AT_P}/port_P", np.zeros(3), np.eye(3), "P")

    def solids(self) -> list[tuple[int, Solid]]:
        """Every drawn body, with its shape in the frame of the moving body that carries it."""
        found = ((body, self._body_solids(body)) for body in range(self.model.nbody))
        return [(body, Solid.joined(solids)) for body, solids in found if solids]

    def strokes(self, trace: RunTrace, rows: NDArray[np.intp]) -> dict[int, Array]:
        """Index in qpos to the positions ``(frames,)`` of each of the mechanism's joints."""
        names = {self.model.joint(i).name: i for i in range(self.model.njnt)}
        return {
            int(self.model.jnt_qposadr[names[name]]): trace[f"{JOINT.name}.{name}"][rows]
            for name, _ in trace.moving
            if name in names
        }

    def _body_solids(self, body: int) -> list[Solid]:
        m, root, out = self.model, int(self.model.body_weldid[body]), []
        for geom in np.flatnonzero((m.geom_bodyid == body) & (m.geom_group < DRAWN_GROUPS)):
            position, rotation = self._relative(
                root, self.data.geom_xpos[geom], self.data.geom_xmat[geom]
            )
            out.append(geom_solid(m, int(geom)).moved(position, rotation))
        return out

    def _relative(self, root: int, position: Array, matrix: Array) -> tuple[Array, Array]:
        """Position and rotation in the frame of the body ``root``, at home."""
        frame = self.data.xmat[root].reshape(3, 3)
        return frame.T @ (position - self.data.xpos[root]), frame.T @ matrix.reshape(3, 3)

    def body_poses(self, pose: Array, pose_P: Array, strokes: Mapping[int, Array] = {}) -> Array:
        """``(moving, frames, 7)`` poses in W of the moving bodies, by inverse kinematics, at the
        poses ``(frames, 7)`` of A in P and of P in W, with the mechanism's joints at ``strokes``.
        """
        qpos = self._rig.joints(pose, pose_P)
        for place, values in strokes.items():
            qpos[:, place] = values
        out = np.empty((len(self.moving), len(pose), 7))
        for f in range(len(pose)):
            self.data.qpos[:] = qpos[f]
            mujoco.mj_kinematics(self.model, self.data)
            out[:, f, :3] = self.data.xpos[self.moving]
            out[:, f, 3:] = quat_from_mujoco(self.data.xquat[self.moving])
        return out

    def port_poses(self, rows: NDArray[np.intp], pose_cmd: Array, pose: Array) -> Array:
        """``(frames, 7)`` poses of P in W at the rows, at which A has ``pose`` (frames, 7) in P."""
        return self._rig.port_poses(rows, pose_cmd, pose)

    def move(
        self,
        rec: rr.RecordingStream,
        time: rr.TimeColumn,
        pose: Array,
        pose_P: Array,
        strokes: Mapping[int, Array] = {},
    ) -> None:
        """Poses of the moving bodies and of P at the frames, and the path of A in P."""
        for body, poses in zip(self.moving, self.body_poses(pose, pose_P, strokes), strict=True):
            send_poses(rec, self.path(body), time, poses)
        send_poses(rec, AT_P, time, pose_P)
        rec.log(
            f"{AT_P}/path_of_A",
            rr.LineStrips3D([pose[:, :3]], colors=[colors.PATH], radii=[0.0015]),
            static=True,
        )


def _log_triad(
    rec: rr.RecordingStream, path: str, position: Array, rotation: Array, name: str
) -> None:
    """A port's axes, x red, y green, z blue, with its name beside it."""
    axes = [arrow(TRIAD * np.eye(3)[i], 0.005, np.array(colors.AXES[i])) for i in range(3)]
    log_solid(rec, path, Solid.joined(axes).moved(position, rotation))
    at = position + rotation @ np.array([1.15 * TRIAD if name == "P" else -0.4 * TRIAD, 0.0, 0.0])
    rec.log(
        f"{path}/name",
        rr.Points3D([at], radii=[0.002], colors=[colors.TEXT], labels=[name], show_labels=True),
        static=True,
    )
