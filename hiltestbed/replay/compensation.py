"""The compensation on recorded readings, poses and twists, with the same blocks as the loop, one
call per tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed import build
from hiltestbed.compensation.input import InputDeadZone, InputParameters
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.parameters import latch_limits
from hiltestbed.contact.phases import closes
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_state, approach_states
from hiltestbed.numerical_model.kernels import place_at_start
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay.felt import slopes

if TYPE_CHECKING:
    from hiltestbed.compensation.settings import Compensation
    from hiltestbed.contact.settings import Mechanism
    from hiltestbed.scenario import Scenario
    from hiltestbed.scenario.spacecraft import Approach

INPUTS = {
    "wrench": "wrench_meas",
    "pose": "pose_act",
    "twist": "pose_act",
    "identified": "pose_act",
    "captured": "pose_act",
    "model": "pose_cmd",
}


def needs(compensation: Compensation, mechanism: Mechanism) -> set[str]:
    """The column groups of a record that a compensation needs as inputs."""
    return {INPUTS[name] for name in _inputs(compensation, mechanism)} | {"wrench_meas"}


def reads_rates(compensation: Compensation, mechanism: Mechanism) -> bool:
    """Whether a compensation depends on the twist of A."""
    return bool(_inputs(compensation, mechanism) & {"twist", "identified", "captured"})


def _inputs(compensation: Compensation, mechanism: Mechanism) -> set[str]:
    """What a compensation reads at t_k."""
    reads = _reads(compensation)
    if compensation.motion.corrects_force:
        reads.add("model")
    if mechanism.captured or not mechanism.latches:
        reads.discard("captured")
    return reads


def _reads(compensation: Compensation) -> set[str]:
    """What the methods of a compensation state that they read, for the force."""
    motion = compensation.motion
    return {*compensation.force.reads, *(motion.reads if motion.corrects_force else ())}


class RecordedModel(NumericalModel):
    """A numerical model that follows the record: a step takes it to the next recorded pose,
    whatever wrench drives it.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], poses: Array, twists: Array, run: np.ndarray
    ) -> None:
        """``poses`` (R, N, 7) and ``twists`` (R, N, 6) as commanded at t_k."""
        self._poses, self._twists, self._run, self._row = poses, twists, run, 0
        super().__init__(scenarios, stack([DynamicsParameters() for _ in scenarios]))

    def advance(self, wrench: Array) -> None:
        """Advance to the pose that was commanded at this tick, with the target at rest and P at the
        inertial origin.
        """
        self.pose[:] = self._poses[self._run, self._row]
        self.twist[:] = self._twists[self._run, self._row]
        self._row += 1
        place_at_start(np.concatenate([self.pose, self.twist], axis=1), self.port, self.q, self.v)


def replay_compensation(
    scenarios: Sequence[Scenario],
    inputs: Sequence[InputParameters],
    records: dict[str, Array],
    readings: Array,
    run: np.ndarray,
) -> Array:
    """``(L, N, 6)`` wrench_comp of compensations on recorded readings.

    Args:
        scenarios, inputs: of each lane. readings: ``(R, N, 6)`` wrench_meas, or the readings
            assumed for the loop.
        records: "pose_act" (R, N, 7), "pose_cmd" (R, N, 7) if the method needs them; "twist_act",
            "twist_cmd" (R, N, 6) if recorded.
    """
    rows, n = readings.shape[1], len(run)
    start = approach_states(s.approach for s in scenarios)
    pose, twist = _reached(start, scenarios[0].tick, records, run, rows)
    model = _model(scenarios, start, records, run)
    drive = build.drive(scenarios, model)
    dead_zone = InputDeadZone(inputs)
    estimate = (
        build.identification(scenarios)
        if "identified" in _reads(scenarios[0].compensation)
        else None
    )
    unknown = np.full((n, 6), np.nan)
    captured = np.array([s.mechanism.captured for s in scenarios])
    if estimate is not None:
        estimate.source.captured = captured
    limits = latch_limits(s.mechanism.latch for s in scenarios)
    reading, wrench = np.zeros((n, 6)), np.zeros((n, 6))
    measurement = Measurement(
        wrench,
        np.zeros((n, 7)),
        np.zeros((n, 6)),
        estimate.stiffness if estimate else unknown,
        estimate.damping if estimate else unknown,
        captured,
        *([estimate.source.held.lever] if estimate else []),
    )
    out = np.empty((n, rows, 6))
    for k in range(rows):
        reading[:] = readings[run, k]  # one buffer for all ticks: the kernels are bound to it
        measurement.pose[:], measurement.twist[:] = pose[run, k], twist[run, k]
        _capture(measurement.pose, measurement.twist, limits, captured)
        if estimate is not None:
            estimate.update(reading, measurement.pose, measurement.twist)
        wrench[:] = dead_zone.update(reading) if dead_zone.active else reading
        drive.advance(measurement)
        out[:, k] = drive.wrench
        if dead_zone.active:
            dead_zone.after(out[:, k])
    return out


def _model(
    scenarios: Sequence[Scenario], start: Array, records: dict[str, Array], run: np.ndarray
) -> NumericalModel:
    """The recorded numerical model; without a recorded pose_cmd, one that stays at its start."""
    poses = records.get("pose_cmd")
    if poses is None:
        return _Idle(scenarios)
    twists = records.get("twist_cmd")
    if twists is None:
        starts = np.zeros((len(poses), 7))
        starts[run] = start[:, :7]
        twists = slopes(poses, starts, scenarios[0].tick)
    return RecordedModel(scenarios, poses, twists, run)


class _Idle(NumericalModel):
    """A numerical model that does not move, for methods that do not read it."""

    def advance(self, wrench: Array) -> None:
        """Nothing moves."""


def _reached(
    start: Array, tick: float, records: dict[str, Array], run: np.ndarray, rows: int
) -> tuple[Array, Array]:
    """``(R, N, 7)`` poses and ``(R, N, 6)`` twists that the rig reached; without recorded twists,
    the mean twist over each tick.
    """
    poses = records.get("pose_act")
    runs = int(run.max()) + 1
    if poses is None:
        still = np.zeros((runs, rows, 7))
        still[..., 6] = 1.0
        return still, np.zeros((runs, rows, 6))
    twists = records.get("twist_act")
    if twists is None:
        twists = slopes(poses, poses[:, 0].copy(), tick)
        starts = np.zeros((runs, 6))
        starts[run] = start[:, 7:]
        twists[:, 0] = starts
    return poses, twists


def central_rates(approach: Approach, tick: float, path: Array) -> Array:
    """``(N, 6)`` twists at the rows of a path (N, 7), one a ``tick`` [s], each the mean of the
    twists over the ticks before and after.
    """
    before = slopes(path[None], path[None, 0], tick)[0]
    before[0] = approach_state(approach)[7:]
    return np.asarray(0.5 * (before + np.concatenate([before[1:], before[-1:]])))


@njit(cache=True)
def _capture(pose, twist, limits, captured):
    """Mark as captured the runs whose latch condition holds; capture is permanent."""
    for i in range(pose.shape[0]):
        if not captured[i] and closes(pose[i], twist[i], limits[i]):
            captured[i] = True
