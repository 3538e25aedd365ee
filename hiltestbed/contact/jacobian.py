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

from hiltestbed.contact.composition import PREFIXES, Structure
from hiltestbed.contact.facets import NORM, POINT, PUSH
from hiltestbed.contact.geometry import ACTIVE, FRAMES, PASSIVE, ROUND_FRAME, ROW, SURFACE_FRAME
from hiltestbed.contact.parameters import DAMPING, STIFFNESS
from hiltestbed.frames import Array, quat_mul, rotation_matrix

if TYPE_CHECKING:
    from hiltestbed.contact.engagement import Engagement

SLIDE, HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)


class _Spring(NamedTuple):
    """Springs along ``axes`` (3, m) in W, at a point ``place`` (3,) in W, between two frames;
    ``turns``: rotational, about the axes.
    """

    frames: tuple[int, int]
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
    """Stiffness and damping (6, 6), as for :func:`held_pair`, about a point ``place`` (3,) in W of
    the active side; None if a contact with a non-linear law pushes.
    """
    springs = _springs(engagement, structure, batch.model, i)
    if springs is None:
        return None
    frames = engagement.frames[i]
    axes = rotation_matrix(frames[PASSIVE, 3:7])
    joints = _Joints(batch, structure, i, frames[[ACTIVE, PASSIVE]])
    stiffness = np.diag(np.concatenate([np.zeros(6), joints.stiffness]))
    damping = np.diag(np.concatenate([np.zeros(6), joints.damping]))
    for spring in springs:
        stretch = _stretch(spring, place, axes, joints)
        stiffness += spring.stiffness * stretch.T @ stretch
        damping += spring.damping * stretch.T @ stretch
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
    joints = _Joints(batch, structure, i, frames[[ACTIVE, PASSIVE]])
    if not joints.count:
        return 0.0
    stiffness, damping = np.diag(joints.stiffness), np.diag(joints.damping)
    axes = rotation_matrix(frames[PASSIVE, 3:7])
    for spring in _springs(engagement, structure, batch.model, i) or ():
        stretch = _stretch(spring, frames[ACTIVE, :3], axes, joints)[:, 6:]
        stiffness += spring.stiffness * stretch.T @ stretch
        damping += spring.damping * stretch.T @ stretch
    root = 1.0 / np.sqrt(joints.inertia)
    modes, rates = (
        np.linalg.eigvalsh(root[:, None] * matrix * root)[-1] for matrix in (stiffness, damping)
    )
    return max(float(np.sqrt(max(modes, 0.0))), float(rates))


def _springs(
    engagement: Engagement, structure: Structure, model: mujoco.MjModel, i: int
) -> list[_Spring] | None:
    frames, latches, out = engagement.frames[i], engagement.latches, []
    for k in np.flatnonzero(latches.closed[i]):
        closure, (stiffness, damping, radius) = latches.closures[k], latches.springs[i, k]
        at = _in_world(frames[closure.frames[0]], closure.places[0])
        turn = rotation_matrix(_in_world(frames[closure.frames[1]], closure.places[1])[3:7])
        out.append(_Spring(closure.frames, at[:3], turn, stiffness, damping))
        if closure.turns:
            out.append(
                _Spring(
                    closure.frames,
                    at[:3],
                    turn,
                    stiffness * radius**2,
                    damping * radius**2,
                    turns=True,
                )
            )
    for c in np.flatnonzero(engagement.met[i, :, PUSH] > 0.0):
        if not engagement.linear[i, c]:
            return None
        met, law = engagement.met[i, c], engagement.parameters[i, c]
        between = _frames_of(engagement, structure, model, int(c))
        out.append(
            _Spring(
                between,
                met[POINT : POINT + 3],
                met[NORM : NORM + 3, None],
                law[STIFFNESS],
                law[DAMPING],
            )
        )
    return out


def _frames_of(
    engagement: Engagement, structure: Structure, model: mujoco.MjModel, c: int
) -> tuple[int, int]:
    """The frames to which the geoms of a pair are fixed."""
    sides = structure.sides
    if c < len(sides.facets):
        index = sides.geometry[0]
        return int(index[c * ROW + ROUND_FRAME]), int(index[c * ROW + SURFACE_FRAME])
    pair, moving = sides.native[c - len(sides.facets)], _moving(structure, model)
    bodies = [("A", _carrier("A", pair.active, model)), ("P", _carrier("P", pair.passive, model))]
    first, second = (
        FRAMES + moving.index(b) if b in moving else {"A": ACTIVE, "P": PASSIVE}[b[0]]
        for b in bodies
    )
    return first, second


