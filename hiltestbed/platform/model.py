"""Composes the MuJoCo model of a rig from the MJCF files in ``models/``, one folder a mechanism.

The world frame W has its origin where P stands nominally, z up along the insertion: a pose in W is a pose in P while the passive
side is at its nominal place. Site names: ``A`` and ``P`` on the two mechanisms.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.contact import mount
from hiltestbed.models import load

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

Array = NDArray[np.float64]

# Contact that is a spring and a damper in N/m and N s/m (hiltestbed.contact.solref) needs a small, constant impedance.
IMPEDANCE = 1e-4
CONTACT_SOLIMP = (IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 1.0)
PRESCRIBED_MASS = 1e15  # [kg], [kg m^2]
ACTIVE = "active_"
PASSIVE = "passive_"


@dataclass(frozen=True)
class Structure:
    """What a rig is made of: all that its MuJoCo model depends on, apart from numbers.

    Attributes:
        shape: of the mechanism. mounted: the passive side is on a compliant mount.
        paired: MuJoCo's own contact acts; else the wrench is applied from outside (:mod:`hiltestbed.contact.touch`).
        mechanism: one of this shape.
    """

    shape: Hashable
    mounted: bool
    paired: bool
    mechanism: Mechanism = field(compare=False)


def rigid(mechanism: Mechanism) -> Structure:
    """A rig with this mechanism on a rigid mount, whose contact is applied from outside."""
    return Structure(mechanism.shape(), mounted=False, paired=False, mechanism=mechanism)


def _options(spec: mujoco.MjSpec, timestep: float, gravity: bool) -> None:
    option = spec.option
    option.timestep = timestep
    option.gravity = [0.0, 0.0, -9.81] if gravity else [0.0, 0.0, 0.0]
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND  # one island: looking for more costs a tenth of a step
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverging run stops, it does not start again in silence


def _add_pair(spec: mujoco.MjSpec) -> None:
    """The one contact of the bumper, along the normal alone."""
    tip, surface = ACTIVE + "tip", PASSIVE + "surface"
    spec.add_pair(name="contact", geomname1=tip, geomname2=surface, condim=1, solimp=CONTACT_SOLIMP)


def _add_passive(spec: mujoco.MjSpec, structure: Structure, above: str | None = None) -> None:
    """The passive mechanism at P, on its mount if it has one, behind the six-axis force sensor at P's origin.

    It is fixed, or on the upper platform, whose names have the prefix ``above``.
    """
    if above is None:
        carrier = spec.worldbody.add_body(name="passive_carrier")
    else:
        carrier = spec.body(f"{above}platform").add_body(name="passive_carrier", pos=spec.site(f"{above}mount").pos)
    carrier.add_site(name="P_nominal")
    spec.attach(structure.mechanism.sides()[1], prefix=PASSIVE, frame=carrier.add_frame())
    if structure.mounted:
        mount.add_joints(spec.body(PASSIVE + "mechanism"))
    for sensor, name in ((mujoco.mjtSensor.mjSENS_FORCE, "force"), (mujoco.mjtSensor.mjSENS_TORQUE, "torque")):
        spec.add_sensor(name=name, type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="P_nominal")


def _site_offset(mechanism: mujoco.MjSpec, site: str) -> Array:
    """Place of a site in its mechanism's mounting frame [m]."""
    return np.array(mechanism.site(site).pos)


def ideal_model(structure: Structure, timestep: float) -> mujoco.MjModel:
    """The mechanisms alone: the active one free, its body frame A itself, to be placed before each evaluation; no gravity.

    What is placed does not yield: the body is made immovable (PRESCRIBED_MASS) while the contact is scaled by an inverse weight of
    1/kg, so that no acceleration enters the force and stiffness and damping are exact at any lever arm.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"ideal-{structure.mechanism.kind}"
    _options(spec, timestep, gravity=False)
    _add_passive(spec, structure)
    active = structure.mechanism.sides()[0]
    offset = _site_offset(active, "A")
    body = spec.worldbody.add_body(name="A_body")
    body.add_freejoint(name="A_joint")
    spec.attach(active, prefix=ACTIVE, frame=body.add_frame(pos=-offset))
    mechanism = spec.body(ACTIVE + "mechanism")
    mechanism.mass = PRESCRIBED_MASS
    mechanism.inertia = np.full(3, PRESCRIBED_MASS)
    if structure.paired:
        _add_pair(spec)
    model = spec.compile()
    model.body_invweight0[model.body(ACTIVE + "mechanism").id] = 1.0
    return model


def rig_spec(structure: Structure, timestep: float) -> mujoco.MjSpec:
    """The whole rig: 3-3 PSS platform with the active mechanism, frame, force sensor, passive mechanism.

    The spherical joints are held as stiffly as MuJoCo allows: a time constant of two steps.
    """
    spec = load("pss33/pss33")
    spec.modelname = f"pss33-{structure.mechanism.kind}"
    _options(spec, timestep, gravity=True)
    spec.attach(load("frame/frame"), prefix="frame_", frame=spec.worldbody.add_frame())
    spec.attach(structure.mechanism.sides()[0], prefix=ACTIVE, site=spec.site("mount"))
    _add_passive(spec, structure)
    if structure.paired:
        _add_pair(spec)
    for joint in spec.equalities:
        joint.solref[:] = [2.0 * timestep, 1.0]
    return spec


def rig_model(structure: Structure, timestep: float, kept: int) -> mujoco.MjModel:
    """The rig as it is simulated: nothing that is only drawn, and the last ``kept`` readings of the sensor in its history."""
    spec = rig_spec(structure, timestep)
    spec.compiler.discardvisual = True
    for sensor in spec.sensors:
        sensor.nsample = kept
    return spec.compile()


def upper_model(mechanism: Mechanism, timestep: float) -> mujoco.MjModel:
    """The upper platform alone, with force sensor and passive mechanism, its spherical joints held as those of the lower one."""
    spec = load("prs3/prs3")
    spec.modelname = f"prs3-{mechanism.kind}"
    _options(spec, timestep, gravity=True)
    _add_passive(spec, rigid(mechanism), above="")
    spec.compiler.discardvisual = True
    for joint in spec.equalities:
        joint.solref[:] = [2.0 * timestep, 1.0]
    return spec.compile()


def nine_axis_scene(mechanism: Mechanism) -> mujoco.MjModel:
    """The rig with its upper platform as it is drawn; the names of the upper one begin with ``upper_``."""
    spec = load("pss33/pss33")
    spec.modelname = f"pss33-prs3-{mechanism.kind}"
    spec.attach(load("prs3/prs3"), prefix="upper_", frame=spec.worldbody.add_frame())
    spec.attach(mechanism.sides()[0], prefix=ACTIVE, site=spec.site("mount"))
    _add_passive(spec, rigid(mechanism), above="upper_")
    return spec.compile()


def rig_scene(mechanism: Mechanism) -> mujoco.MjModel:
    """The rig as it is drawn."""
    return rig_spec(rigid(mechanism), timestep=1e-3).compile()
