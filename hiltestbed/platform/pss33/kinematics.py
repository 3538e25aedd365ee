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
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, rotate
from hiltestbed.platform import model

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
def inverse(limbs, pose, sliders):
    """``sliders`` (n, 6) [m] at the poses ``(n, 7)`` of A in W."""
    arm = np.empty(3)
    for i in range(pose.shape[0]):
        for j in range(6):
            sliders[i, j] = slider(limbs[j], pose[i], arm)


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


@dataclass(frozen=True)
class Platform:
    """The platform's constants, read from its MJCF at home.

    Attributes:
        limbs: (6, 16) a limb's constants, as above.
        centre: (3,) centre of the anchors' plane, from A's origin, in A [m].
    """

    limbs: Array
    centre: Array

    @staticmethod
    @cache
    def load() -> Platform:
        """The 3-3 PSS platform of ``models/pss33``; A's home is W's origin."""
        return Platform.from_model(model.load("pss33/pss33").compile())

    @staticmethod
    def from_model(m: mujoco.MjModel) -> Platform:
        """The constants of any compiled model that contains the platform."""
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        limbs = np.empty((6, 16))
        for j in range(6):
            joint = m.joint(f"slider_{j}")
            limb = limbs[j]
            limb[0:3] = data.xanchor[joint.id]
            limb[3:6] = data.xaxis[joint.id]
            limb[6:9] = data.site(f"anchor_{j}").xpos
            for k, hinge in enumerate("ab"):
                limb[10 + 3 * k : 13 + 3 * k] = data.xaxis[m.joint(f"universal_{j}{hinge}").id]
            limb[9] = np.linalg.norm(data.site(f"link_end_{j}").xpos - limb[0:3])
        return Platform(limbs, np.array(data.body("platform").xpos))