def _moving(structure: Structure, model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Port and body of each frame beyond A and S, moving parts with native geoms included."""
    sides = structure.sides
    native = [("A", _carrier("A", pair.active, model)) for pair in sides.native]
    native += [("P", _carrier("P", pair.passive, model)) for pair in sides.native]
    return list(dict.fromkeys([*sides.frames, *(b for b in native if b[1])]))


def _carrier(port: str, geom: str, model: mujoco.MjModel) -> str:
    """Name of the moving body that carries a geom of a side; empty if it is fixed to the side."""
    body = model.body(int(model.geom(PREFIXES[port] + geom).bodyid[0]))
    while body.name.startswith(PREFIXES[port]):
        if body.jntnum[0]:
            return body.name.removeprefix(PREFIXES[port])
        body = model.body(int(body.parentid[0]))
    return ""


def _stretch(spring: _Spring, place: Array, axes: Array, joints: _Joints) -> Array:
    """(m, 6 + joints) stretch per displacement of the active side, in P, and of the joints."""
    a, p = spring.frames
    rigid = np.zeros((3, 6))
    if spring.turns:
        rigid[:, 3:] = axes
    else:
        rigid[:, :3] = axes
        rigid[:, 3:] = np.cross(axes.T, spring.place - place).T
    active = np.hstack(
        [
            rigid if joints.side(a) == "A" else 0.0 * rigid,
            joints.motion(a, spring.place, spring.turns),
        ]
    )
    passive = np.hstack(
        [
            rigid if joints.side(p) == "A" else 0.0 * rigid,
            joints.motion(p, spring.place, spring.turns),
        ]
    )
    return spring.axes.T @ (active - passive)


class _Joints:
    """The joints of moving parts, without those at an end of their range.

    Attributes:
        count: their number. stiffness, damping: (count,) of each, including its actuators'.
        inertia: (count,) [kg], [kg m^2] of each at the start, all others fixed.
    """

    def __init__(self, batch: Batch, structure: Structure, i: int, places: Array) -> None:
        """places: (2, 7) poses of A and P in W."""
        m, self._frames = batch.model, _moving(structure, batch.model)
        bodies = [m.body(PREFIXES[port] + name).id for port, name in self._frames]
        self._chains = [_chain(m, body) for body in bodies]
        every = sorted({j for chain in self._chains for j in chain})
        self._free = [j for j in every if not _held(batch, i, j)]
        self._anchor, self._axis = _in_place(batch, i, places)
        self._slides = m.jnt_type == SLIDE
        self.count = len(self._free)
        self.stiffness = np.array([m.jnt_stiffness[j] for j in self._free], dtype=float)
        self.damping = np.array([m.dof_damping[m.jnt_dofadr[j]] for j in self._free], dtype=float)
        self.inertia = np.array([m.dof_M0[m.jnt_dofadr[j]] for j in self._free], dtype=float)
        for k, j in enumerate(self._free):
            spring, damper = _driven(batch, i, j)
            self.stiffness[k] += spring
            self.damping[k] += damper

    def side(self, frame: int) -> str:
        """Port of the side to which a frame belongs."""
        return (
            {ACTIVE: "A", PASSIVE: "P"}[frame]
            if frame < FRAMES
            else self._frames[frame - FRAMES][0]
        )

    def motion(self, frame: int, place: Array, turns: bool) -> Array:
        """(3, count) velocity in W, or rotation, of a frame's point ``place``, per joint speed."""
        out = np.zeros((3, self.count))
        chain: list[int] = self._chains[frame - FRAMES] if frame >= FRAMES else []
        for k, j in enumerate(self._free):
            if j not in chain:
                continue
            if self._slides[j]:
                out[:, k] = 0.0 if turns else self._axis[j]
            else:
                out[:, k] = (
                    self._axis[j] if turns else np.cross(self._axis[j], place - self._anchor[j])
                )
        return out


def _in_place(batch: Batch, i: int, places: Array) -> tuple[Array, Array]:
    """(J, 3) anchors and axes in W of all joints, the sides' ports at ``places`` (2, 7)."""
    m = batch.model
    data = mujoco.MjData(m)
    data.qpos[:] = batch.bind("qpos")[i]
    mujoco.mj_kinematics(m, data)
    anchors, axes = data.xanchor.copy(), data.xaxis.copy()
    for place, (port, prefix) in zip(places, PREFIXES.items(), strict=True):
        own = [j for j in range(m.njnt) if m.body(int(m.jnt_bodyid[j])).name.startswith(prefix)]
        site = data.site(prefix + port)
        turn = rotation_matrix(place[3:7]) @ site.xmat.reshape(3, 3).T
        anchors[own] = place[:3] + (anchors[own] - site.xpos) @ turn.T
        axes[own] = axes[own] @ turn.T
    return anchors, axes


def _chain(m: mujoco.MjModel, body: int) -> list[int]:
    """Joints between a moving part and its side."""
    out: list[int] = []
    while body and m.body(body).name.startswith(tuple(PREFIXES.values())):
        out += range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
        body = int(m.body_parentid[body])
    return [j for j in out if int(m.jnt_type[j]) in (SLIDE, HINGE)]


def _held(batch: Batch, i: int, j: int) -> bool:
    """Whether a joint is at an end of its range. Joint friction does not count: MuJoCo's friction
    creeps like a damper.
    """
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
