"""Stiffness and damping of a mechanism captured in phases, from the model's Jacobians at its state.

The springs and dampers between the sides are the closed latches, the geom pairs in contact, and
within a side the joints of moving parts. A spring k whose stretch changes by J = [J_x J_q] per
displacement of the active side (x) and of the joints (q) adds k J^T J. At frequencies well below
those of the parts the joints follow by q = -K_qq^-1 K_qx x, and with T = [1; -K_qq^-1 K_qx]
stiffness and damping are T^T K T and T^T C T (static condensation, R. J. Guyan, AIAA Journal 3,
1965).

A joint at an end of its range is fixed. Neglected are friction, which is not a linear damper, and
the geometric stiffness of the loads (a force over the radius on which its point of application
moves): 4 % of a clamped gripper, below 1 % of the other shipped mechanisms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch

from hiltestbed.contact.composition import PASSIVE as PASSIVE_NAMES
from hiltestbed.contact.composition import PREFIXES, Structure
from hiltestbed.contact.facets import NORM, POINT, PUSH
from hiltestbed.contact.geometry import ACTIVE, PASSIVE
from hiltestbed.contact.parameters import DAMPING, STIFFNESS
from hiltestbed.frames import Array, quat_mul, rotation_matrix

if TYPE_CHECKING:
    from hiltestbed.contact.engagement import Engagement

SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)


class _Spring(NamedTuple):
    """Springs along ``axes`` (3, m), or about them, at ``place`` (3,) in W, between two bodies."""

    bodies: tuple[int, int]
    place: Array
    axes: Array
    stiffness: float
    damping: float
    turns: bool = False


def held_pair(
    engagement: Engagement, batch: Batch, structure: Structure, i: int
) -> tuple[Array, Array] | None:
    """Stiffness and damping (6, 6) of run ``i``, for translation and rotation of the active side
    about the latch's reference point, in P.

    The point is that of :mod:`hiltestbed.identification.held`. Units N/m and N s/m, rotational N
    m/rad and N m s/rad. None if no latch is closed, if a contact with a non-linear law pushes, and
    on a compliant mount.
    """
    closed = np.flatnonzero(engagement.latches.closed[i])
    if not closed.size or structure.mounted:
        return None
    frames, last = engagement.frames[i], engagement.latches.closures[closed[-1]]
    still = [
        _in_world(frames[f], at)[:3]
        for f, at in zip(last.frames, last.places, strict=True)
        if f in (ACTIVE, PASSIVE)
    ]
    return pair_at(engagement, batch, structure, i, still[0] if still else frames[ACTIVE, :3])


def pair_at(
    engagement: Engagement, batch: Batch, structure: Structure, i: int, place: Array
) -> tuple[Array, Array] | None:
    """As :func:`held_pair`, about ``place`` (3,) in W; None if a non-linear contact pushes."""
    springs = _springs(engagement, structure, batch.model, i)
    if springs is None:
        return None
    joints = _Joints(engagement, batch, structure, i)
    stiffness, damping = joints.sums(springs, place)
    if not joints.count:
        return stiffness, damping
    follow = np.vstack(
        [np.eye(6), -np.linalg.lstsq(stiffness[6:, 6:], stiffness[6:, :6], rcond=None)[0]]
    )
    return follow.T @ stiffness @ follow, follow.T @ damping @ follow


def fastest(engagement: Engagement, batch: Batch, structure: Structure, i: int) -> float:
    """Highest frequency [rad/s] of run ``i``'s moving parts in the present state, between the two
    sides at rest: of a mode on contacts and own springs, or the rate at which their dampers stop a
    part; 0 without moving parts. The inertia is the diagonal of the joints' at the start.
    """
    frames = engagement.frames[i]
    joints = _Joints(engagement, batch, structure, i)
    if not joints.count:
        return 0.0
    springs = _springs(engagement, structure, batch.model, i) or []
    root = 1.0 / np.sqrt(joints.inertia)
    modes, rates = (
        np.linalg.eigvalsh(root[:, None] * matrix[6:, 6:] * root)[-1]
        for matrix in joints.sums(springs, frames[ACTIVE, :3])
    )
    return max(float(np.sqrt(max(modes, 0.0))), float(rates))


def _springs(
    engagement: Engagement, structure: Structure, model: mujoco.MjModel, i: int
) -> list[_Spring] | None:
    frames, latches, out = engagement.frames[i], engagement.latches, []
    bodies, between = _bodies(structure, model), _met_by(structure, model)
    for k in np.flatnonzero(latches.closed[i]):
        closure, (stiffness, damping, radius) = latches.closures[k], latches.springs[i, k]
        first, second = closure.frames
        at = _in_world(frames[first], closure.places[0])[:3]
        turn = rotation_matrix(_in_world(frames[second], closure.places[1])[3:7])
        spring = _Spring((bodies[first], bodies[second]), at, turn, stiffness, damping)
        out.append(spring)
        if closure.turns:
            square = radius**2
            turning = spring._replace(stiffness=stiffness * square, damping=damping * square)
            out.append(turning._replace(turns=True))
    for c in np.flatnonzero(engagement.met[i, :, PUSH] > 0.0):
        if not engagement.linear[i, c]:
            return None
        met, law = engagement.met[i, c], engagement.parameters[i, c]
        at, normal = met[POINT : POINT + 3], met[NORM : NORM + 3, None]
        out.append(_Spring(between[c], at, normal, law[STIFFNESS], law[DAMPING]))
    return out


def _bodies(structure: Structure, model: mujoco.MjModel) -> list[int]:
    """Numbers of the bodies to which the frames are fixed: A, S and moving parts."""
    ports = [int(model.site(prefix + port).bodyid[0]) for port, prefix in PREFIXES.items()]
    return ports + [model.body(PREFIXES[port] + name).id for port, name in structure.sides.frames]


def _met_by(structure: Structure, model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Numbers of the bodies that meet in each pair of geoms."""
    bodies, sides = _bodies(structure, model), structure.sides
    facets = [sides.candidate(k)[:2] for k in range(len(sides.facets))]
    geoms = [(PREFIXES["A"] + pair.active, PREFIXES["P"] + pair.passive) for pair in sides.native]
    return [(bodies[a], bodies[p]) for a, p in facets] + [
        (int(model.geom(a).bodyid[0]), int(model.geom(p).bodyid[0])) for a, p in geoms
    ]


