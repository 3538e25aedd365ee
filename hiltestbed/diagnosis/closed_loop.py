"""The runs simulated in closed loop, nominal and extended, and the figures that are compared with
the measured ones.

Measured and simulated runs go through the same rule: speeds are slopes of the commanded pose before
and after the first contact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.analysis.metrics import settle_ticks
from hiltestbed.build import runnable_from
from hiltestbed.campaign.cases import lockstep_groups
from hiltestbed.diagnosis.result import Cause, ClosedLoop, Figures, Learned, SimulatedRun
from hiltestbed.errors import HiltestbedError
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset, MeasuredRun
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.signals import RunTrace
from hiltestbed.simulation import simulate

SPEED_WINDOW = 0.1  # chosen: [s] over which a speed is estimated, at most
MIN_SAMPLES = 8  # of a speed
# chosen: [s] from the end of a contact to the speed, longer than the tail of an unknown delay or
# lag
QUIET_TIME = 0.03
LOCKSTEP_RUNS = 64  # simulated together


@dataclass(frozen=True)
class RunSignals:
    """The signals of a run that the figures need: (N,) each, NaN where not measured; None for a
    channel that is absent.

    span: first tick of the first contact, its end, and the end of the stretch after it (the next
        contact or the last row).
    """

    t: Array
    command: Array | None
    reached: Array | None
    force: Array | None
    span: tuple[int, int, int] | None


@dataclass(frozen=True)
class FirstRebound:
    """A contact: before, after: the rows [first, end) from which the speeds are estimated.
    approach_speed, rebound_speed [m/s]: both positive; None where one cannot be estimated.
    """

    before: tuple[int, int]
    after: tuple[int, int]
    approach_speed: float | None
    rebound_speed: float | None


def simulate_runs(
    dataset: MeasuredDataset, causes: Sequence[Cause | Learned]
) -> tuple[SimulatedRun, ...]:
    """Simulate every run's scenario as believed, and with the causes."""
    nominal = [r.scenario for r in dataset.runs]
    entries = [c.entry() for c in causes]
    extended = [with_entries(s, entries) for s in nominal] if causes else []
    traces = traces_of(nominal)
    after = traces_of(extended) if causes else traces
    return tuple(
        SimulatedRun(r.record.run, a, b)
        for r, a, b in zip(dataset.runs, traces, after, strict=True)
    )


def with_entries(
    scenario: Scenario, entries: Sequence[Mapping[str, Any]], rows: int | None = None
) -> Scenario:
    """A run's scenario with more effects, for so many rows at most."""
    data = resolved(scenario)
    data["effects"] = [*data["effects"], *entries]
    if rows is not None:
        data["duration"] = min(data["duration"], rows * scenario.tick)
    return runnable_from(data)


def traces_of(scenarios: Sequence[Scenario]) -> list[RunTrace | None]:
    """The traces, runs of one structure in lockstep; None for a run that the simulation refuses."""
    out: list[RunTrace | None] = [None] * len(scenarios)
    for group in lockstep_groups(list(enumerate(scenarios)), LOCKSTEP_RUNS):
        try:
            batch = simulate([scenario for _, scenario in group], trace=True)
        except HiltestbedError:
            continue
        if batch.trace is not None:
            for n, (i, _) in enumerate(group):
                out[i] = batch.trace.run(n)
    return out


def closed_loop(dataset: MeasuredDataset, simulated: Sequence[SimulatedRun]) -> ClosedLoop:
    rows = []
    for run, p in zip(dataset.runs, simulated, strict=True):
        motions = measured_motion(run), trace_motion(p.nominal), trace_motion(p.extended)
        rows.append([figures(motion, run.scenario) for motion in motions])
    sources = zip(*rows, strict=True) if rows else ((), (), ())
    return ClosedLoop(tuple(p.run for p in simulated), *map(tuple, sources))


def measured_motion(run: MeasuredRun) -> RunSignals:
    record, spans = run.record, [(c.start, c.end) for c in run.survey.contacts]
    command, reached, force = (
        record.column(n) if record.has(n) else None
        for n in ("pose_cmd.pz", "pose_act.pz", "wrench_meas.fz")
    )
    return RunSignals(record.t, command, reached, force, _first(spans, record.ticks))


def trace_motion(trace: RunTrace | None) -> RunSignals | None:
    if trace is None:
        return None
    edges = np.flatnonzero(np.diff(np.r_[False, trace.contact, False])).reshape(-1, 2)
    command, reached, force = (
        np.ascontiguousarray(trace[g][:, 2]) for g in ("pose_cmd", "pose_act", "wrench_meas")
    )
    spans = [(int(a), int(b)) for a, b in edges]
    return RunSignals(trace.t, command, reached, force, _first(spans, len(trace.t)))


def _first(spans: Sequence[tuple[int, int]], ticks: int) -> tuple[int, int, int] | None:
    if not spans:
        return None
    return (*spans[0], spans[1][0] if len(spans) > 1 else ticks)


def figures(motion: RunSignals | None, scenario: Scenario) -> Figures:
    """Figures of a run; all None for a run without contact."""
    if motion is None or motion.span is None:
        return Figures()
    peak = None
    if motion.force is not None:
        start, end, _ = motion.span
        settle = settle_ticks(scenario.sensor, scenario.compensation.force, scenario.rate)
        reading = np.abs(motion.force[start : end + settle])
        peak = float(np.nanmax(reading)) if np.isfinite(reading).any() else None
    cor = restitution(motion, scenario) if not scenario.mechanism.captured else None
    return Figures(cor, peak)


def restitution(motion: RunSignals, scenario: Scenario) -> float | None:
    """Rebound speed over approach speed of the first contact; None where either cannot be
    estimated.

    From the commanded pose, as the numerical model's; from the reached pose where the command was
    not recorded.
    """
    rows = bounce_of(motion, scenario)
    if rows is None or rows.rebound_speed is None or rows.approach_speed is None:
        return None
    return rows.rebound_speed / rows.approach_speed


def bounce_of(motion: RunSignals, scenario: Scenario) -> FirstRebound | None:
    """The first contact of a motion with the speeds before and after it; None without one."""
    z = motion.command if motion.command is not None else motion.reached
    if z is None or motion.span is None:
        return None
    start, end, until = motion.span
    window = round(SPEED_WINDOW * scenario.rate)
    settle = settle_ticks(scenario.sensor, scenario.compensation.force, scenario.rate)
    first = min(end + settle + round(QUIET_TIME * scenario.rate), max(end + settle, until - window))
    before = (max(0, start - 1 - window), start - 1)
    after = (first, min(until, len(z), first + window))
    approach, rebound = _slope(motion.t, z, *before), _slope(motion.t, z, *after)
    return FirstRebound(
        before,
        after,
        None if approach is None or approach <= 0.0 else approach,
        None if rebound is None or rebound >= 0.0 else -rebound,
    )


def _slope(t: Array, z: Array, start: int, end: int) -> float | None:
    """[m/s] least squares over the rows that hold data."""
    rows = np.arange(start, max(start, end))
    rows = rows[np.isfinite(z[rows])]
    if len(rows) < MIN_SAMPLES:
        return None
    return float(np.polyfit(t[rows] - t[rows[0]], z[rows], 1)[0])
