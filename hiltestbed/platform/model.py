"""Composes the MuJoCo model of a rig from the MJCF files in ``models/``, one folder per mechanism.

The world frame W has its origin at the nominal position of P, z up along the insertion: a pose in W
is a pose in P while the passive side is at its nominal pose. Site names: ``active_A`` and
``passive_P`` on the two mechanisms.
"""

from __future__ import annotations

import mujoco
import numpy as np

from hiltestbed.config.models import load
from hiltestbed.contact.composition import (
    Structure,
    add_active,
    add_contact,
    add_passive,
    drawn,
    weigh_contact,
)
from hiltestbed.contact.mount import CARRIER
from hiltestbed.contact.settings import Mechanism
from hiltestbed.platform.facilities.facility import compiled, set_steps

UPPER = "upper_"  # prefix of the names of a drawn upper platform
BODY = "A_body"  # body of the active side without a platform
PRESCRIBED_MASS = 1e15  # [kg], [kg m^2]
# likewise if other bodies are integrated as well: from 1e12 on MuJoCo's solver makes no progress
INTEGRATED_MASS = 1e8
SOLVED = 1e-12  # tolerance of the solver: forces to nine digits
# [m] A above the platform's mounting plane; an adapter fills the gap below a shorter mechanism
PORT = np.array([0.0, 0.0, 0.60])


def _carrier(spec: mujoco.MjSpec, above: str | None = None) -> mujoco.MjsBody:
    """The body that carries the passive side: fixed, or on the upper platform (a prefix)."""
    if above is None:
        return spec.worldbody.add_body(name=CARRIER)
    return spec.body(f"{above}platform").add_body(name=CARRIER, pos=spec.site(f"{above}mount").pos)


def _mount_active(spec: mujoco.MjSpec, structure: Structure) -> None:
    site = spec.site("mount")
    add_active(spec, structure, site.parent, np.array(site.pos), PORT)


def ideal_model(structure: Structure, timestep: float) -> mujoco.MjModel:
    """The mechanisms alone: the active one a free body with frame A, placed before each evaluation;
    no gravity.

    The placed body must not yield: its mass makes it immovable (PRESCRIBED_MASS) while the contact
        is scaled by an inverse weight of 1/kg, so that no acceleration enters the force, and
        stiffness and damping are exact at any lever arm.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"ideal-{structure.mechanism.kind}"
    spec.option.cone, spec.option.gravity = mujoco.mjtCone.mjCONE_ELLIPTIC, [0.0, 0.0, 0.0]
    set_steps(spec, timestep)
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
        # The solver scales its progress by the mean inertia, which must be that of the integrated
        # bodies alone: with the prescribed mass it would always appear converged
        first = int(model.joint("A_joint").dofadr[0])
        model.stat.meaninertia = np.delete(model.dof_M0, slice(first, first + 6)).mean()
        model.opt.tolerance = SOLVED
    return model


def upper_model(mechanism: Mechanism, timestep: float) -> mujoco.MjModel:
    """The upper platform alone, with force sensor and passive mechanism."""
    spec = load("prs3/prs3")
    spec.modelname = f"prs3-{mechanism.kind}"
    spec.option.cone, spec.option.gravity = mujoco.mjtCone.mjCONE_ELLIPTIC, [0.0, 0.0, -9.81]
    add_passive(spec, drawn(mechanism), _carrier(spec, above=""))
    return compiled(spec, timestep)


def nine_axis_scene(mechanism: Mechanism) -> mujoco.MjModel:
    """The rig with its upper platform, for drawing; the latter's names begin with UPPER."""
    spec = load("pss33/pss33")
    spec.modelname = f"pss33-prs3-{mechanism.kind}"
    spec.attach(load("prs3/prs3"), prefix=UPPER, frame=spec.worldbody.add_frame())
    _mount_active(spec, drawn(mechanism))
    add_passive(spec, drawn(mechanism), _carrier(spec, above=UPPER))
    return spec.compile()


def sensor_columns(model: mujoco.MjModel) -> slice:
    """Columns of force and torque in MuJoCo's sensor data."""
    first = int(model.sensor("force").adr[0])
    return slice(first, first + 6)
