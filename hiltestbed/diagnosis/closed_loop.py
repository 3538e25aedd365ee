"""The runs simulated in closed loop, nominal and extended, and the figures that are compared with
the measured ones.

Measured and simulated runs go through the same rule: speeds are slopes of the commanded pose before
and after the first contact, stiffness and damping a least-squares fit of the reading on pose and
rate in contact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.analysis.metrics import settle_ticks
from hiltestbed.campaign.cases import lockstep_groups
from hiltestbed.diagnosis.conclusion import SimulatedRun
from hiltestbed.diagnosis.result import Cause, ClosedLoop, Figures, Learned
from hiltestbed.errors import HiltestbedError
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset, MeasuredRun
from hiltestbed.replay.wrench import shifted
from hiltestbed.scenario import Scenario, resolved, scenario_from
from hiltestbed.signals import RunTrace
from hiltestbed.simulation import simulate

SPEED_WINDOW = 0.1  # chosen: [s] over which a speed is estimated, at most
MIN_SAMPLES = 8  # of a speed
# chosen: [s] from the end of a contact to the speed, longer than the tail of an unknown delay or
# lag
QUIET_TIME = 0.03
# chosen: a contact is smoothed over this part of itself before it is differentiated
SMOOTHING_PARTS = 15
LOCKSTEP_RUNS = 64  # simulated together
# chosen: of the largest penetration, from which samples are fitted: below it the force is clipped
MIN_FITTED_SHARE = 0.01


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
    return scenario_from(data)


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
    """Figures of every run."""
    rows = [
        tuple(
            figures(motion, run.scenario)
            for motion in (measured_motion(run), trace_motion(p.nominal), trace_motion(p.extended))
        )
        for run, p in zip(dataset.runs, simulated, strict=True)
    ]
    return ClosedLoop(
        tuple(p.run for p in simulated), *(tuple(row[i] for row in rows) for i in range(3))
    )


def measured_motion(run: MeasuredRun) -> RunSignals:
    """The motion of a measured run."""
    record, spans = run.record, [(c.start, c.end) for c in run.survey.contacts]
    names = ("pose_cmd.pz", "pose_act.pz", "wrench_meas.fz")
    command, reached, force = (
        record.column(name) if name in record.columns() else None for name in names
    )
    return RunSignals(record.t, command, reached, force, _first(spans, record.ticks))


def trace_motion(trace: RunTrace | None) -> RunSignals | None:
    """The motion of a simulated run."""
    if trace is None:
        return None
    edges = np.flatnonzero(np.diff(np.r_[False, trace.contact, False])).reshape(-1, 2)
    command, reached, force = (
        np.ascontiguousarray(trace[g][:, 2]) for g in ("pose_cmd", "pose_act", "wrench_meas")
    )
    return RunSignals(
        trace.t, command, reached, force, _first([(int(a), int(b)) for a, b in edges], len(trace.t))
    )


def _first(spans: Sequence[tuple[int, int]], ticks: int) -> tuple[int, int, int] | None:
    if not spans:
        return None
    return (*spans[0], spans[1][0] if len(spans) > 1 else ticks)


def figures(motion: RunSignals | None, scenario: Scenario) -> Figures:
    """Figures of a run; all None for a run without contact."""
    if motion is None or motion.span is None:
        return Figures()
    stiffness, damping = identified(motion, scenario) if scenario.mechanism.flat else (None, None)
    peak = None
    if motion.force is not None:
        start, end, _ = motion.span
        reading = np.abs(motion.force[start : end + settle_ticks(scenario)])
        peak = float(np.nanmax(reading)) if np.isfinite(reading).any() else None
    cor = restitution(motion, scenario) if not scenario.mechanism.captured else None
    return Figures(cor, peak, stiffness, damping)


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
    window, settle = round(SPEED_WINDOW * scenario.rate), settle_ticks(scenario)
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


def identified(motion: RunSignals, scenario: Scenario) -> tuple[float | None, float | None]:
    """k [N/m] and c [N s/m] of F = k x + c v over the first contact, with the reading shifted back
    by the sensor's nominal delay.

    Clipped samples at the touch are left out (literature: a window over x > 0 costs 3 to 5 % of c).
    """
    if motion.reached is None or motion.force is None or motion.span is None:
        return None, None
    start, end, _ = motion.span
    rows = np.arange(start, min(end, len(motion.t)))
    late = scenario.sensor.delay * scenario.rate
    x = _smoothed(motion.reached, rows)
    y = shifted(motion.force[:, None], late)[rows, 0]
    if x is None:
        return None, None
    v = np.gradient(x, scenario.tick)
    use = np.isfinite(x) & np.isfinite(y) & (x > MIN_FITTED_SHARE * np.nanmax(x))
    use &= y > MIN_FITTED_SHARE * np.nanmax(np.abs(y)) if np.isfinite(y).any() else False
    if use.sum() < MIN_SAMPLES:
        return None, None
    matrix = np.column_stack([x[use], v[use]])
    scale = np.linalg.norm(matrix, axis=0)
    if not (scale > 0).all():
        return None, None
    k, c = np.linalg.lstsq(matrix / scale, y[use], rcond=None)[0] / scale
    return float(k), float(c)


def _smoothed(z: Array, rows: np.ndarray) -> Array | None:
    """z at `rows`, with gaps interpolated, smoothed by a cubic over a small part of the contact."""
    from scipy.signal import savgol_filter

    known = np.flatnonzero(np.isfinite(z))
    length = max(5, len(rows) // SMOOTHING_PARTS) | 1
    if len(rows) < 2 * length or len(known) < len(rows) // 2:
        return None
    return np.asarray(savgol_filter(np.interp(np.arange(len(z)), known, z[known]), length, 3))[rows]
