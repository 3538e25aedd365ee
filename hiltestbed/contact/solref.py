"""Stiffness and damping in N/m and N s/m, compiled to MuJoCo's contact parameters.

With a direct ``solref = (-K A, -C A)``, a constant impedance d = 1e-4 and elliptic cones, MuJoCo's soft contact gives
F = K x + C v, never negative, for penetration x and its rate v at the start of the step. A [1/kg] is the sum of the inverse
weights of the two bodies that carry the geoms, ``body_invweight0``. Static stiffness is K/(1 - d).

This serves contacts that push along the normal alone; friction, other laws and other surfaces are :mod:`hiltestbed.contact.engagement`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch

from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

NO_DAMPING = -1e-12  # [1/s] MuJoCo reads a solref as direct only when both numbers are negative


def pair_inverse_mass(model: mujoco.MjModel) -> Array:
    """``(npair,)`` A of each contact pair [1/kg]."""
    weight = model.body_invweight0[:, 0]
    geoms = np.stack([model.pair_geom1, model.pair_geom2])
    return weight[model.geom_bodyid[geoms]].sum(axis=0)


def linear_solref(stiffness: Array, damping: Array, inverse_mass: Array) -> Array:
    """``(n, npair, 2)`` solref of linear contacts of stiffness ``(n,)`` [N/m] and damping ``(n,)`` [N s/m]."""
    solref = np.empty((len(stiffness), len(inverse_mass), 2))
    solref[..., 0] = -np.asarray(stiffness)[:, None] * inverse_mass
    solref[..., 1] = np.minimum(-np.asarray(damping)[:, None] * inverse_mass, NO_DAMPING)
    return solref


def set_linear(batch: Batch, scenarios: Sequence[Scenario], scale: Array) -> None:
    """Give each run of a batch its scenario's stiffness and damping.

    ``scale`` (n,) multiplies both: 1, or 1 - d where the bodies are placed rather than integrated.
    """
    contacts = [s.mechanism.contact for s in scenarios]
    stiffness = scale * np.array([c.stiffness for c in contacts])
    damping = scale * np.array([c.damping for c in contacts])
    batch.expand("pair_solref")[:] = linear_solref(stiffness, damping, pair_inverse_mass(batch.model))
