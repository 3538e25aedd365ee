"""Correction of the force for where the platform is not: ``F + k (x_cmd - x_act) + c (v_cmd - v_act)`` while in contact.

k and c are identified in the loop (T. Ren, C. Qi, F. Gao, X. Zhao, Q. Sun, "Compensation of velocity divergence caused by dynamic
response for hardware-in-the-loop docking simulator", IEEE/ASME Trans. Mechatronics 2017; F. He et al., Chin. J. Mech. Eng. 35:149,
2022). The platform keeps its lag; the numerical model gets the force that it would have met without it. It rests on the contact
being a spring and damper.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from numba import njit

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input, MotionMethod
from hiltestbed.frames import Array, twist_between
from hiltestbed.plugins import register


@register
class ContactCorrection(MotionMethod):
    """The force is corrected for the error of the platform, by k (x_cmd - x_act) + c (v_cmd - v_act) with k and c as identified."""

    kind: Literal["contact_correction"] = "contact_correction"
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist", "identified"})
    tells_model_pose: ClassVar[bool] = True
    corrects_force: ClassVar[bool] = True


def correct_for_platform(measurement: Measurement, pose: Array, twist: Array, wrench: Array) -> None:
    """Add to ``wrench`` (n, 6) what ``pose`` (n, 7) and ``twist`` (n, 6), commanded for t_k, would have met more than the rig did.

    Axes without an estimate stay as they are.
    """
    m = measurement
    _correct(pose, twist, m.wrench, m.pose, m.twist, m.stiffness, m.damping, wrench)


@njit(cache=True)
def _correct(pose, twist, reading, pose_act, twist_act, stiffness, damping, wrench):
    offset = wrench[0] * 0.0
    for i in range(wrench.shape[0]):
        if reading[i, 2] <= 0.0:
            continue
        twist_between(pose_act[i], pose[i], 1.0, offset)
        for j in range(6):
            if stiffness[i, j] > 0.0:
                wrench[i, j] += stiffness[i, j] * offset[j] + damping[i, j] * (twist[i, j] - twist_act[i, j])
