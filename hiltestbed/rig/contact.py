"""Stiffness and damping in N/m and N s/m, compiled to MuJoCo's contact parameters.

With a direct ``solref = (-K A, -C A)``, a constant impedance d = 1e-4 and elliptic cones, MuJoCo's soft contact gives
F = K x + C v, never negative, for penetration x and its rate v at the start of the step. A [1/kg] is the sum of the inverse
weights of the two bodies that carry the geoms, ``body_invweight0``. Static stiffness is K/(1 - d).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np
from mujoco.batch import Batch
from numba import njit

from hiltestbed.frames import Array
from hiltestbed.rig import model

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

CREEP_DAMPING = 2.0e5  # [N s/m] of friction below the Coulomb limit: a load of 20 N creeps at 1e-4 m/s
NO_DAMPING = -1e-12  # [1/s] MuJoCo reads a solref as direct only when both numbers are negative


class ContactLaw(Protocol):
    """A contact's force law, for all runs of a batch at once."""

    def force(self, x: Array, v: Array) -> Array:
        """``(n,)`` normal force [N] from the penetration x ``(n,)`` [m] (> 0 in touch) and its rate v ``(n,)`` [m/s]."""
        ...


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


@njit(cache=True)
def law_solref(x, force, inverse_mass, pair, out):
    """Write the solref that makes ``force`` ``(n,)`` [N] act at the penetration ``x`` ``(n,)`` [m] into ``out[:, pair]``."""
    for i in range(x.shape[0]):
        f = force[i]
        out[i, pair, 0] = -f * inverse_mass[pair] / x[i] if x[i] > 0.0 and f > 0.0 else -1e-12
        out[i, pair, 1] = NO_DAMPING


class PairContact:
    """The contact parameters of the runs of a batch, each run its own.

    Attributes:
        law: a :class:`ContactLaw` in place of the linear one, or None.
        friction: (n,) Coulomb coefficient [-]; set it through :meth:`set_friction`.
    """

    def __init__(self, batch: Batch, scenarios: Sequence[Scenario], scale: float) -> None:
        """``scale`` multiplies stiffness and damping: 1, or 1 - d where the bodies are placed rather than integrated."""
        self.law: ContactLaw | None = None
        self.inverse_mass = pair_inverse_mass(batch.model)
        self._scale = scale
        self._solref = batch.expand("pair_solref")
        contacts = [s.mechanism.contact for s in scenarios]
        creep = batch.expand("pair_solreffriction")
        creep[..., 0] = NO_DAMPING
        creep[..., 1] = -scale * CREEP_DAMPING / model.IMPRATIO * self.inverse_mass
        self.set_linear(np.array([c.stiffness for c in contacts]), np.array([c.damping for c in contacts]))
        self._pair_friction = batch.expand("pair_friction")
        self.set_friction(np.array([c.friction for c in contacts]))

    def set_linear(self, stiffness: Array, damping: Array) -> None:
        """Stiffness ``(n,)`` [N/m] and damping ``(n,)`` [N s/m] of the linear contact."""
        self._solref[:] = linear_solref(self._scale * stiffness, self._scale * damping, self.inverse_mass)

    def set_friction(self, friction: Array) -> None:
        """Coulomb coefficient ``(n,)`` [-] of every pair; it acts only where the scenario's friction is not zero."""
        self.friction = np.asarray(friction, dtype=float)
        self._pair_friction[:, :, 0:2] = np.maximum(self.friction, mujoco.mjMINMU)[:, None, None]

    def update(self, x: Array, v: Array) -> None:
        """Write the law's force for the penetration and rate at the start of the step, both ``(n,)``."""
        if self.law is not None:
            law_solref(x, self.law.force(x, v), self._scale * self.inverse_mass, 0, self._solref)
