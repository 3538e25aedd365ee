"""The kinematic tree of a compiled MuJoCo model, loop closures included, as arrays for compiled
code.

It contains bodies, joints, the equality constraints that close loops (``connect``, ``weld``,
``joint``), and the tools, sites whose pose is commanded. Quaternions are x, y, z, w here; MuJoCo's
w-first ones are converted on input. A tree is constant and shared by all runs; quantities that
depend on the joints are in :class:`hiltestbed.platform.facilities.motion.Scratch`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.jit import interpreted
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, pose_between, pose_compose, quat_from_mujoco, rotate

Integers = NDArray[np.int64]
FREE, BALL, SLIDE, HINGE = range(4)  # as mjtJoint
POINT, FRAME = 0, 1  # loops: two points coincide (3 rows), two frames coincide (6 rows)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class JointTree(NamedTuple):
    """Constants of a kinematic tree of nb bodies, nj joints, nl loops, ne coupled joints, nt tools
    and np prescribed joints.

    Attributes:
        bodies: (nb, 3) parent, first joint, number of joints. frames: (nb, 7) pose of a body in its
            parent, joints at their reference.
        masses: (nb, 14) mass [kg], centre of mass (3) [m] and inertia about it (9) [kg m^2], in the
            body's frame, and the fraction of its weight that a counterweight supports (MuJoCo's
            gravcomp).
        joints: (nj, 4) type, body, address of its position, of its rate. axes: (nj, 7) anchor (3)
            [m] and axis (3) in its body, reference.
        armature: (nv,) [kg, kg m^2].
        loops: (nl, 3) POINT or FRAME, the two bodies. loop_frames: (nl, 2, 7) what coincides, in
            its body.
        coupled: (ne, 2) joints of which the first is a polynomial of the second (-1: constant).
            polynomial: (ne, 5).
        tools: (nt,) bodies. tool_frames: (nt, 7) pose of each tool in its body.
        prescribed: (np,) joints whose value is given. unknown: (u,) degrees of freedom that are
            solved for; the others are constant.
    """

    bodies: Integers
    frames: Array
    masses: Array
    joints: Integers
    axes: Array
    armature: Array
    loops: Integers
    loop_frames: Array
    coupled: Integers
    polynomial: Array
    tools: Integers
    tool_frames: Array
    prescribed: Integers
    unknown: Integers

    def towards_tools(self) -> JointTree:
        """Its moving bodies between the tools and the world, which determine the tools' motion, for
        poses and velocities alone. What is fixed to one of them is a part of it.
        """
        tools = [
            self._moving(int(b), frame)
            for b, frame in zip(self.tools, self.tool_frames, strict=True)
        ]
        found: dict[int, tuple[int, Array]] = {0: (0, self.frames[0])}
        for b, _ in tools:
            while b not in found:
                found[b] = self._moving(int(self.bodies[b, 0]), self.frames[b])
                b = found[b][0]
        order = sorted(found)
        new = {b: i for i, b in enumerate(order)}
        moved = [range(int(first), int(first + count)) for _, first, count in self.bodies[order]]
        chosen = [j for joints in moved for j in joints]
        starts = np.cumsum([0, *(len(joints) for joints in moved[:-1])])
        parents = [new[found[b][0]] for b in order]
        joints = self.joints[chosen].reshape(-1, 4)
        joints[:, 1] = [new[int(b)] for b in joints[:, 1]]
        return self._replace(
            bodies=np.column_stack([parents, starts, [len(joints) for joints in moved]]).astype(
                np.int64
            ),
            frames=np.array([found[b][1] for b in order]),
            joints=joints,
            axes=self.axes[chosen].reshape(-1, 7),
            tools=np.array([new[b] for b, _ in tools], dtype=np.int64),
            tool_frames=np.array([frame for _, frame in tools]),
        )

    def _moving(self, b: int, frame: Array) -> tuple[int, Array]:
        """The moving body, or the world, that body ``b`` is fixed to, and there a ``frame`` (7,) of
        ``b``.
        """
        while b > 0 and self.bodies[b, 2] == 0:
            b, frame = int(self.bodies[b, 0]), compose(self.frames[b], frame)
        return b, frame


def build_tree(
    m: mujoco.MjModel,
    tools: Sequence[str],
    prescribed: Sequence[str] = (),
    locked: Sequence[str] = (),
) -> JointTree:
    """The tree of a compiled model.

    Args:
        tools: names of sites. prescribed: joints whose values are given. locked: joints that keep
            their value.

    Raises:
        InputError: an equality constraint that is neither ``connect``, ``weld`` nor ``joint``.
    """
    kinds = m.jnt_type.astype(np.int64)
    reference = np.array(
        [
            m.qpos0[a] if k in (SLIDE, HINGE) else 0.0
            for k, a in zip(kinds, m.jnt_qposadr, strict=True)
        ]
    )
    loops, loop_frames, coupled, polynomial = _loops(m)
    sites = [m.site(name).id for name in tools]
    held = {m.joint(name).id for name in locked}
    unknown = [d for d in range(m.nv) if int(m.dof_jntid[d]) not in held]
    return JointTree(
        bodies=np.column_stack([m.body_parentid, m.body_jntadr, m.body_jntnum]).astype(np.int64),
        frames=np.hstack([m.body_pos, quat_from_mujoco(m.body_quat)]),
        masses=np.hstack(
            [m.body_mass[:, None], m.body_ipos, _inertias(m), m.body_gravcomp[:, None]]
        ),
        joints=np.column_stack([kinds, m.jnt_bodyid, m.jnt_qposadr, m.jnt_dofadr]).astype(np.int64),
        axes=np.hstack(
            [m.jnt_pos.reshape(-1, 3), m.jnt_axis.reshape(-1, 3), reference.reshape(-1, 1)]
        ),
        armature=m.dof_armature.copy(),
        loops=np.array(loops, dtype=np.int64).reshape(-1, 3),
        loop_frames=np.array(loop_frames, dtype=float).reshape(-1, 2, 7),
        coupled=np.array(coupled, dtype=np.int64).reshape(-1, 2),
        polynomial=np.array(polynomial, dtype=float).reshape(-1, 5),
        tools=m.site_bodyid[sites].astype(np.int64),
        tool_frames=np.hstack(
            [m.site_pos[sites].reshape(-1, 3), quat_from_mujoco(m.site_quat[sites].reshape(-1, 4))]
        ),
        prescribed=np.array([m.joint(name).id for name in prescribed], dtype=np.int64),
        unknown=np.array(unknown, dtype=np.int64),
    )


def _inertias(m: mujoco.MjModel) -> Array:
    """``(nb, 9)`` inertia of each body about its centre of mass, in the body's frame."""
    out = np.empty((m.nbody, 9))
    for b in range(m.nbody):
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, m.body_iquat[b])
        turn = axes.reshape(3, 3)
        out[b] = (turn @ np.diag(m.body_inertia[b]) @ turn.T).ravel()
    return out


