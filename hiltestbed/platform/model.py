"""Composes the MuJoCo model of a rig from the MJCF files in ``models/``, one folder a mechanism.

The world frame W has its origin where P stands nominally, z up along the insertion: a pose in W is a pose in P while the passive
side is at its nominal place. Site names: ``active_A`` and ``passive_P`` on the two mechanisms.
"""

from __future__ import annotations

import mujoco
import numpy as np

from hiltestbed.contact.composition import FLANGE, Structure, add_active, add_contact, add_passive, drawn, weigh_contact
from hiltestbed.contact.mount import CARRIER
from hiltestbed.contact.settings import Mechanism
from hiltestbed.models import load

BODY = "A_body"  # of the active side where it stands alone
PRESCRIBED_MASS = 1e15  # [kg], [kg m^2]
INTEGRATED_MASS = 1e8  # likewise where something beside it is integrated: from 1e12 on MuJoCo's solver does not move at all
SOLVED = 1e-12  # of the solver: forces to nine digits
PORT = np.array([0.0, 0.0, 0.60])  # [m] A above the platform's mounting plane; an adapter makes up for what a mechanism is shorter


def _options(spec: mujoco.MjSpec, timestep: float, gravity: bool) -> None:
    option = spec.option
    option.timestep = timestep
    option.gravity = [0.0, 0.0, -9.81] if gravity else [0.0, 0.0, 0.0]
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND  # one island: looking for more costs a tenth of a step
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverging run stops, it does not start again in silence


def _carrier(spec: mujoco.MjSpec, above: str | None = None) -> mujoco.MjsBody:
    """What carries the passive side: fixed, or on the upper platform, whose names have the prefix ``above``."""
    if above is None:
        return spec.worldbody.add_body(name=CARRIER)
    return spec.body(f"{above}platform").add_body(name=CARRIER, pos=spec.site(f"{above}mount").pos)


def _mount_active(spec: mujoco.MjSpec, structure: Structure) -> None:
    site = spec.site("mount")
    add_active(spec, structure, site.parent.add_body(name=FLANGE), np.array(site.pos), PORT)


def ideal_model(structure: Structure, timestep: float) -> mujoco.MjModel:
    """The mechanisms alone: the active one free, its body frame A itself, to be placed before each evaluation; no gravity.

    What is placed does not yield: the body is made immovable (PRESCRIBED_MASS) while the contact is scaled by an inverse weight of
    1/kg, so that no acceleration enters the force and stiffness and damping are exact at any lever arm.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"ideal-{structure.mechanism.kind}"
    _options(spec, timestep, gravity=False)
    add_passive(spec, structure, _carrier(spec))
    body = spec.worldbody.add_body(name=BODY)
    body.add_freejoint(name="A_joint")
    integrated = structure.mounted or structure.sides.moving
    mass = INTEGRATED_MASS if integrated else PRESCRIBED_MASS
    body.mass, body.inertia, body.explicitinertial = mass, np.full(3, mass), True
    add_active(spec, structure, body, np.zeros(3), np.zeros(3))
    add_contact(spec, structure)
    model = spec.compile()
    weigh_contact(model, BODY)
    if integrated:
        # The solver judges its progress by the mean inertia: of what moves by itself, or beside such a mass it would never see any
        first = int(model.joint("A_joint").dofadr[0])
        model.stat.meaninertia = np.delete(model.dof_M0, slice(first, first + 6)).mean()
        model.opt.tolerance = SOLVED
    return model


def rig_spec(structure: Structure, timestep: float) -> mujoco.MjSpec:
    """The whole rig: 3-3 PSS platform with the active mechanism, frame, force sensor, passive mechanism.

    The spherical joints are held as stiffly as MuJoCo allows: a time constant of two steps.
    """
    spec = load("pss33/pss33")
    spec.modelname = f"pss33-{structure.mechanism.kind}"
    _options(spec, timestep, gravity=True)
    closures = list(spec.equalities)
    spec.attach(load("frame/frame"), prefix="frame_", frame=spec.worldbody.add_frame())
    _mount_active(spec, structure)
    add_passive(spec, structure, _carrier(spec))
    add_contact(spec, structure)
    for joint in closures:
        joint.solref[:] = [2.0 * timestep, 1.0]
    return spec


def rig_model(structure: Structure, timestep: float, kept: int) -> mujoco.MjModel:
    """The rig as it is simulated: nothing that is only drawn, and the last ``kept`` readings of the sensor in its history."""
    spec = rig_spec(structure, timestep)
    spec.compiler.discardvisual = True
    for name in ("force", "torque"):
        spec.sensor(name).nsample = kept
    model = spec.compile()
    weigh_contact(model, FLANGE, structure.held)
    return model


def upper_model(mechanism: Mechanism, timestep: float) -> mujoco.MjModel:
    """The upper platform alone, with force sensor and passive mechanism, its spherical joints held as those of the lower one."""
    spec = load("prs3/prs3")
    spec.modelname = f"prs3-{mechanism.kind}"
    _options(spec, timestep, gravity=True)
    add_passive(spec, drawn(mechanism), _carrier(spec, above=""))
    spec.compiler.discardvisual = True
    for joint in spec.equalities:
        joint.solref[:] = [2.0 * timestep, 1.0]
    return spec.compile()


def nine_axis_scene(mechanism: Mechanism) -> mujoco.MjModel:
    """The rig with its upper platform as it is drawn; the names of the upper one begin with ``upper_``."""
    spec = load("pss33/pss33")
    spec.modelname = f"pss33-prs3-{mechanism.kind}"
    spec.attach(load("prs3/prs3"), prefix="upper_", frame=spec.worldbody.add_frame())
    _mount_active(spec, drawn(mechanism))
    add_passive(spec, drawn(mechanism), _carrier(spec, above="upper_"))
    return spec.compile()


def rig_scene(mechanism: Mechanism) -> mujoco.MjModel:
    """The rig as it is drawn."""
    return rig_spec(drawn(mechanism), timestep=1e-3).compile()


def sensor_columns(model: mujoco.MjModel) -> slice:
    """Where force and torque stand in what MuJoCo's sensors say."""
    first = int(model.sensor("force").adr[0])
    return slice(first, first + 6)