class _Joints:
    """The joints of moving parts, without those at an end of their range.

    Attributes:
        count: their number. stiffness, damping: (count,) of each, including its actuators'.
        inertia: (count,) [kg], [kg m^2] of each at the start, all others fixed.
    """

    def __init__(self, engagement: Engagement, batch: Batch, structure: Structure, i: int) -> None:
        frames = engagement.frames[i]
        self._model, self._axes = batch.model, rotation_matrix(frames[PASSIVE, 3:7])
        m = self._model
        self._data = data = mujoco.MjData(m)
        data.qpos[:] = batch.bind("qpos")[i]
        mujoco.mj_kinematics(m, data)
        mujoco.mj_comPos(m, data)
        self._ports = []  # of each side: the port in W, and in MuJoCo's world; from this to W
        for frame, (port, prefix) in zip(frames, PREFIXES.items(), strict=False):
            site = data.site(prefix + port)
            turn = rotation_matrix(frame[3:7]) @ site.xmat.reshape(3, 3).T
            self._ports.append((frame[:3], site.xpos, turn))
        bodies = {*_bodies(structure, m), *(b for pair in _met_by(structure, m) for b in pair)}
        every: set[int] = set()  # between a moving part and its side
        for body in bodies:
            while body and m.body(body).name.startswith(tuple(PREFIXES.values())):
                every |= {*range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])}
                body = int(m.body_parentid[body])
        moves = (j for j in sorted(every) if int(m.jnt_type[j]) in (SLIDE, HINGE))
        self._free = [j for j in moves if not _held(batch, i, j)]
        self._dofs = m.jnt_dofadr[self._free]
        self.count = len(self._free)
        self.stiffness = np.array(m.jnt_stiffness[self._free])
        self.damping = np.array(m.dof_damping[self._dofs])
        self.inertia = np.array(m.dof_M0[self._dofs])
        for k, j in enumerate(self._free):
            spring, damper = _driven(batch, i, j)
            self.stiffness[k] += spring
            self.damping[k] += damper
        if engagement.legs is not None:
            place = [self._free.index(j) for j in engagement.legs.joints]
            self.stiffness[place], self.damping[place] = engagement.legs.law(i)

    def sums(self, springs: list[_Spring], place: Array) -> tuple[Array, Array]:
        """Stiffness and damping of A's displacement at ``place`` (3,) in P and of the joints."""
        stiffness = np.diag(np.concatenate([np.zeros(6), self.stiffness]))
        damping = np.diag(np.concatenate([np.zeros(6), self.damping]))
        for spring in springs:
            stretch = self._stretch(spring, place)
            stiffness += spring.stiffness * stretch.T @ stretch
            damping += spring.damping * stretch.T @ stretch
        return stiffness, damping

    def _stretch(self, spring: _Spring, place: Array) -> Array:
        """(m, 6 + joints) stretch per displacement."""
        jac, moved = np.zeros((2, 3, self._model.nv)), np.zeros((3, 6 + self.count))
        for body, sign in zip(spring.bodies, (1.0, -1.0), strict=True):
            passive = self._model.body(body).name.startswith(PASSIVE_NAMES)
            port, origin, turn = self._ports[PASSIVE if passive else ACTIVE]
            point = origin + turn.T @ (spring.place - port)
            mujoco.mj_jac(self._model, self._data, *jac, point, body)
            moved[:, 6:] += sign * turn @ jac[int(spring.turns)][:, self._dofs]
            if passive:
                continue
            if spring.turns:
                moved[:, 3:6] += sign * self._axes
            else:
                moved[:, :3] += sign * self._axes
                moved[:, 3:6] += sign * np.cross(self._axes.T, spring.place - place).T
        return spring.axes.T @ moved


