"""The rig in 3-D: bodies drawn once, their poses at the frames, the contact force as an arrow.

Coordinates are the rig's world W, whose origin is P and whose z is the insertion, so that a pose of A in P is one in W. Each moving
body is an entity with its pose in W; what is welded to it is drawn in its frame.
"""

from __future__ import annotations

import mujoco
import numpy as np
import rerun as rr
from numba import njit

from hiltestbed.frames import Array, quat_from_mujoco, quat_to_mujoco, rotation_matrix
from hiltestbed.rig.kinematics import Platform, joints
from hiltestbed.rig.model import PASSIVE, rig_scene
from hiltestbed.viewer import colors
from hiltestbed.viewer.solids import Solid, arrow, geom_solid

ROOT = "rig"
CONTACT_FORCE = f"{ROOT}/forces/contact"
PORT_NAMES = (f"{ROOT}/platform/port_A/name", f"{ROOT}/fixed/port_P/name")
DRAWN_GROUPS = 3  # geom groups 0 to 2 are drawn, as in MuJoCo's own viewer; 3 is for collision
TRIAD = 0.1  # [m] length of a port's axes
ARROW_LENGTH = 0.6  # [m] of the largest force, at most
LINE_OF_ACTION = 0.6  # [m] the force is drawn at its line of action where that passes A this closely
GLASS = 0.25  # opacity of the passive mechanism: the force that it takes is drawn inside it
ARROW_RADIUS = 0.02  # [m]
LABEL_GAP = 0.03  # [m] from the tip of an arrow to its label
LABEL_FROM = 0.02  # of the largest force: below it an arrow has no label


class RigScene:
    """The drawn model of one kind of mechanism and the joints that a pose of the platform needs."""

    def __init__(self, kind: str) -> None:
        self.model = rig_scene(kind)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self._home = self.data.qpos.copy()
        self._platform = Platform.load()
        weld = self.model.body_weldid
        self.moving = sorted({int(b) for b in weld if b > 0})
        self._slider = np.array([int(self.model.joint(f"slider_{j}").qposadr[0]) for j in range(6)])
        self._free = int(self.model.joint("platform").qposadr[0])

    def path(self, body: int) -> str:
        """Entity of a body: under the moving body that carries it, if any."""
        root, name = int(self.model.body_weldid[body]), self.model.body(body).name or "world"
        if root == body and root > 0:
            return f"{ROOT}/{name}"
        return f"{ROOT}/{self.model.body(root).name if root > 0 else 'fixed'}/{name}"

    def draw(self, rec: rr.RecordingStream) -> None:
        """Everything that never changes in its own frame."""
        rec.log(ROOT, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for body in range(self.model.nbody):
            solids = self._body_solids(body)
            if solids:
                opacity = GLASS if self.model.body(body).name.startswith(PASSIVE) else 1.0
                log_solid(rec, f"{self.path(body)}/shape", Solid.joined(solids), opacity)
        for name in ("A", "P"):
            site = self._site(name)
            root = int(self.model.body_weldid[self.model.site_bodyid[site]])
            carrier = self.path(root) if root > 0 else f"{ROOT}/fixed"
            position, rotation = self._relative(root, self.data.site_xpos[site], self.data.site_xmat[site])
            _log_triad(rec, f"{carrier}/port_{name}", position, rotation, name)

    def _site(self, port: str) -> int:
        return int(self.model.site({"A": "active_A", "P": "passive_P"}[port]).id)

    def _body_solids(self, body: int) -> list[Solid]:
        m, root, out = self.model, int(self.model.body_weldid[body]), []
        for geom in np.flatnonzero((m.geom_bodyid == body) & (m.geom_group < DRAWN_GROUPS)):
            position, rotation = self._relative(root, self.data.geom_xpos[geom], self.data.geom_xmat[geom])
            out.append(geom_solid(m, int(geom)).moved(position, rotation))
        return out

    def _relative(self, root: int, position: Array, matrix: Array) -> tuple[Array, Array]:
        """Position and rotation in the frame of the body ``root``, at home."""
        frame = self.data.xmat[root].reshape(3, 3)
        return frame.T @ (position - self.data.xpos[root]), frame.T @ matrix.reshape(3, 3)

    def body_poses(self, pose: Array) -> Array:
        """``(moving, frames, 7)`` poses in W of the moving bodies at the poses ``(frames, 7)`` of A in P; limbs by inverse kinematics."""
        qpos = np.tile(self._home, (len(pose), 1))
        _limb_joints(self._platform.limbs, self._slider, np.ascontiguousarray(pose), qpos)
        free = qpos[:, self._free : self._free + 7]
        free[:, :3] = pose[:, :3] + rotation_matrix(pose[:, 3:]) @ self._platform.centre
        free[:, 3:] = quat_to_mujoco(pose[:, 3:])
        place, attitude = np.empty((len(pose), len(self.moving), 3)), np.empty((len(pose), len(self.moving), 4))
        for f in range(len(pose)):
            self.data.qpos[:] = qpos[f]
            mujoco.mj_kinematics(self.model, self.data)
            place[f] = self.data.xpos[self.moving]
            attitude[f] = self.data.xquat[self.moving]
        return np.concatenate([place, quat_from_mujoco(attitude)], axis=-1).swapaxes(0, 1)

    def move(self, rec: rr.RecordingStream, time: rr.TimeColumn, pose: Array) -> None:
        """Poses of the moving bodies at the frames."""
        for body, poses in zip(self.moving, self.body_poses(pose), strict=True):
            send_poses(rec, self.path(body), time, poses)
        rec.log(f"{ROOT}/path_of_A", rr.LineStrips3D([pose[:, :3]], colors=[colors.PATH], radii=[0.0015]), static=True)


@njit(cache=True)
def _limb_joints(limbs, first, pose, qpos):
    """Slider and universal joint of every limb at the poses ``(frames, 7)`` of A, into ``qpos`` from the columns ``first`` (6,) on."""
    still, q, v = np.zeros(6), np.empty(3), np.empty(3)
    for f in range(pose.shape[0]):
        for j in range(6):
            joints(limbs[j], pose[f], still, q, v)
            for k in range(3):
                qpos[f, first[j] + k] = q[k]


def send_poses(rec: rr.RecordingStream, path: str, time: rr.TimeColumn, poses: Array) -> None:
    """Poses ``(frames, 7)`` of an entity."""
    rec.send_columns(path, indexes=[time], columns=rr.Transform3D.columns(translation=poses[:, :3], quaternion=poses[:, 3:]))


def force_scale(peak: float, length: float = ARROW_LENGTH) -> float:
    """[m/N] so that ``peak`` [N] is drawn within ``length`` [m] and a metre is a round number of newtons."""
    if not peak > 0.0:
        return 1e-3
    least = peak / length
    decade = 10.0 ** np.floor(np.log10(least))
    return float(1.0 / next(step * decade for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0) if step * decade >= least * (1.0 - 1e-9)))


