"""Stiffness [N/m] and damping [N s/m] as MuJoCo's contact parameters.

With a direct ``solref = (-K A, -C A)``, a constant impedance d = 1e-4 and elliptic cones, MuJoCo's
soft contact gives F = K x + C v, never negative, for penetration x and its rate v at the start of
the step. A [1/kg] is the sum of the inverse weights of the two bodies that carry the geoms,
``body_invweight0``, with a correction: see
:func:`hiltestbed.contact.composition.inverse_mass`.

This is for contacts that push only along the normal; for friction, other laws and other surfaces
see :mod:`hiltestbed.contact.engagement`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from mujoco.batch import Batch

from hiltestbed.contact.composition import inverse_mass
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario

NO_DAMPING = -1e-12  # [1/s] MuJoCo reads a solref as direct only when both numbers are negative


def linear_solref(stiffness: Array, damping: Array, inverse_mass: Array) -> Array:
    """``(n, npair, 2)`` solref of linear contacts of stiffness ``(n,)`` [N/m] and damping ``(n,)``
    [N s/m].
    """
    solref = np.empty((len(stiffness), len(inverse_mass), 2))
    solref[..., 0] = -np.asarray(stiffness)[:, None] * inverse_mass
    solref[..., 1] = np.minimum(-np.asarray(damping)[:, None] * inverse_mass, NO_DAMPING)
    return solref


def set_linear(batch: Batch, scenarios: Sequence[Scenario]) -> None:
    """Set each run of a batch to its scenario's stiffness and damping."""
    contacts, m = [s.mechanism.contact for s in scenarios], batch.model
    stiffness, damping = (
        np.array([getattr(c, name) for c in contacts]) for name in ("stiffness", "damping")
    )
    bodies = m.geom_bodyid[np.stack([m.pair_geom1, m.pair_geom2])]
    batch.expand("pair_solref")[:] = linear_solref(stiffness, damping, inverse_mass(m, bodies))
