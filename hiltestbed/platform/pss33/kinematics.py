"""Kinematics of the 3-3 PSS platform: six limbs, each an actuated slider, a link with a spherical
joint at both ends.

A limb's slider moves along the unit vector a through b (the far end of the link at home, s = 0);
the link of length L ends at the platform's anchor p. Of the roots of |p - b - s a| = L, the one
that is home at s = 0 is (Merlet, Parallel Robots, 2006, ch. 4):

    s = a.(p - b) - sqrt(L^2 - |perp|^2),   perp = (p - b) - a a.(p - b)

A limb's row of constants is ``b (3), a (3), anchor (3), L, e1 (3), e2 (3)``: b [m] and a in W, the
anchor [m] in A (so that the pose of A alone is needed), and the axes of the universal joint at the
slider, in W at home, with e1 x e2 along the link.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import mujoco
import numpy as np

from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array, rotate, rotate_back, rotation_matrix
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics, pose_in_words

# smallest cosine between link and slider in the rates: keeps them finite for a link that does not
# reach
STEEPEST = 0.05


@njit(cache=True)
def slider(limb, pose, arm):
    """Slider position [m] of one limb at the pose ``(7,)`` of A in W; ``arm`` (3,) becomes the
    anchor from A's origin, in W.

    A link that does not reach the anchor is treated as perpendicular to its slider.
    """
    rotate(pose[3:7], limb[6:9], arm)
    along = across = 0.0
    for i in range(3):
        d = pose[i] + arm[i] - limb[i]
        along += limb[3 + i] * d
        across += d * d
    return along - math.sqrt(max(limb[9] * limb[9] - (across - along * along), 0.0))


@njit(cache=True)
def jacobian(limbs, pose, sliders, out):
    """``out`` (6, 6): slider rates from the twist of A in W, at the pose ``(7,)``; ``sliders`` (6,)
    become those of the pose.

    With d the unit vector along the link, d.(v + w x arm) = d.a s'.
    """
    arm = np.empty(3)
    d = np.empty(3)
    for j in range(6):
        limb = limbs[j]
        s = slider(limb, pose, arm)
        sliders[j] = s
        lead = 0.0
        for i in range(3):
            d[i] = pose[i] + arm[i] - limb[i] - s * limb[3 + i]
            lead += d[i] * limb[3 + i]
        lead = max(lead, STEEPEST * limb[9])
        for i in range(3):
            out[j, i] = d[i] / lead
        out[j, 3] = (arm[1] * d[2] - arm[2] * d[1]) / lead
        out[j, 4] = (arm[2] * d[0] - arm[0] * d[2]) / lead
        out[j, 5] = (arm[0] * d[1] - arm[1] * d[0]) / lead


@njit(cache=True)
def joints(limb, pose, twist, q, v):
    """Slider and universal joint of one limb: positions ``q`` (3,) [m, rad, rad] and rates ``v``
    (3,), at the pose and twist of A.

    The unit vector along the link is d = sin(q2) e1 + cos(q2) cos(q1) u - cos(q2) sin(q1) e2, with
    u = e1 x e2.
    """
    arm = np.empty(3)
    s = slider(limb, pose, arm)
    length = limb[9]
    d = np.empty(3)
    rate = np.empty(3)
    lead = push = 0.0
    for i in range(3):
        d[i] = (pose[i] + arm[i] - limb[i] - s * limb[3 + i]) / length
    rate[0] = twist[0] + twist[4] * arm[2] - twist[5] * arm[1]
    rate[1] = twist[1] + twist[5] * arm[0] - twist[3] * arm[2]
    rate[2] = twist[2] + twist[3] * arm[1] - twist[4] * arm[0]
    for i in range(3):
        lead += d[i] * limb[3 + i]
        push += d[i] * rate[i]
    q[0], v[0] = s, push / max(lead, STEEPEST)
    d1 = d2 = du = r1 = r2 = ru = 0.0
    for i in range(3):
        turn = (rate[i] - v[0] * limb[3 + i]) / length
        j, k = (i + 1) % 3, (i + 2) % 3
        u = limb[10 + j] * limb[13 + k] - limb[10 + k] * limb[13 + j]
        d1 += d[i] * limb[10 + i]
        d2 += d[i] * limb[13 + i]
        du += d[i] * u
        r1 += turn * limb[10 + i]
        r2 += turn * limb[13 + i]
        ru += turn * u
    q[1] = math.atan2(-d2, du)
    v[1] = (d2 * ru - r2 * du) / max(du * du + d2 * d2, STEEPEST * STEEPEST)
    q[2] = math.asin(min(max(d1, -1.0), 1.0))
    v[2] = r1 / max(math.cos(q[2]), STEEPEST)


def _all_joints(limbs, adr, centre, pose, twist, q, v):
    """Positions ``q`` (nq,) and rates ``v`` (nv,) of all joints in MuJoCo's order, at the pose (7,)
    and twist (6,) of A.

    adr: (2, 7) addresses of the sliders and of the platform's free joint in ``q`` and ``v``.
    centre: (3,) the platform's origin from A's, in A [m].
    """
    limb_q, limb_v, arm = np.empty(3), np.empty(3), np.empty(3)
    for j in range(6):
        joints(limbs[j], pose, twist, limb_q, limb_v)
        for k in range(3):
            q[adr[0, j] + k] = limb_q[k]
            v[adr[1, j] + k] = limb_v[k]
    p, d = adr[0, 6], adr[1, 6]
    rotate(pose[3:7], centre, arm)
    for k in range(3):
        q[p + k] = pose[k] + arm[k]
        q[p + 4 + k] = pose[3 + k]
    q[p + 3] = pose[6]
    v[d] = twist[0] + twist[4] * arm[2] - twist[5] * arm[1]
    v[d + 1] = twist[1] + twist[5] * arm[0] - twist[3] * arm[2]
    v[d + 2] = twist[2] + twist[3] * arm[1] - twist[4] * arm[0]
    rotate_back(pose[3:7], twist[3:6], v[d + 3 : d + 6])


def limbs_of(m: mujoco.MjModel, origin: Array) -> Array:
    """``(6, 16)`` constants of the limbs of a model at home, with A at ``origin`` (3,) in W."""
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    limbs = np.empty((6, 16))
    for j in range(6):
        joint = m.joint(f"slider_{j}")
        limb = limbs[j]
        limb[0:3] = data.xanchor[joint.id]
        limb[3:6] = data.xaxis[joint.id]
        limb[6:9] = data.site(f"anchor_{j}").xpos - origin
        for k, hinge in enumerate("ab"):
            limb[10 + 3 * k : 13 + 3 * k] = data.xaxis[m.joint(f"universal_{j}{hinge}").id]
        limb[9] = np.linalg.norm(data.site(f"link_end_{j}").xpos - limb[0:3])
    return limbs


@cache
def shipped_limbs() -> Array:
    """``(6, 16)`` of ``models/pss33``, with A's home at W's origin."""
    return limbs_of(load("pss33/pss33").compile(), np.zeros(3))


class SliderKinematics(Kinematics):
    """The platform's geometry, with its inverse kinematics in closed form.

    Attributes:
        limbs: (6, 16) a limb's constants, as above.
        addresses: (2, 7) of the sliders and the platform's free joint in MuJoCo's positions and
            rates. centre: (3,) the platform's origin from A's, in A [m].
    """

    def __init__(
        self, model: mujoco.MjModel, tool: str, axes: Sequence[Axis], origin: Array
    ) -> None:
        """``origin`` (3,): position of the ``tool`` in W at home, where its attitude is W's [m]."""
        super().__init__(model, [tool], axes)
        self.limbs = limbs_of(model, origin)
        moved = [model.joint(name) for name in (*(axis.joint for axis in axes), "platform")]
        self.addresses = np.array(
            [[int(j.qposadr[0]) for j in moved], [int(j.dofadr[0]) for j in moved]]
        )
        first = self.addresses[0, 6]
        self.centre = self.home[first : first + 3] - origin

    def solve(
        self, poses: Array, held: Array | None = None, start: Array | None = None
    ) -> tuple[Array, float]:
        """Joints ``(nq,)`` for the tool at ``poses`` (1, 7), and by how much a link is short."""
        pose = np.ravel(poses)
        q, _ = self.motion(pose, np.zeros(6), self.held_home, self.held_home)
        anchors = pose[:3] + self.limbs[:, 6:9] @ rotation_matrix(pose[3:7]).T - self.limbs[:, :3]
        along = (anchors * self.limbs[:, 3:6]).sum(axis=1, keepdims=True)
        across = np.linalg.norm(anchors - along * self.limbs[:, 3:6], axis=1)
        longest = math.sqrt(1.0 - STEEPEST**2) * self.limbs[:, 9]
        return q, max(0.0, float((across - longest).max()))

    def motion(
        self, poses: Array, twists: Array, held: Array, held_rates: Array
    ) -> tuple[Array, Array]:
        q, v = self.home.copy(), np.zeros(len(self.tree.armature))
        pose, twist = (np.ascontiguousarray(np.ravel(x), dtype=float) for x in (poses, twists))
        interpreted(_all_joints)(self.limbs, self.addresses, self.centre, pose, twist, q, v)
        return q, v

    def complaints(self, poses: Array, held: Array | None = None) -> list[str]:
        """Links that do not reach, and sliders beyond their travel, with the tool at ``poses``."""
        q, left = self.solve(poses)
        if left > 0.0:
            at = pose_in_words(np.ravel(poses))
            return [f"out of reach: a link is {left:.3g} m too short at {at}"]
        return self.past_travel(q)
