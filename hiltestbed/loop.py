"""The closed loop: read this first.

A tick, at t_k: read the physical wrench through the sensor; identify stiffness and damping; compensate and let the numerical model
move on; tell the platform where to be at t_(k+1), and let it set out; write the row; let the rig run until then. One call a block, in
the order of the signal, on arrays whose leading axis is the run in the batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hiltestbed.compensation.blocks import Drive, make_drive
from hiltestbed.compensation.input import InputDeadZone
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.motion import MotionCommand
from hiltestbed.contact.phases import Phases
from hiltestbed.frames import Array
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.metrics import Tally
from hiltestbed.monitoring import ProcessMonitor
from hiltestbed.outcome import Outcomes
from hiltestbed.platform.free_motion import FreeMotion
from hiltestbed.platform.plant import Plant
from hiltestbed.safety import Safety
from hiltestbed.scenario import Scenario
from hiltestbed.sensor.sensor import Sensor
from hiltestbed.signals import Trace

POSE_LIMIT = 10.0  # [m] a commanded position beyond it is a divergence: forty times the platform's reach


class RigSide(Protocol):
    """The rig as the loop sees it: see :class:`~hiltestbed.platform.plant.Plant`, which is one."""

    pose_act: Array
    twist_act: Array
    wrench_sub: Array
    contact: NDArray[np.bool_]
    captured: NDArray[np.bool_]
    slider_cmd: Array
    slider_act: Array
    upper_cmd: Array
    upper_act: Array
    diverged: NDArray[np.bool_]
    phases: Phases | None
    units: tuple[str, ...]
    physical: bool

    def divergence(self, i: int) -> str: ...
    def held_pair(self, i: int) -> tuple[Array, Array] | None: ...
    def payload_left(self, i: int) -> dict[str, float] | None: ...
    def reset(self, pose: Array, twist: Array) -> None: ...
    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None: ...
    def finish(self) -> None: ...


class SensorSide(Protocol):
    """The force sensor as the loop sees it: see :class:`~hiltestbed.sensor.sensor.Sensor`."""

    reading: Array

    def read(self, k: int, wrench_sub: Array) -> Array: ...
    def feel(self, k: int, wrench: Array) -> None: ...


class Watch(Protocol):
    """What stops a run: see :class:`~hiltestbed.safety.Safety`."""

    def passed(self, plant: Any, pose_before: Array, energy: Array) -> bool: ...
    def reason(self, i: int) -> str | None: ...


Side = tuple[SensorSide, RigSide, Watch]
MakeSide = Callable[[Sequence[Scenario], int], Side]


def simulated(scenarios: Sequence[Scenario], nthread: int) -> Side:
    """The physical side in simulation."""
    sensor = Sensor(scenarios, [np.random.default_rng(s.seed) for s in scenarios])
    return sensor, Plant(scenarios, nthread, late=sensor.late), Safety(scenarios)


class Loop:
    """``n`` runs in lockstep. The scenarios agree in structure (kinds, rates, methods) and differ in numbers.

    Attributes:
        k: the tick to come.
        alive: ``(n,)`` runs that go on; of one that diverged or was stopped no more rows count.
        trouble: run to (tick, status, what went wrong).
        measurement: what the compensation and the identification know at t_k.
    """

    def __init__(self, scenarios: Sequence[Scenario], nthread: int = 1, side: MakeSide = simulated) -> None:
        """``side``: makes the physical side, simulated or of real devices, for the scenarios and a number of threads."""
        n = len(scenarios)
        self.scenarios = scenarios
        self.sensor, self.plant, self.safety = side(scenarios, nthread)
        self.identification = IDENTIFIERS[scenarios[0].identification.kind].start(scenarios)
        if self.identification:
            self.identification.source.captured = self.plant.captured
            if self.plant.phases is not None:
                self.identification.source.steps = self.plant.phases.begun
        self.monitor = ProcessMonitor(scenarios) if any(s.monitoring for s in scenarios) else None
        self.dead_zone = InputDeadZone(scenarios)
        self.model = scenarios[0].numerical_model.start(scenarios)
        self.drive: Drive = FreeMotion(scenarios, self.plant) if self.plant.physical else make_drive(scenarios, self.model)
        self.motion = MotionCommand(scenarios)
        self.tally = Tally(scenarios)
        self.outcomes = Outcomes(scenarios)
        self.k = 0
        self.alive = np.ones(n, dtype=bool)
        self.trouble: dict[int, tuple[int, str, str]] = {}
        self._pose_before = self.drive.pose.copy()
        self.plant.reset(self.drive.pose, self.drive.twist)
        self.motion.start(self.drive.twist)
        self.tally.start(self.drive.twist)
        unknown = np.full((n, 6), np.nan)
        estimate = self.identification
        self.measurement = Measurement(
            wrench=self.dead_zone.wrench if self.dead_zone.active else self.sensor.reading,
            pose=self.plant.pose_act,
            twist=self.plant.twist_act,
            stiffness=estimate.stiffness if estimate else unknown,
            damping=estimate.damping if estimate else unknown,
            captured=self.plant.captured,
            **({"lever": estimate.source.held.lever} if estimate else {}),
        )

    def step(self, trace: Trace | None = None) -> None:
        """One tick for every run; the row goes into ``trace``."""
        k, plant, drive = self.k, self.plant, self.drive
        self.sensor.read(k, plant.wrench_sub)
        if self.identification:
            self.identification.update(self.sensor.reading, plant.pose_act, plant.twist_act)
        if self.monitor:
            self.monitor.update(self.sensor.reading, plant.pose_act, plant.twist_act)
        if self.dead_zone.active:
            self.dead_zone.update(self.sensor.reading)
        self._pose_before[:] = drive.pose
        drive.advance(self.measurement)
        self.motion.update(drive.pose, drive.twist, self.measurement)
        plant.begin(self.motion.pose, self.motion.twist, self.motion.acceleration)
        wrench = plant.wrench_sub[:, -1]
        self.sensor.feel(k, wrench)
        self.tally.update(k, (wrench, plant.pose_act, plant.twist_act, plant.contact), self._pose_before, (drive.wrench, drive.twist))
        self.outcomes.update(k, wrench, plant.contact, plant.captured)
        if trace is not None:
            self.write(trace)
        passed = self.safety.passed(plant, self._pose_before, self.tally.energy)
        if passed or _lost(drive.pose, POSE_LIMIT, self.alive, plant.diverged):
            self._end_runs()
        plant.finish()
        self.k = k + 1

    def write(self, trace: Trace) -> None:
        """Row k: what was read at t_k and what was commanded from it."""
        k, data = self.k, trace.data
        data["pose_cmd"][k] = self.drive.pose
        data["pose_act"][k] = self.plant.pose_act
        data["twist_cmd"][k] = self.drive.twist
        data["twist_act"][k] = self.plant.twist_act
        data["wrench_true"][k] = self.plant.wrench_sub[:, -1]
        data["wrench_meas"][k] = self.sensor.reading
        data["wrench_comp"][k] = self.drive.wrench
        data["slider_cmd"][k] = self.plant.slider_cmd
        data["slider_act"][k] = self.plant.slider_act
        data["upper_cmd"][k] = self.plant.upper_cmd
        data["upper_act"][k] = self.plant.upper_act
        data["stiffness_est"][k] = self.measurement.stiffness
        data["damping_est"][k] = self.measurement.damping
        trace.contact[k] = self.plant.contact

    @property
    def blocks(self) -> dict[str, Any]:
        """The blocks whose arrays are the state of the loop between two ticks."""
        names = ("sensor", "plant", "identification", "monitor", "dead_zone", "drive", "motion", "tally", "outcomes", "safety")
        return {name: getattr(self, name) for name in names}

    def _end_runs(self) -> None:
        """End the runs that diverged or passed a safety limit at this tick."""
        for i in map(int, np.flatnonzero(self.alive)):
            reason = self.safety.reason(i)
            if self.plant.diverged[i]:
                self.trouble[i] = (self.k, "diverged", self.plant.divergence(i))
            elif not np.all(np.abs(self.drive.pose[i]) <= POSE_LIMIT):
                where = ", ".join(f"{v:.3g}" for v in self.drive.pose[i, :3])
                self.trouble[i] = (self.k, "diverged", f"relative position px, py, pz = {where} m (limit {POSE_LIMIT:g} m)")
            elif reason is not None:
                self.trouble[i] = (self.k, "stopped", reason)
            else:
                continue
            self.alive[i] = False


@njit(cache=True)
def _lost(pose, limit, alive, diverged):
    """Whether a run that was alive has left ``limit`` or the numbers, in the model or in the rig."""
    for i in range(pose.shape[0]):
        if alive[i]:
            if diverged[i]:
                return True
            for j in range(7):
                if not abs(pose[i, j]) <= limit:
                    return True
    return False
