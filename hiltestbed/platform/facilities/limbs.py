"""Platforms on limbs, each a driven slider and a link of constant length to the platform: their
inverse kinematics and inverse dynamics in closed form, which take a third of the time that Newton's
method on the tree takes (:mod:`hiltestbed.platform.facilities.newton`), with the same result.

A limb's slider moves along the unit vector a through b (the far end of the link at home, s = 0);
the link of length |L| ends at the platform's anchor p. Of the roots of |p - b - s a| = |L| (Merlet,
Parallel Robots, 2006, ch. 4)

    s = a.(p - b) - sign(L) sqrt(L^2 - |perp|^2),   perp = (p - b) - a a.(p - b)

is the one at home, with L positive for a link that points along its slider's axis there.

Inverse dynamics, gravity included: platform with mechanism as one rigid body, links as uniform rods
between carriage and anchor (consistent mass m/3, m/6, m/3, half the weight at each end), carriages
with their drives' armature. Of the velocity-dependent terms only those of the platform are known:
those of links and carriages are neglected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.frames import Array, cross, rotate, rotation_matrix
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics, pose_in_words
from hiltestbed.platform.facilities.motion import GRAVITY, carry, load_of

# smallest cosine between link and slider in the rates: keeps them finite for a link that does not
# reach
STEEPEST = 0.05


@njit(cache=True)
def slider(limb, pose, arm):
    """Slider position [m] of one limb at the pose ``(7,)`` of the tool in W; ``arm`` (3,) becomes
    the anchor from the tool's origin, in W.

    ``limb`` (10,): b (3) [m] and a (3) in W, the anchor (3) [m] in the tool (so that the tool's
    pose alone is needed), and L [m]. A link that does not reach the anchor is treated as
    perpendicular to its slider.
    """
    rotate(pose[3:7], limb[6:9], arm)
    along = across = 0.0
    for i in range(3):
        d = pose[i] + arm[i] - limb[i]
        along += limb[3 + i] * d
        across += d * d
    reach = math.sqrt(max(limb[9] * limb[9] - (across - along * along), 0.0))
    return along - math.copysign(reach, limb[9])


@njit(cache=True)
def jacobian(limbs, pose, sliders, out):
    """``out`` (J, 6): slider rates from the twist of the tool in W, at the pose ``(7,)``;
    ``sliders`` (J,) become those of the pose.

    With d the vector along the link, d.(v + w x arm) = d.a s'.
    """
    arm = np.empty(3)
    d = np.empty(3)
    for j in range(limbs.shape[0]):
        limb = limbs[j]
        s = slider(limb, pose, arm)
        sliders[j] = s
        lead = 0.0
        for i in range(3):
            d[i] = pose[i] + arm[i] - limb[i] - s * limb[3 + i]
            lead += d[i] * limb[3 + i]
        least = STEEPEST * limb[9]
        lead = max(lead, least) if least > 0.0 else min(lead, least)
        for i in range(3):
            out[j, i] = d[i] / lead
        out[j, 3] = (arm[1] * d[2] - arm[2] * d[1]) / lead
        out[j, 4] = (arm[2] * d[0] - arm[0] * d[2]) / lead
        out[j, 5] = (arm[0] * d[1] - arm[1] * d[0]) / lead


@njit(cache=True)
def invert(a, out):
    """``out = a^-1`` (n, n), row pivoting; overwrites ``a``. Singular: huge numbers."""
    n = a.shape[0]
    for i in range(n):
        for k in range(n):
            out[i, k] = 1.0 if i == k else 0.0
    for c in range(n):
        p = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[p, c]):
                p = r
        if p != c:
            for k in range(n):
                a[c, k], a[p, k] = a[p, k], a[c, k]
                out[c, k], out[p, k] = out[p, k], out[c, k]
        scale = 1.0 / (a[c, c] if abs(a[c, c]) > 1e-9 else math.copysign(1e-9, a[c, c]))
        for k in range(n):
            a[c, k] *= scale
            out[c, k] *= scale
        for r in range(n):
            f = a[r, c]
            if r != c and f != 0.0:
                for k in range(n):
                    a[r, k] -= f * a[c, k]
                    out[r, k] -= f * out[c, k]


@njit(cache=True)
def limb_forces(limbs, moved, ways, motion, accel, work, force):
    """``force`` (J,) [N] of the drives for slider accelerations ``accel`` (J,) [m/s^2].

    Args:
        moved: (16,) as in :func:`moved_masses`. ways: (6, J) twist of the tool in W per unit rate
            of each slider; by virtual work its transpose maps wrenches to slider forces. motion:
            pose (7,), angular velocity (3,) and acceleration (6,), less gravity's, of the tool in
            W. work: (>= 8, 3), overwritten.
    """
    pose, spin, a = motion
    link, carriage, armature = moved[13], moved[14], moved[15]
    wrench, r, f, turn = work[6:8].reshape(6), work[2], work[3], work[4]
    carry(moved, pose[3:7], spin, a, work, wrench)
    for j in range(limbs.shape[0]):
        limb = limbs[j]
        rotate(pose[3:7], limb[6:9], r)
        cross(a[3:6], r, f)
        along = 0.0
        for i in range(3):
            f[i] += a[i]
            along += limb[3 + i] * f[i]
            f[i] = link * (f[i] / 3.0 + limb[3 + i] * accel[j] / 6.0)
        f[2] += link / 6.0 * GRAVITY
        own = accel[j] + limb[5] * GRAVITY
        cross(r, f, turn)
        for i in range(3):
            wrench[i] += f[i]
            wrench[3 + i] += turn[i]
        force[j] = link * (along / 6.0 + own / 3.0) + carriage * own + armature * accel[j]
    for j in range(limbs.shape[0]):
        for i in range(6):
            force[j] += ways[i, j] * wrench[i]


def moved_masses(m: mujoco.MjModel, tool: str) -> Array:
    """``(16,)``: mass [kg] of the platform with all that it carries, its centre of mass from the
    ``tool`` (3) [m], inertia about it (9, row-major) [kg m^2], then link mass, carriage mass and
    armature [kg], of a compiled model at home.
    """
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    platform = m.body("platform").id
    bodies = [b for b in range(m.nbody) if m.body_rootid[b] == platform]
    carriage, link = m.body("carriage_0").mass[0], m.body("link_0").mass[0]
    armature = m.dof_armature[m.joint("slider_0").dofadr[0]]
    load = load_of(m, data, bodies, data.site(tool).xpos)
    return np.concatenate([load, [link, carriage, armature]])


def limbs_of(m: mujoco.MjModel, origin: Array, prefix: str = "") -> Array:
    """``(J, 10)`` constants of the limbs of a model at home, as in :func:`slider`, for a tool at
    ``origin`` (3,) in W with W's attitude; ``prefix`` of the names of the platform's parts.
    """
    data = mujoco.MjData(m)
    mujoco.mj_kinematics(m, data)
    every = (m.joint(j) for j in range(m.njnt))
    joints = [joint for joint in every if joint.name.startswith(f"{prefix}slider_")]
    limbs = np.empty((len(joints), 10))
    for j, (joint, limb) in enumerate(zip(joints, limbs, strict=True)):
        limb[0:3] = data.xanchor[joint.id]
        limb[3:6] = data.xaxis[joint.id]
        limb[6:9] = data.site(f"{prefix}anchor_{j}").xpos - origin
        link = data.site(f"{prefix}link_end_{j}").xpos - limb[0:3]
        limb[9] = math.copysign(np.linalg.norm(link), link @ limb[3:6])
    return limbs


class LimbKinematics(Kinematics):
    """Geometry of a platform on limbs; the joints of its links follow from the loops.

    Attributes:
        limbs: (J, 10) as in :func:`slider`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        tool: str,
        axes: Sequence[Axis],
        origin: Array,
        prefix: str = "",
    ) -> None:
        """``origin`` (3,): position of the ``tool`` in W at home, where its attitude is W's [m]."""
        super().__init__(model, [tool], axes)
        self.limbs = limbs_of(model, origin, prefix)
        self._free = int(model.joint(f"{prefix}platform").qposadr[0])
        self._centre = self.home[self._free : self._free + 3] - origin

    def solve(
        self, poses: Array, held: Array | None = None, start: Array | None = None
    ) -> tuple[Array, float]:
        """Joints ``(nq,)`` for the tool at ``poses`` (1, 7), and by how much a link is short [m];
        what is not part of the platform stays at ``start`` (home).
        """
        q, arm = (self.home if start is None else start).copy(), np.empty(3)
        pose = np.ascontiguousarray(np.ravel(poses), dtype=float)
        q[self.q] = [interpreted(slider)(limb, pose, arm) for limb in self.limbs]
        interpreted(rotate)(pose[3:7], self._centre, arm)
        q[self._free : self._free + 3] = pose[:3] + arm
        q[self._free + 3 : self._free + 7] = pose[[6, 3, 4, 5]]
        anchors = pose[:3] + self.limbs[:, 6:9] @ rotation_matrix(pose[3:7]).T - self.limbs[:, :3]
        along = (anchors * self.limbs[:, 3:6]).sum(axis=1, keepdims=True)
        across = np.linalg.norm(anchors - along * self.limbs[:, 3:6], axis=1)
        longest = math.sqrt(1.0 - STEEPEST**2) * np.abs(self.limbs[:, 9])
        return self.closed(q), max(0.0, float((across - longest).max()))

    def motion(
        self, poses: Array, twists: Array, held: Array, held_rates: Array
    ) -> tuple[Array, Array]:
        q, _ = self.solve(poses)
        count = len(self.limbs)
        jac = np.empty((count, 6))
        interpreted(jacobian)(self.limbs, np.ravel(poses), np.empty(count), jac)
        return q, self.following(q, jac @ np.ravel(twists))

    def complaints(self, poses: Array, held: Array | None = None) -> list[str]:
        """Links that do not reach, and sliders beyond their travel, with the tool at ``poses``."""
        q, left = self.solve(poses)
        if left > 0.0:
            at = pose_in_words(np.ravel(poses))
            return [f"out of reach: a link is {left:.3g} m too short at {at}"]
        return self.past_travel(q)
