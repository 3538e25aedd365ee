"""Outcome of a docking: captured, rebounded, missed, or still in contact; all its contacts; how it
touched first and what loads the interface carried; and the joints of the mechanism's moving parts
(stroke, ring, jaws) and of its mount, for the trace.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from hiltestbed.analysis.limits import LOADS, conditions
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.composition import ACTIVE, PASSIVE
from hiltestbed.contact.phases import Phases
from hiltestbed.contact.settings import Mechanism
from hiltestbed.frames import Array

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
        first: ``(n, 13)`` pose and twist with which the numerical model meets the first contact.
            begun: ``(n,)`` phases of capture begun. loads: ``(n, 2, 5)`` largest loads until hard
            capture, and from then on, see :data:`hiltestbed.analysis.limits.LOADS`.
    """

    def __init__(self, tick: float, mechanisms: Sequence[Mechanism]) -> None:
        n, self.tick = len(mechanisms), tick
        self.events = np.zeros((n, LISTED, COLUMNS))
        self.count = np.zeros(n, dtype=np.int64)
        self.captured_tick = np.full(n, -1, dtype=np.int64)
        self.touching = np.zeros(n, dtype=bool)
        self.first = np.full((n, 13), np.nan)
        self.loads, self.begun = np.zeros((n, 2, len(LOADS))), np.zeros(n, dtype=np.int64)
        self._hard = np.array([hard_from(m) for m in mechanisms], dtype=np.int64)

    def given(self, phases: Phases | None) -> tuple[Any, ...]:
        """The last arguments of :func:`take_contacts`; ``phases`` of capture, if there are any."""
        if phases is not None:
            self.begun = phases.begun
        contacts = self.tick, self.events, self.count, self.captured_tick, self.touching
        return self.begun, contacts, (self.first, self._hard, self.loads)

    def summary(self, i: int) -> dict[str, Any]:
        """Outcome of run ``i``, with the time of capture [s], how it touched first, the largest
        loads, and its contacts: start and end [s], impulse [N s], peak force [N].
        """
        captured, hard = int(self.captured_tick[i]), int(self._hard[i])
        soft, stiff = (dict(zip(LOADS, map(float, row), strict=True)) for row in self.loads[i])
        touched = hard > 0 and self.count[i] > 0
        return {
            "outcome": self._name(i),
            "interface": {
                "approach": conditions(self.first[i]) if touched else None,
                "soft_capture": soft if touched else None,
                "hard_capture": stiff if self.begun[i] >= hard else None,
            },
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


def hard_from(mechanism: Mechanism) -> int:
    """Phases of capture that have begun when the structural latches close: up to the last that
    closes a latch; 0 if captured from the start, 1 without phases, which never begins.
    """
    if mechanism.captured:
        return 0
    closing = [k for k, phase in enumerate(mechanism.phases()) if phase.close is not None]
    return max(closing, default=len(mechanism.phases())) + 1


@njit(cache=True)
def take_contacts(k, wrench, pose, twist, contact, captured, begun, contacts, interface):
    h, events, count, captured_tick, touching = contacts
    first, hard, loads = interface
    for i in range(wrench.shape[0]):
        if captured[i] and captured_tick[i] < 0:
            captured_tick[i] = k
        most = loads[i, 1 if begun[i] >= hard[i] else 0]
        most[0] = max(most[0], wrench[i, 2])
        most[1] = max(most[1], -wrench[i, 2])
        most[2] = max(most[2], math.sqrt(wrench[i, 0] ** 2 + wrench[i, 1] ** 2))
        most[3] = max(most[3], math.sqrt(wrench[i, 3] ** 2 + wrench[i, 4] ** 2))
        most[4] = max(most[4], abs(wrench[i, 5]))
        if count[i] == 0 and (k == 0 or not contact[i]):
            for j in range(7):
                first[i, j] = pose[i, j]
            for j in range(6):
                first[i, 7 + j] = twist[i, j]
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
        from hiltestbed.platform.plant import Plant  # a check needs none

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
