"""The closed loop: read this first.

A tick, at t_k: read the physical wrench through the sensor; identify stiffness and damping;
compensate the wrench and advance the numerical model; command the platform to the pose for t_(k+1)
and start its motion; write the row; simulate the rig until then. One call per block, in the order
of the signal flow, on arrays whose leading axis is the run in the batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hiltestbed import build
from hiltestbed.analysis.metrics import take_figures
from hiltestbed.analysis.outcome import take_contacts
from hiltestbed.compensation.interfaces import Drive
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compiled.bound import bound
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.phases import Phases
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.platform.build import plant_of
from hiltestbed.platform.plant import FreeMotion
from hiltestbed.scenario import Scenario
from hiltestbed.signals import Trace

# [m] a larger commanded position counts as divergence: forty times the platform's reach
POSE_LIMIT = 10.0


class RigSide(Protocol):
    """The rig as seen by the loop; implemented by :class:`~hiltestbed.platform.plant.Plant`."""

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
    """The force sensor, :class:`~hiltestbed.sensor.sensor.Sensors`, as seen by the loop."""

    reading: Array

    def read(self, k: int, wrench_sub: Array) -> Array: ...
    def feel(self, k: int, wrench: Array) -> None: ...


class Supervisor(Protocol):
    """The monitor that stops a run; :class:`~hiltestbed.supervision.safety.Safety` is one."""

    def passed(self, plant: Any, pose_before: Array, energy: Array) -> bool: ...
    def reason(self, i: int) -> str | None: ...


Side = tuple[SensorSide, RigSide, Supervisor]
MakeSide = Callable[[Sequence[Scenario], int], Side]


def simulated(scenarios: Sequence[Scenario], nthread: int) -> Side:
    """The simulated physical side."""
    sensor = build.sensors(scenarios)
    return sensor, plant_of(scenarios, nthread, late=sensor.late), build.safety(scenarios)


class Loop:
    """``n`` runs in lockstep. The scenarios agree in structure (kinds, rates, methods) and differ
    in numbers.

    Attributes:
        k: the next tick.
        alive: ``(n,)`` runs that continue; once a run has diverged or was stopped, its further rows
            do not count.
        trouble: run to (tick, status, reason).
        measurement: the signals that are known to the compensation and the identification at t_k.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], nthread: int = 1, side: MakeSide = simulated
    ) -> None:
        """``side``: makes the physical side for scenarios and threads, simulated or of real
        devices.
        """
        n = len(scenarios)
        self.scenarios = scenarios
        self.sensor, self.plant, self.safety = side(scenarios, nthread)
        self.identification = build.identification(scenarios)
        if self.identification:
            self.identification.source.captured = self.plant.captured
            if self.plant.phases is not None:
                self.identification.source.steps = self.plant.phases.begun
        self.monitor = build.monitor(scenarios) if any(s.monitoring for s in scenarios) else None
        self.dead_zone = build.dead_zone(scenarios)
        self.model = scenarios[0].numerical_model.start(scenarios)
        rig, start = self.plant, approach_states(s.approach for s in scenarios)
        self.drive: Drive = (
            FreeMotion(start, rig.pose_act, rig.twist_act, rig.wrench_sub)
            if rig.physical
            else build.drive(scenarios, self.model)
        )
        self.motion = build.motion_command(scenarios)
        self.tally = build.tally(scenarios)
        self.outcomes = build.outcomes(scenarios)
        self.k = 0
        self.alive = np.ones(n, dtype=bool)
        self.trouble: dict[int, tuple[int, str, str]] = {}
        self._pose_before = self.drive.pose.copy()
        self._wrench = self.plant.wrench_sub[:, -1]
        # the trace and the drive's arrays to which _keep is bound
        self._keeping: tuple[Any, ...] = (None,) * 4
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
        if not plant.physical:  # bodies that move freely have no command
            self.motion.update(drive.pose, drive.twist, self.measurement)
        plant.begin(self.motion.pose, self.motion.twist, self.motion.acceleration)
        self.sensor.feel(k, self._wrench)
        lost = self._kept(trace)(k)
        passed = self.safety.passed(plant, self._pose_before, self.tally.energy)
        if passed or lost or self.model.ended:
            self._end_runs()
        plant.finish()
        self.k = k + 1

    def _kept(self, trace: Trace | None) -> Callable[[int], bool]:
        """The call that updates figures, contacts and row; returns whether a run is lost."""
        drive, (traced, pose, twist, wrench) = self.drive, self._keeping
        if (
            trace is not traced
            or drive.pose is not pose
            or drive.twist is not twist
            or drive.wrench is not wrench
        ):
            row = None if trace is None else self.row_of(trace)
            lost = drive.pose, POSE_LIMIT, self.alive, self.plant.diverged
            self._keep = bound(_keep, ..., self.figures_of(), self.contacts_of(), row, lost)
            self._keeping = trace, drive.pose, drive.twist, drive.wrench
        return self._keep

    def figures_of(self) -> tuple[Any, ...]:
        """What :func:`take_figures` is given."""
        plant, drive = self.plant, self.drive
        rig = (self._wrench, plant.pose_act, plant.twist_act, plant.contact)
        return (*rig, self._pose_before, drive.wrench, drive.twist, self.tally.sums)

    def contacts_of(self) -> tuple[Any, ...]:
        """What :func:`take_contacts` is given."""
        plant, drive = self.plant, self.drive
        state = plant.contact, plant.captured
        return (self._wrench, drive.pose, drive.twist, *state, *self.outcomes.given(plant.phases))

    def row_of(self, trace: Trace) -> tuple[Any, ...]:
        """What :func:`write_row` is given: the readings at t_k and the commands from them."""
        drive, plant, known = self.drive, self.plant, self.measurement
        now = {
            "pose_cmd": drive.pose,
            "pose_act": plant.pose_act,
            "twist_cmd": drive.twist,
            "twist_act": plant.twist_act,
            "wrench_true": self._wrench,
            "wrench_meas": self.sensor.reading,
            "wrench_comp": drive.wrench,
            "slider_cmd": plant.slider_cmd,
            "slider_act": plant.slider_act,
            "upper_cmd": plant.upper_cmd,
            "upper_act": plant.upper_act,
            "stiffness_est": known.stiffness,
            "damping_est": known.damping,
        }
        rows = [trace.data[name] for name in now]
        return list(now.values()), rows, plant.contact, trace.contact

    @property
    def blocks(self) -> dict[str, Any]:
        """The blocks whose arrays form the state of the loop between two ticks."""
        names = "sensor plant identification monitor dead_zone drive motion tally outcomes safety"
        return {name: getattr(self, name) for name in names.split()}

    def _end_runs(self) -> None:
        """End the runs that diverged or passed a safety limit at this tick."""
        for i in map(int, np.flatnonzero(self.alive)):
            reason = self.safety.reason(i) or self.model.ended.get(i)
            if self.plant.diverged[i]:
                self.trouble[i] = (self.k, "diverged", self.plant.divergence(i))
            elif not np.all(np.abs(self.drive.pose[i]) <= POSE_LIMIT):
                where = ", ".join(f"{v:.3g}" for v in self.drive.pose[i, :3])
                self.trouble[i] = (
                    self.k,
                    "diverged",
                    f"relative position px, py, pz = {where} m (limit {POSE_LIMIT:g} m)",
                )
            elif reason is not None:
                self.trouble[i] = (self.k, "stopped", reason)
            else:
                continue
            self.alive[i] = False


@njit(cache=True)
def _keep(k, figures, contacts, row, lost):
    """Figures, contacts and ``row`` (None without a trace) of tick ``k``; whether a run is lost."""
    take_figures(k, *figures)
    take_contacts(k, *contacts)
    if row is not None:
        write_row(k, *row)
    # a live run is lost beyond the limit or the finite numbers, in the model or the rig
    pose, limit, alive, diverged = lost
    for i in range(pose.shape[0]):
        if alive[i]:
            if diverged[i]:
                return True
            for j in range(7):
                if not abs(pose[i, j]) <= limit:
                    return True
    return False


@njit(cache=True)
def write_row(k, now, rows, contact, contacts):
    """Copy each of ``now`` (n, parts) to row ``k`` of its ``rows``, modulo their number, and the
    flags ``contact`` (n,): in loops, since the general assignment of slices takes seconds to
    compile.
    """
    k = k % contacts.shape[0]
    for i in range(contact.shape[0]):
        contacts[k, i] = contact[i]
        for m in range(len(now)):
            for j in range(now[m].shape[1]):
                rows[m][k, i, j] = now[m][i, j]