def force_origin(wrench: Array, pose: Array) -> Array:
    """``(frames, 3)`` where the force of ``wrench`` (frames, 6) acts: on its line of action, next to A; A where that is far off.

    The line of a force f with the torque t about the origin runs through f x t/f^2; a couple moves it away from the contact.
    """
    force, torque, a = wrench[:, :3], wrench[:, 3:], pose[:, :3]
    square = np.maximum(np.einsum("ij,ij->i", force, force), 1e-12)[:, None]
    line = np.cross(force, torque) / square
    point = line + force * np.einsum("ij,ij->i", a - line, force)[:, None] / square
    near = np.linalg.norm(point - a, axis=1) < LINE_OF_ACTION
    return np.where(near[:, None], point, a)


def send_force(rec: rr.RecordingStream, time: rr.TimeColumn, wrench: Array, pose: Array, scale: float) -> None:
    """The force on the passive side as an arrow where it acts, ``scale`` [m/N], its size at the tip; none where there is none."""
    force = np.linalg.norm(wrench[:, :3], axis=1)
    acts = force > 0.0
    vectors, origins = scale * wrench[acts, :3], force_origin(wrench, pose)[acts]
    rec.log(CONTACT_FORCE, rr.Arrows3D.from_fields(colors=[colors.PHYSICAL], radii=[ARROW_RADIUS]), static=True)
    rec.send_columns(
        CONTACT_FORCE, indexes=[time], columns=rr.Arrows3D.columns(vectors=vectors, origins=origins).partition(acts.astype(int))
    )
    told = force > LABEL_FROM * force.max(initial=0.0)
    beyond = 1.0 + LABEL_GAP / (scale * force[told, None])
    tips = origins[told[acts]] + beyond * scale * wrench[told, :3]
    points = rr.Points3D.columns(positions=tips, labels=[f"{f:.0f} N" for f in force[told]])
    path = f"{CONTACT_FORCE}/size"
    rec.log(path, rr.Points3D.from_fields(colors=[colors.PHYSICAL], radii=[0.001], show_labels=True), static=True)
    rec.send_columns(path, indexes=[time], columns=points.partition(told.astype(int)))


def log_solid(rec: rr.RecordingStream, path: str, shape: Solid, opacity: float = 1.0) -> None:
    """A shape in the frame of its entity."""
    mesh = rr.Mesh3D(
        vertex_positions=shape.vertices,
        vertex_normals=shape.normals,
        triangle_indices=shape.triangles,
        vertex_colors=shape.colors,
        albedo_factor=(1.0, 1.0, 1.0, opacity) if opacity < 1.0 else None,
    )
    rec.log(path, mesh, static=True)


def _log_triad(rec: rr.RecordingStream, path: str, position: Array, rotation: Array, name: str) -> None:
    """A port's axes, x red, y green, z blue, with its name beside it."""
    axes = [arrow(TRIAD * np.eye(3)[i], 0.005, np.array(colors.AXES[i])) for i in range(3)]
    log_solid(rec, path, Solid.joined(axes).moved(position, rotation))
    at = position + rotation @ np.array([1.15 * TRIAD if name == "P" else -0.4 * TRIAD, 0.0, 0.0])
    rec.log(f"{path}/name", rr.Points3D([at], radii=[0.002], colors=[colors.TEXT], labels=[name], show_labels=True), static=True)