def _held(batch: Batch, i: int, j: int) -> bool:
    """Whether a joint is at an end of its range; MuJoCo's joint friction creeps like a damper."""
    m = batch.model
    return (
        bool(m.jnt_limited[j])
        and not m.jnt_range[j, 0] < batch.bind("qpos")[i, m.jnt_qposadr[j]] < m.jnt_range[j, 1]
    )


def _driven(batch: Batch, i: int, j: int) -> tuple[float, float]:
    """Stiffness and damping of the actuators of a joint, except those at their force limit."""
    m, spring, damper = batch.model, 0.0, 0.0
    q = float(batch.bind("qpos")[i, m.jnt_qposadr[j]])
    v = float(batch.bind("qvel")[i, m.jnt_dofadr[j]])
    for u in range(m.nu):
        if (
            int(m.actuator_trntype[u]) != int(mujoco.mjtTrn.mjTRN_JOINT)
            or m.actuator_trnid[u, 0] != j
        ):
            continue
        if int(m.actuator_biastype[u]) != int(mujoco.mjtBias.mjBIAS_AFFINE):
            continue
        gear, (b0, b1, b2) = float(m.actuator_gear[u, 0]), m.actuator_biasprm[u, :3]
        force = m.actuator_gainprm[u, 0] * batch.bind("ctrl")[i, u] + b0 + gear * (b1 * q + b2 * v)
        low, high = m.actuator_forcerange[u]
        if not m.actuator_forcelimited[u] or low < force < high:
            spring, damper = spring - b1 * gear**2, damper - b2 * gear**2
    return spring, damper


def _in_world(frame: Array, place: Array) -> Array:
    """Pose (7,) in W of a pose (7,) in a frame (7,)."""
    out = np.empty(7)
    out[:3] = frame[:3] + rotation_matrix(frame[3:7]) @ place[:3]
    quat_mul(frame[3:7], place[3:7], out[3:7])
    return out
