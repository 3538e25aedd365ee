"""An arm as a MuJoCo model: its rigid bodies, and at each joint the law of a drive.

The chain is that of the recorded joints; the others are fixed at zero, and what they carry is part
of the body before them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from hiltestbed.axis.arm import Arm
from hiltestbed.axis.law import GAIN
from hiltestbed.axis.mjcf import STEP, MjcfModel, listed, mjcf_text, number, resistance
from hiltestbed.errors import InputError
from hiltestbed.frames import quat_to_mujoco

# [kg], [kg m^2] MuJoCo wants some in a body that has none, as the links of a chain before a tool
LEAST = 1e-9
COMPILER = f'<compiler balanceinertia="true" boundmass="{LEAST}" boundinertia="{LEAST}"/>'
IMPOSSIBLE = 1e-6  # of the moments of a body, rounding apart


def arm_mjcf(
    arm: Arm, effects: Sequence[Any], head: Sequence[str] = ()
) -> tuple[str, list[str], list[str]]:
    """The model of an arm with ``effects`` as MJCF, what it says, and what it cannot.

    Raises InputError where MuJoCo refuses a body.
    """
    import pinocchio as pin

    p, tree = arm.numbers(), arm.pinocchio
    for effect in effects:
        effect.apply_to_arm(p)
    said, unsaid = ["joints that were not recorded: fixed at zero"], []
    joints: list[MjcfModel] = []
    bodies: list[list[str]] = [[] for _ in range(tree.njoints)]
    for i, (name, body) in enumerate(zip(arm.joints, arm.bodies, strict=True), 1):
        turns, law = arm.turns[name], p.laws[name]
        linear, angular = np.split(np.asarray(tree.joints[i].createData().S).ravel(), 2)
        joint = MjcfModel(turns, name, f"{name}.", tuple(angular if turns else linear))
        joint.motor(law.numbers[GAIN])
        if p.armature[name]:
            joint.joint["armature"] = p.armature[name]
            joint.said.append(f"inertia of the rotor: joint armature {p.armature[name]:.6g}")
        resistance(joint, law)
        joints.append(joint)
        said += [f"{name}: {text}" for text in joint.said]
        unsaid += [f"{name}: {text}" for text in joint.unsaid]
        inertia = pin.Inertia.FromDynamicParameters(p.bodies[body])
        said.append(f"{body}: mass {inertia.mass:.6g}, centre of mass {listed(inertia.lever)}")
        moments = np.linalg.eigvalsh(inertia.inertia)
        if moments[2] > (1.0 + IMPOSSIBLE) * (moments[0] + moments[1]):
            unsaid.append(f"{body}: moments of inertia that no body has: their mean is used")
        about = inertia.inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        at = tree.jointPlacements[i]
        turned = quat_to_mujoco(pin.Quaternion(at.rotation).coeffs())
        bodies[i] = [
            f'<body name="{body}" pos="{listed(at.translation)}" quat="{listed(turned)}">',
            f"  {joint.joint_text(name, joint.joint)}",
            f'  <inertial pos="{listed(inertia.lever)}" mass="{number(inertia.mass)}" '
            f'fullinertia="{listed(about)}"/>',
        ]

    def carried(by: int) -> list[str]:
        return [
            line
            for i in range(1, tree.njoints)
            if tree.parents[i] == by
            for line in (*bodies[i], *(f"  {inner}" for inner in carried(i)), "</body>")
        ]

    sections = {
        "worldbody": carried(0),
        "actuator": [text for joint in joints for text in joint.actuators],
        "sensor": [joint.sensor() for joint in joints],
    }
    gravity = listed(tree.gravity.linear)
    option = f'<option timestep="{STEP}" integrator="implicitfast" gravity="{gravity}"/>'
    text = mjcf_text(f"{COMPILER}\n  {option}", sections, head, said, unsaid)
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise InputError(f"the extended arm is none that MuJoCo takes: {error}") from error
    return text, said, unsaid
