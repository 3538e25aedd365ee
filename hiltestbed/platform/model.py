"""The MuJoCo model of the mechanisms alone, without a platform, of the MJCF files in ``models/``.

The world frame W has its origin at the nominal position of P, z up along the insertion: a pose in W
is a pose in P while the passive side is at its nominal pose. Site names: ``active_A`` and
``passive_P`` on the two mechanisms.
"""

from __future__ import annotations

import mujoco
import numpy as np

from hiltestbed.contact.composition import (
    Structure,
    add_active,
    add_contact,
    add_passive,
    weigh_contact,
)
from hiltestbed.contact.mount import CARRIER
from hiltestbed.platform.facilities.facility import set_steps

BODY = "A_body"  # body of the active side without a platform
PRESCRIBED_MASS = 1e15  # [kg], [kg m^2]
# likewise if other bodies are integrated as well: from 1e12 on MuJoCo's solver makes no progress
INTEGRATED_MASS = 1e8
SOLVED = 1e-12  # tolerance of the solver: forces to nine digits


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
    add_passive(spec, structure, spec.worldbody.add_body(name=CARRIER))
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
