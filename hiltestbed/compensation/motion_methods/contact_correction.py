"""Correction of the force for the platform's tracking error: ``F + k (x_cmd - x_act) + c (v_cmd -
v_act)`` while in contact.

k and c are identified in the loop (T. Ren, C. Qi, F. Gao, X. Zhao, Q. Sun, "Compensation of
velocity divergence caused by dynamic response for hardware-in-the-loop docking simulator",
IEEE/ASME Trans. Mechatronics 2017; F. He et al., Chin. J. Mech. Eng. 35:149,
2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import Input, MotionMethod
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, add_moment, rotate, twist_between
from hiltestbed.identification.samples import GATE_SIGMA
from hiltestbed.plugins import register


@register
class ContactCorrection(MotionMethod):
    """The force is corrected for the platform's tracking error by k (x_cmd - x_act) + c (v_cmd -
    v_act), with identified k and c.
    """

    kind: Literal["contact_correction"] = "contact_correction"
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist", "identified"})
    tells_model_pose: ClassVar[bool] = True
    corrects_force: ClassVar[bool] = True


class Gate:
    """Contact as seen by the axial force of ``n`` runs: from the reading that exceeds its noise to
    the first that does not push.

    Attributes:
        threshold: (n,) [N]. touching: (n,) bool.
    """

    def __init__(self, noise: Sequence[float]) -> None:
        """``noise``: [N] standard deviation of a force axis, of each run."""
        self.threshold = GATE_SIGMA * np.array(noise)
        self.touching = np.zeros(len(noise), dtype=bool)


def correct_for_platform(
    measurement: Measurement, pose: Array, twist: Array, gate: Gate, wrench: Array
) -> None:
    """Add to ``wrench`` (n, 6) the contact force at ``pose`` (n, 7) and ``twist`` (n, 6), commanded
    for t_k, less that at the rig's state.

    Axes without an estimate are not corrected, nor is anything outside a contact: noise is none,
    and the platform still lags after one.
    """
    m = measurement
    rig, contact = (m.wrench, m.pose, m.twist), (m.stiffness, m.damping, m.captured, m.lever)
    _correct(pose, twist, gate.threshold, gate.touching, rig, contact, wrench)


@njit(cache=True)
def _correct(pose, twist, threshold, touching, rig, contact, wrench):
    reading, pose_act, twist_act = rig
    stiffness, damping, captured, lever = contact
    offset, speed, force = np.empty(6), np.empty(6), np.empty(6)
    at = np.empty(3)
    for i in range(wrench.shape[0]):
        touching[i] = captured[i] or reading[i, 2] > (0.0 if touching[i] else threshold[i])
        if not touching[i]:
            continue
        twist_between(pose_act[i], pose[i], 1.0, offset)
        speed[:] = twist[i] - twist_act[i]
        rotate(pose_act[i, 3:7], lever[i], at)
        _move(at, offset)
        _move(at, speed)
        force[:] = 0.0
        for j in range(6):
            if stiffness[i, j] > 0.0:
                force[j] = stiffness[i, j] * offset[j] + damping[i, j] * speed[j]
        if captured[i]:
            for j in range(3):
                at[j] += pose_act[i, j]
            add_moment(1.0, at, force)
        wrench[i] += force


@njit(cache=True)
def _move(at, twist):
    """Refer a ``twist`` (6,), or a small motion, to the point ``at`` (3,) from its present one."""
    twist[0] += twist[4] * at[2] - twist[5] * at[1]
    twist[1] += twist[5] * at[0] - twist[3] * at[2]
    twist[2] += twist[3] * at[1] - twist[4] * at[0]
