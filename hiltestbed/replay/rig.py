"""The believed rig on a recorded command, under a recorded force: where its drives take the platform.

A platform under its servo yields to the force that it bears and follows its command with the servo's own small errors; a motion
compensation tells it another pose than the numerical model's; an upper platform carries the passive side. All of this is believed: it is
run with the blocks of the loop, the contact's wrench taken from the record.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.motion import MotionCommand
from hiltestbed.frames import Array
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.platform.driven import least_creep
from hiltestbed.platform.plant import Plant
from hiltestbed.replay.compensation import slopes

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

LOST = 0.05  # [m] from its command: under the 50 kN at which the sensor overloads the drives yield 1.2 mm


class RecordedForce:
    """A wrench (N, 6) on record, a row a tick, in place of a contact: active on passive, in P at P's origin; past its end it holds.

    ``between``: (N, m, 6) that is added at the instants of the tick that ends at each row.
    """

    def __init__(self, wrench: Array, substeps: int, between: Array | None = None) -> None:
        self._record, self._substeps, self._instant = wrench, substeps, 0
        self._between = None if between is None else between.reshape(-1, 6)[substeps - 1 :]

    def next(self) -> Array:
        """(6,) the wrench of the next instant of the physics, between rows on a straight line."""
        row = min(self._instant / self._substeps, len(self._record) - 1.0)
        low = math.floor(row)
        high = min(low + 1, len(self._record) - 1)
        more = 0.0 if self._between is None else self._between[min(self._instant, len(self._between) - 1)]
        self._instant += 1
        return self._record[low] + (row - low) * (self._record[high] - self._record[low]) + more


def follows_exactly(scenario: Scenario) -> bool:
    """Whether the believed rig reaches the numerical model's pose exactly, a tick later."""
    rig = scenario.rig
    return rig.platform.tracking == "ideal" and rig.upper.kind == "fixed" and scenario.compensation.motion.tells_model_pose


def moves_linearly(scenario: Scenario) -> bool:
    """Whether A moves uniformly within a tick relative to P, so that the rate of the contact at t_k is the slope of the tick that ends."""
    return scenario.rig.platform.prescribed and scenario.rig.upper.kind == "fixed"


def can_carry(scenario: Scenario) -> bool:
    """Whether the rows of a record, with rates, tell how A moves within a tick relative to P: there it moves uniformly, or is stepped."""
    return scenario.rig.platform.tracking != "response" and scenario.rig.upper.kind == "fixed"


def creep_of(scenario: Scenario) -> float:
    """[m/s per N] by which friction is viscous at least in the rig of a scenario, see :class:`hiltestbed.contact.contacts.Contacts`."""
    return 0.0 if scenario.rig.platform.prescribed else least_creep(1.0 / scenario.physics_rate)


def replay_rig(
    scenario: Scenario,
    command: Array,
    rates: Array | None,
    wrench: Array,
    reading: Array,
    reached: Array | None = None,
    between: Array | None = None,
) -> Array | None:
    """``(N, 7)`` poses of A in P at t_k that the believed rig reaches; None where it diverges or is left behind.

    Args:
        command: ``(N, 7)`` pose_cmd; row k is to be reached at t_(k+1). rates: ``(N, 6)`` twist_cmd, or None.
        wrench: ``(N, 6)`` that the contact exerts at t_k, with what :attr:`hiltestbed.replay.played.Engaged.taken` adds to it: here
            nothing moves on A. reading: ``(N, 6)`` what the sensor gave at t_k, for the identification.
        between: ``(N, m, 6)`` what the wrench is more than straight lines between rows, see :class:`RecordedForce`.
        reached: ``(N, 7)`` pose that a motion compensation was told at t_k that the platform has reached; None: what it reaches here.
    """
    start = approach_state(scenario)
    plant = Plant([scenario], force=RecordedForce(wrench, scenario.substeps, between), held=True)
    plant.reset(start[None, :7], start[None, 7:])
    motion = MotionCommand([scenario])
    motion.start(start[None, 7:])
    estimate = IDENTIFIERS[scenario.identification.kind].start([scenario]) if "identified" in scenario.compensation.motion.reads else None
    unknown = np.full((1, 6), np.nan)
    told_pose = plant.pose_act if reached is None else np.empty((1, 7))
    measurement = Measurement(
        np.zeros((1, 6)), told_pose, plant.twist_act, estimate.stiffness if estimate else unknown,
        estimate.damping if estimate else unknown, plant.captured,
    )  # fmt: skip
    told = slopes(command[None], start[None, :7], scenario.tick)[0] if rates is None else rates
    out = np.empty_like(command)
    for k in range(len(command)):
        out[k] = plant.pose_act[0]
        measurement.wrench[0] = reading[k]
        if estimate is not None:
            estimate.update(measurement.wrench, measurement.pose, measurement.twist)
        if reached is not None:
            told_pose[0] = reached[k]
        motion.update(command[k : k + 1], told[k : k + 1], measurement)
        plant.advance(motion.pose, motion.twist, motion.acceleration)
        if plant.diverged[0] or np.abs(plant.pose_act[0, :3] - command[k, :3]).max() > LOST:
            return None
    return out
