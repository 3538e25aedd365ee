"""Outcome of a docking: captured, rebounded, missed, or still in contact; all its contacts; and the
joints of the mechanism's moving parts (stroke, ring, jaws) and of its mount, for the trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.composition import ACTIVE, PASSIVE
from hiltestbed.frames import Array
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario

LISTED = 64  # contacts whose start, end, impulse and peak are kept; all contacts are counted
START, END, FX, FY, FZ, PEAK, COLUMNS = 0, 1, 2, 3, 4, 5, 6
# of a joint in the composed model; the others are the rig's
OF_THE_MECHANISM = (ACTIVE, PASSIVE, "mount_")
UNITS = {mujoco.mjtJoint.mjJNT_SLIDE: "m", mujoco.mjtJoint.mjJNT_HINGE: "rad"}


class Outcomes:
    """The contacts of ``n`` runs, updated tick by tick.

    Attributes:
        events: ``(n, LISTED, 6)`` first and last tick, impulse x, y, z in P [N s] and peak force
            [N] of each contact.
        count: ``(n,)`` contacts so far. captured_tick: ``(n,)`` tick at which the latches closed,
            -1 before.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n, first = len(scenarios), scenarios[0]
        self.tick = 1.0 / first.rate
        self.events = np.zeros((n, LISTED, COLUMNS))
        self.count = np.zeros(n, dtype=np.int64)
        self.captured_tick = np.full(n, -1, dtype=np.int64)
        self.touching = np.zeros(n, dtype=bool)
        self._update = Call(
            _update,
            ...,
            self.tick,
            GIVEN,
            GIVEN,
            GIVEN,
            self.events,
            self.count,
            self.captured_tick,
            self.touching,
        )

    def taking(
        self, wrench: Array, contact: NDArray[np.bool_], captured: NDArray[np.bool_]
    ) -> Callable[[int], None]:
        """The update with tick k: a call with k, bound to arrays with fixed memory.

        Args:
            wrench: ``(n, 6)`` physical. contact, captured: ``(n,)`` whether the mechanisms touch
                and are latched.
        """
        return self._update.on(wrench, contact, captured)

    def summary(self, i: int) -> dict[str, Any]:
        """Outcome of run ``i``, with the time of capture [s] and its contacts: start and end [s],
        impulse [N s], peak force [N].
        """
        captured = int(self.captured_tick[i])
        return {
            "outcome": self._name(i),
            "captured_at": captured * self.tick if captured >= 0 else None,
            "contact_events": [
                {
                    "start": float(e[START] * self.tick),
                    "end": float((e[END] + 1) * self.tick),
                    "impulse": [float(v) for v in e[FX : FZ + 1]],
                    "peak_force": float(e[PEAK]),
                }
                for e in self.events[i, : min(int(self.count[i]), LISTED)]
            ],
        }

    def _name(self, i: int) -> str:
        if self.captured_tick[i] >= 0:
            return "captured"
        if self.count[i] == 0:
            return "miss"
        return "in_contact" if self.touching[i] else "rebound"


@njit(cache=True)
def _update(k, h, wrench, contact, captured, events, count, captured_tick, touching):
    for i in range(wrench.shape[0]):
        if captured[i] and captured_tick[i] < 0:
            captured_tick[i] = k
        if contact[i]:
            if not touching[i]:
                count[i] += 1
                if count[i] <= events.shape[1]:
                    events[i, count[i] - 1, 0] = k
            if count[i] <= events.shape[1]:
                event = events[i, count[i] - 1]
                event[1] = k
                square = 0.0
                for j in range(3):
                    event[2 + j] += h * wrench[i, j]
                    square += wrench[i, j] ** 2
                event[5] = max(event[5], math.sqrt(square))
        touching[i] = contact[i]


class MovingParts:
    """The slide and hinge joints of the mechanisms of ``n`` rigs.

    Attributes:
        joints: name and unit of each; empty if nothing moves.
    """

    def __init__(self, plant: object) -> None:
        """``plant``: a :class:`Plant`; the parts of a real mechanism are not known."""
        found = []
        if isinstance(plant, Plant):
            model = plant.model
            self._positions = plant.watch("qpos", 1)[..., 0]
            # with an upper platform the passive side moves in a model of its own
            if self._positions.shape[1] == model.nq:
                found = [
                    (model.joint(i).name, UNITS[kind], int(model.jnt_qposadr[i]))
                    for i in range(model.njnt)
                    if (kind := mujoco.mjtJoint(int(model.jnt_type[i]))) in UNITS
                    and model.joint(i).name.startswith(OF_THE_MECHANISM)
                ]
        self.joints = tuple((name, unit) for name, unit, _ in found)
        self._places = np.array([place for *_, place in found], dtype=np.int64)

    def positions(self) -> Array:
        """``(n, joints)`` now, as in the MJCF [m, rad]."""
        return self._positions[:, self._places]