def _loops(m: mujoco.MjModel) -> tuple[list, list, list, list]:
    """Loop closures (type, bodies; frames) and coupled joints (joints; polynomial)."""
    loops, frames, coupled, polynomial = [], [], [], []
    for e in range(m.neq):
        if not m.eq_active0[e]:
            continue
        ends = [int(m.eq_obj1id[e]), int(m.eq_obj2id[e])]
        kind = mujoco.mjtEq(m.eq_type[e])
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            coupled.append(ends)
            polynomial.append(m.eq_data[e, :5])
        elif kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            welded = kind == mujoco.mjtEq.mjEQ_WELD
            if m.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
                frames.append(np.hstack([m.site_pos[ends], quat_from_mujoco(m.site_quat[ends])]))
                ends = [int(m.site_bodyid[end]) for end in ends]
            else:
                frames.append(
                    _welded(m.eq_data[e])
                    if welded
                    else np.hstack([m.eq_data[e, :6].reshape(2, 3), [_UPRIGHT] * 2])
                )
            loops.append([FRAME if welded else POINT, *ends])
        else:
            name = mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_EQUALITY, e) or str(e)
            raise InputError(
                f"equality {name!r} closes a loop by {kind.name.removeprefix('mjEQ_').lower()}; "
                f"allowed are connect, weld and joint"
            )
    return loops, frames, coupled, polynomial


def _welded(data: Array) -> Array:
    """``(2, 7)``: the frames, one in each body, that a weld of two bodies holds together."""
    anchor, place, turn = data[0:3], data[3:6], quat_from_mujoco(data[6:10])
    moved = np.empty(3)
    interpreted(rotate)(turn, anchor, moved)
    return np.array([[*(place + moved), *turn], [*anchor, *_UPRIGHT]])


def site_pose(m: mujoco.MjModel, data: mujoco.MjData, name: str) -> Array:
    """``(7,)`` pose of a site in MuJoCo's world; its kinematics must have been computed."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, data.site(name).xmat)
    return np.concatenate([data.site(name).xpos, quat_from_mujoco(quat)])


def compose(a: Array, b: Array) -> Array:
    """``(7,)`` pose of C in A, from those of B in A and of C in B."""
    out = np.empty(7)
    interpreted(pose_compose)(a, b, out)
    return out


def between(a: Array, b: Array) -> Array:
    """``(7,)`` pose of B in A, from the poses of both in one frame."""
    out = np.empty(7)
    interpreted(pose_between)(a, b, out)
    return out


def inverse_pose(a: Array) -> Array:
    """``(7,)`` pose of A in B, from that of B in A."""
    return between(a, np.array([0.0, 0.0, 0.0, *_UPRIGHT]))
