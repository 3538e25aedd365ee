"""The 3-3 PSS platform as stepped by the plant: its model in the frame, and its servo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.contact.composition import Structure
from hiltestbed.frames import Array
from hiltestbed.platform import model
from hiltestbed.platform.pss33.kinematics import Platform, inverse
from hiltestbed.platform.pss33.servo import Servo
from hiltestbed.platform.pss33.settings import pss33_of

if TYPE_CHECKING:
    from hiltestbed.contact.contacts import Contacts
    from hiltestbed.scenario.like import ScenarioLike as Scenario

UNITS = ("m",) * 6


class Pss33Rig(Servo):
    """The rigs of `n` runs; see :class:`hiltestbed.platform.facilities.rig.FacilityRig` for the
    interface to the plant.
    """

    keeps_history, moves_passive = True, False
    load = watch = None
    mover: Any = None
    units = UNITS

    def __init__(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> None:
        self.model = model.rig_model(structure, dt, kept=scenarios[0].substeps)
        feed = np.array([s.compensation.motion.feeds for s in scenarios])
        first = scenarios[0]
        super().__init__(
            self.model, [pss33_of(s) for s in scenarios], first.tick, first.substeps, feed
        )

    def start(self, batch: Batch, scenarios: Sequence[Scenario], dt: float) -> Pss33Rig:
        """Bind the servo to the batch of the model."""
        self.batch = batch
        self.add_friction(scenarios, batch.bind("qfrc_applied"))
        return self

    def tare(self, contacts: Contacts, reading: Array, columns: slice) -> Array:
        """``(n, 6)`` the sensor's reading at rest, with the active side one metre away."""
        self.batch.bind("qpos")[:, self.model.joint("platform").qposadr[0] + 2] -= 1.0
        contacts.balance()
        self.batch.forward()
        return reading.copy()

    def observing(
        self,
        qpos: Array,
        qvel: Array,
        limit: float,
        shown: tuple[Array, Array, Array],
        diverged: NDArray[np.bool_],
    ) -> Callable[[], bool] | None:
        """:meth:`observe` bound to arrays that are reused."""
        return self._seen.on(qpos, qvel, limit, *shown, diverged)

    def shown(self) -> tuple[Array, Array, Array]:
        """The arrays that :meth:`observe` fills: poses (n, 7), twists (n, 6) and sliders (n, 6)."""
        n = len(self.target)
        return np.zeros((n, 7)), np.zeros((n, 6)), np.zeros((n, 6))

    def passed(self) -> bool:
        """False: the limits of this platform are keys of the scenario's safety section."""
        return False


class Pss33Follower:
    """The sliders of rigs under exact tracking."""

    units = UNITS

    def __init__(self) -> None:
        self._limbs = Platform.load().limbs

    def follow(self, pose: Array, twist: Array, joints: Array) -> None:
        """Write the sliders ``joints`` (n, 6) at the poses (n, 7) of A in W."""
        inverse(self._limbs, pose, joints)
