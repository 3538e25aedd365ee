"""The nominal rig on a recorded command, under a recorded force: the poses to which its drives take
the platform.

A platform with a servo yields to the force on it and follows its command with the servo's small
errors; a motion compensation commands another pose than the numerical model's; an upper platform
carries the passive side. All of this is part of the
nominal rig: it is simulated with the blocks of the loop, with the contact wrench taken from the
record.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.build import identification, motion_command
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.platform.build import plant_of
from hiltestbed.replay.felt import slopes

if TYPE_CHECKING:
    from hiltestbed.compensation.settings import Compensation
    from hiltestbed.platform.settings import Rig
    from hiltestbed.scenario import Scenario

# [m] distance from its command at which a platform counts as lost: at 50 kN, the sensor's overload,
# the drives yield 1.2 mm
LOST = 0.05


class RecordedForce:
    """A recorded wrench (N, 6), one row per tick, instead of a contact: active on passive, in P at
    P's origin; held after its end.

    ``between``: (N, m, 6) that is added at the instants of the tick that ends at each row.
    """

    def __init__(self, wrench: Array, substeps: int, between: Array | None = None) -> None:
        self._record, self._substeps, self._instant = wrench, substeps, 0
        self._between = None if between is None else between.reshape(-1, 6)[substeps - 1 :]

    def next(self) -> Array:
        """(6,) the wrench of the next physics instant, interpolated linearly between rows."""
        row = min(self._instant / self._substeps, len(self._record) - 1.0)
        low = math.floor(row)
        high = min(low + 1, len(self._record) - 1)
        more = (
            0.0
            if self._between is None
            else self._between[min(self._instant, len(self._between) - 1)]
        )
        self._instant += 1
        return self._record[low] + (row - low) * (self._record[high] - self._record[low]) + more


def follows_exactly(rig: Rig, compensation: Compensation) -> bool:
    """Whether a nominal ``rig`` reaches the numerical model's pose exactly, one tick later."""
    fixed = rig.upper.kind == "fixed"
    return rig.platform.tracking == "ideal" and fixed and compensation.motion.tells_model_pose


def moves_linearly(rig: Rig) -> bool:
    """Whether A moves uniformly within a tick relative to P, so that the contact's rate at t_k is
    the mean over the tick that ends.
    """
    return rig.platform.prescribed and rig.upper.kind == "fixed"


def can_carry(rig: Rig) -> bool:
    """Whether the motion of A relative to P within a tick follows from recorded poses and rates: it
    is uniform, or stepped by a servo.
    """
    return rig.platform.tracking != "response" and rig.upper.kind == "fixed"


def replay_rig(
    scenario: Scenario,
    command: Array,
    rates: Array | None,
    wrench: Array,
    reading: Array,
    reached: Array | None = None,
    between: Array | None = None,
) -> Array | None:
    """``(N, 7)`` poses of A in P at t_k that the nominal rig reaches; None if it diverges or falls
    behind by more than LOST.

    Args:
        command: ``(N, 7)`` pose_cmd; row k is to be reached at t_(k+1). rates: ``(N, 6)``
            twist_cmd, or None.
        wrench: ``(N, 6)`` contact wrench at t_k, plus
            :attr:`hiltestbed.replay.simulated.Engaged.taken`, since parts do not move
            on A here. reading: ``(N, 6)`` the sensor's reading at t_k, for the identification.
        between: ``(N, m, 6)`` difference of the wrench from linear interpolation between rows, see
            :class:`RecordedForce`.
        reached: ``(N, 7)`` pose reached at t_k, as input of a motion compensation; None: the pose
            reached in this replay.
    """
    start = approach_state(scenario.approach)
    plant = plant_of([scenario], force=RecordedForce(wrench, scenario.substeps, between), held=True)
    plant.reset(start[None, :7], start[None, 7:])
    motion = motion_command([scenario])
    motion.start(start[None, 7:])
    estimate = (
        identification([scenario]) if "identified" in scenario.compensation.motion.reads else None
    )
    unknown = np.full((1, 6), np.nan)
    measured_pose = plant.pose_act if reached is None else np.empty((1, 7))
    measurement = Measurement(
        np.zeros((1, 6)),
        measured_pose,
        plant.twist_act,
        estimate.stiffness if estimate else unknown,
        estimate.damping if estimate else unknown,
        plant.captured,
    )
    twists = slopes(command[None], start[None, :7], scenario.tick)[0] if rates is None else rates
    # the same for all ticks: the kernels are bound to them
    pose, twist = np.empty((1, 7)), np.empty((1, 6))
    out = np.empty_like(command)
    for k in range(len(command)):
        out[k] = plant.pose_act[0]
        measurement.wrench[0] = reading[k]
        if estimate is not None:
            estimate.update(measurement.wrench, measurement.pose, measurement.twist)
        if reached is not None:
            measured_pose[0] = reached[k]
        pose[0], twist[0] = command[k], twists[k]
        motion.update(pose, twist, measurement)
        plant.advance(motion.pose, motion.twist, motion.acceleration)
        if plant.diverged[0] or np.abs(plant.pose_act[0, :3] - command[k, :3]).max() > LOST:
            return None
    return out
