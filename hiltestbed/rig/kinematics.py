"""Kinematics of the 3-3 PSS platform: six limbs, each an actuated slider, a link with a spherical joint at both ends.

A limb's slider moves along the unit vector a through b (the far end of the link at home, s = 0); the link of length L ends at the
platform's anchor p. Then |p - b - s a| = L gives the one root that is home at s = 0 (Merlet, Parallel Robots, 2006, ch. 4):

    s = a.(p - b) - sqrt(L^2 - |perp|^2),   perp = (p - b) - a a.(p - b)

A limb's row of constants is ``b (3), a (3), anchor (3), L``, [m], b and a in W and the anchor in A: IK needs the pose of A alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
from numba import njit

from hiltestbed.frames import Array, rotate
from hiltestbed.rig import model


@njit(cache=True)
def slider(limb, pose, arm):
    """Slider position [m] of one limb at the pose ``(7,)`` of A in W; ``arm`` (3,) becomes the anchor from A's origin, in W.

    A link that does not reach is taken at its longest reach sideways.
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
    """``out`` (6, 6): slider rates from the twist of A in W, at the pose ``(7,)``; ``sliders`` (6,) become those of the pose.

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
        for i in range(3):
            out[j, i] = d[i] / lead
        out[j, 3] = (arm[1] * d[2] - arm[2] * d[1]) / lead
        out[j, 4] = (arm[2] * d[0] - arm[0] * d[2]) / lead
        out[j, 5] = (arm[0] * d[1] - arm[1] * d[0]) / lead


@dataclass(frozen=True)
class Platform:
    """The platform's constants, read from its MJCF at home.

    Attributes:
        limbs: (6, 10) a limb's constants, as above.
        centre: (3,) centre of the anchors' plane, from A's origin, in A [m].
    """

    limbs: Array
    centre: Array

    @staticmethod
    @cache
    def load() -> Platform:
        """The 3-3 PSS platform as it stands in ``models/pss33``; A's home is W's origin."""
        return Platform.from_model(model.load("pss33/pss33").compile())

    @staticmethod
    def from_model(m: mujoco.MjModel) -> Platform:
        """The constants of any compiled model that holds the platform."""
        data = mujoco.MjData(m)
        mujoco.mj_kinematics(m, data)
        limbs = np.empty((6, 10))
        for j in range(6):
            joint = m.joint(f"slider_{j}")
            limb = limbs[j]
            limb[0:3] = data.xanchor[joint.id]
            limb[3:6] = data.xaxis[joint.id]
            limb[6:9] = data.site(f"anchor_{j}").xpos
            limb[9] = np.linalg.norm(data.site(f"link_end_{j}").xpos - limb[0:3])
        return Platform(limbs, np.array(data.body("platform").xpos))
