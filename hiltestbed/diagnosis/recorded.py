"""The links of a dataset: what is on record of their inputs and outputs, and with which noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hiltestbed.diagnosis.floors import repetition_factor
from hiltestbed.diagnosis.lacking import every_run_has, on_record
from hiltestbed.diagnosis.links import (
    CompensationLink,
    DynamicsLink,
    LinkRun,
    ModelLink,
    PlatformLink,
    WrenchLink,
    flat_pose,
)
from hiltestbed.diagnosis.low_pass import LowPass
from hiltestbed.diagnosis.noise import FEW_STEPS, POSE_PARTS, ForceNoise, few_levels
from hiltestbed.diagnosis.settings import (
    CORRELATED_ROWS,
    LEVER_ARM,
    LINK_MEMORY,
    MIN_POSE_NOISE,
    SMOOTHING_ROWS,
)
from hiltestbed.diagnosis.yielding import Deflection
from hiltestbed.effects.search import Scales
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun, Record
from hiltestbed.measured.record import MAX_BRIDGED
from hiltestbed.replay.compensation import needs
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

MIN_FORCE_NOISE = 1e-6  # chosen: share of the peak force: floor of a force without noise
# chosen: [m] uncertainty of the point of application; times the peak force the floor of a torque
FORCE_ARM_ERROR = 2e-6
# calibrated: [m, rad] difference between integrators of one step size, practice rig and this one
DYNAMICS_FLOOR = 2e-6
# chosen: share of the force noise: difference between two implementations of one filter
COMPENSATION_FLOOR = 0.05
# rows at each end whose command may not be on record: loggers stamp each channel up to two rows
# early or late
UNUSED_END_ROWS = 3
# of the variance of the noise: what lies between two rows has its own, and a quarter of that of
# each of the two beside
LOST_NOISE = 1.5
FORGOTTEN = 0.01  # of the variance of a reading, below which a compensation has forgotten it
STEP_SIGMA = 1.0 / math.sqrt(12.0)  # of a step, standard deviation of the error by rounding to it
KINK_ROWS = 5  # chosen: ticks over which the error of a kink spreads
# chosen: of a bend to their median; noise exceeds it in 3e-4 of the rows at most (simulated, 500 to
# 1700 of 2000 Hz)
KINK_RATIO = 7.0
ROTATIONS = ("rx", "ry", "rz")


@dataclass(frozen=True)
class DatasetLayout:
    """One dataset as the links see it.

    Attributes:
        runs: as measured. rows: of each run, that the search uses. scales: orders of magnitude of
            the data. noise: channel to its floor. force: noise of the force, from free flight.
        deflection: of each run, departure of the believed rig from its command; None where it
            cannot be replayed or is not needed. missing: link to the reason why it is not judged.
        logged: the filter through which the force went to the log but not to the loop, if any.
        open_commands: (N, 6, D) of each run, changes of a command that was computed, which its
            computation leaves open, one standard deviation each; empty: commands are as on record.
    """

    runs: tuple[MeasuredRun, ...]
    rows: tuple[int, ...]
    scales: Scales
    noise: Mapping[str, float]
    force: ForceNoise
    deflection: tuple[Deflection, ...] | None
    missing: Mapping[str, str]
    logged: LowPass | None = None
    open_commands: tuple[Array, ...] = ()

    def assumed(self) -> tuple[str, ...]:
        """The assumptions on the recorded force, in sentences."""
        filtered = [self.logged.words(1.0 / self.scales.tick)] if self.logged else []
        return (*self.force.words(), *filtered)

    def level(self, group: str) -> Array:
        """(6,) noise of the wrench of a group."""
        return np.array([self.noise.get(name, 0.0) for name in GROUPS[group].columns])

    @property
    def largest(self) -> Array:
        """(6,) largest size of a wrench on record in any run, at least the scale of the force."""
        groups = ("wrench_meas", "wrench_comp")
        values = [r.record.data[g] for r in self.runs for g in groups if r.record.has(g)]
        least = self.scales.force * np.array([1.0] * 3 + [LEVER_ARM] * 3)
        return np.max([least, *(np.abs(np.nan_to_num(v)).max(axis=0) for v in values)], axis=0)

    @property
    def least_force(self) -> float:
        """[N] the least noise floor of a force."""
        return MIN_FORCE_NOISE * self.scales.force

    @property
    def whole(self) -> tuple[int, ...]:
        """The rows of each run."""
        return tuple(r.record.ticks for r in self.runs)

    def filled(self, group: str, rows: Sequence[int]) -> list[Array]:
        """The first ``rows`` of a group in each run, with gaps bridged."""
        return cut([r.record.filled(group) for r in self.runs], rows)


def platform_link(layout: DatasetLayout, rows: Sequence[int]) -> PlatformLink:
    """The platform on the first ``rows`` of each run."""
    assert layout.deflection is not None  # else the link is missing
    runs = []
    for run, found, n in zip(layout.runs, layout.deflection, rows, strict=True):
        one = _pose_run(run, layout.noise, found.doubt[:n], n)
        if "wrench" in layout.missing:
            one = replace(one, scenario=_from_where_it_stood(run))
        runs.append(one)
    away = [found.away[:n] for found, n in zip(layout.deflection, rows, strict=True)]
    link = PlatformLink(runs, layout.filled("pose_cmd", rows), away)
    if layout.open_commands:
        link = link.with_open_commands(cut(layout.open_commands, rows))
    return link.with_rounding(cut([r.record.unsmoothed() for r in layout.runs], rows))


def _from_where_it_stood(run: MeasuredRun) -> Scenario:
    """The scenario of a platform that is moved without an approach: it begins where the record has
    it, a load's droop off its command.

    An axis without a command on record stands still where the replay has it.
    """
    scenario, first = run.scenario, run.record.data["pose_act"][0, :3]
    approach = scenario.approach
    if any(approach.velocity):
        return scenario
    uncommanded = [name in run.record.absent for name in GROUPS["pose_cmd"].columns[:3]]
    told = run.record.filled("pose_cmd")[0, :3]
    believed = np.where(uncommanded, told, (*approach.offset, -approach.gap))
    x, y, z = (float(v) for v in np.where(np.isfinite(first), first, believed))
    moved = approach.model_copy(update={"offset": (x, y), "gap": -z})
    return scenario.model_copy(update={"approach": moved})


def compensation_link(layout: DatasetLayout, rows: Sequence[int]) -> CompensationLink:
    """The compensation on the first ``rows`` of each run. Rows do not count that depend on readings
    which are not on record: one wrong reading shows in many rows of the output.
    """
    noise, most = layout.level("wrench_meas"), layout.largest
    level = COMPENSATION_FLOOR * max(noise[2], 1e-6) * math.sqrt(CORRELATED_ROWS)
    scenarios = [r.scenario for r in layout.runs]
    groups = {g for s in scenarios for g in needs(s.compensation, s.mechanism)} - {"wrench_meas"}
    rates = {g.replace("pose", "twist") for g in groups}
    groups |= {g for g in rates if every_run_has(layout.runs, g)}
    records = {g: layout.filled(g, rows) for g in groups}
    wrenches = layout.filled("wrench_meas", rows)
    pairs = list(zip(layout.runs, rows, strict=True))
    first = [_computed(r, r.record.data["wrench_comp"], level, n) for r, n in pairs]
    link, runs = CompensationLink(first, wrenches, records), []
    for (r, n), run in zip(pairs, first, strict=True):
        record = r.record
        own = np.hypot(record.rounding("wrench_comp"), interpolation_error(record, "wrench_comp"))
        passed = link.passed(input_variance(record, "wrench_meas", noise, most)[:n])
        sigma = np.sqrt(run.sigma**2 + own[:n] ** 2 + passed)
        if link.linear:
            bridged = np.where(record.lost("wrench_meas")[:n, None], noise**2, 0.0)
            sigma[link.passed(bridged) > FORGOTTEN * noise**2] = np.inf
        else:
            sigma[record.unknown("wrench_meas", LINK_MEMORY)[:n]] = np.inf
        sigma[:, [name in record.absent for name in GROUPS["wrench_meas"].columns]] = np.inf
        runs.append(replace(run, sigma=sigma, steps=_steps(record, "wrench_comp")))
    if layout.logged:
        runs = [_filtered(run, layout.logged) for run in runs]
    link = CompensationLink(runs, wrenches, records)
    if (other := link.with_central_rates()) is not None:
        missed = [math.sqrt(CORRELATED_ROWS) * m for m in rms_differences(link, other)]
        link = CompensationLink(_less_certain(runs, missed), wrenches, records)
    link.logged = layout.logged
    return link


def _less_certain(runs: Sequence[LinkRun], errors: Sequence[Array]) -> list[LinkRun]:
    """The runs with further ``errors`` (N, C)."""
    pairs = zip(runs, errors, strict=True)
    return [replace(run, sigma=np.hypot(run.sigma, e)) for run, e in pairs]


def _filtered(run: LinkRun, logged: LowPass) -> LinkRun:
    """The computed force filtered like the recorded one it is compared with."""
    missed = math.sqrt(CORRELATED_ROWS) * logged.missed(run.measured)
    filtered = logged(run.measured)
    late = _late(filtered, logged)[:, :, None]
    return replace(run, measured=filtered, sigma=np.hypot(run.sigma, missed), nuisances=late)


def _late(force: Array, logged: LowPass) -> Array:
    """(N, C) change of a force by the filter's uncertain delay, at one standard deviation."""
    return np.asarray(logged.delay_error * np.gradient(force, axis=0))


def dynamics_link(layout: DatasetLayout, rows: Sequence[int]) -> DynamicsLink:
    """The numerical model on the first ``rows`` of each run."""
    level = DYNAMICS_FLOOR * math.sqrt(CORRELATED_ROWS)
    noise, most, runs, variance = layout.level("wrench_comp"), layout.largest, [], []
    for r, n in zip(layout.runs, rows, strict=True):
        run = _computed(r, flat_pose(r.record.data["pose_cmd"]), level, n)
        written, quantised = pose_rounding(r, "pose_cmd")[:n], pose_steps(r, "pose_cmd")
        sigma = np.sqrt(run.sigma**2 + written**2 + quantised**2)
        sigma[r.record.in_long_gaps("wrench_comp")[:n]] = np.inf
        runs.append(replace(run, sigma=sigma))
        variance.append(input_variance(r.record, "wrench_comp", noise, most)[:n])
    link = DynamicsLink(runs, layout.filled("wrench_comp", rows))
    return link.with_input_errors(variance) if any(v.any() for v in variance) else link


def input_variance(record: Record, group: str, noise: Array, most: Array) -> Array:
    """(ticks, 6) variance of the errors of recorded wrenches, where they are the input of a link:
    of written digits, of converter steps, of ticks between the rows of a slower log, and of what
    bridges lost rows: noise, and the difference of the rows beside, by as much as which a reading
    jumps at a touch; in a gap that may hide a contact, and at an end, the largest reading on
    record. noise, most: (6,) of it.

    Errors of one stretch without rows are alike, and add up; on a line between rows, so does the
    noise of these.
    """
    out = record.rounding(group) ** 2 + (STEP_SIGMA * _steps(record, group)) ** 2
    if group in record.bends:
        stride = record.rate / record.sample_rate
        bend = interpolation_error(record, group)
        kink = _kinks(np.abs(bend), math.ceil(stride) + 1)
        out += stride * np.maximum(bend**2, kink**2)
        out += np.where(bend != 0.0, (1.0 + stride) * noise**2, 0.0)
    for j, name in enumerate(GROUPS[group].columns):
        if name in record.absent:
            continue
        known = np.flatnonzero(record.measured(name))
        lost = record.lost(group) & ~record.measured(name)
        if not lost.any() or not len(known):
            continue
        values = record.column(name)[known]
        at = np.searchsorted(known, np.flatnonzero(lost))
        before, after = values[np.maximum(at - 1, 0)], values[np.minimum(at, len(known) - 1)]
        edges = np.flatnonzero(np.diff(np.r_[False, lost, False])).reshape(-1, 2)
        length = np.repeat(edges[:, 1] - edges[:, 0], edges[:, 1] - edges[:, 0])
        bridged = (at > 0) & (at < len(known)) & (length <= MAX_BRIDGED)
        error = np.where(bridged, np.abs(after - before), most[j])
        out[lost, j] += length * error**2 + LOST_NOISE * noise[j] ** 2
    return out


def _steps(record: Record, group: str) -> Array:
    """(parts,) steps in which the columns of a group are written; 0 where they are not."""
    return np.array([record.steps.get(c, 0.0) for c in GROUPS[group].columns])


def _computed(run: MeasuredRun, values: Array, level: float, rows: int) -> LinkRun:
    sigma = np.where(np.isfinite(values[:rows]), level, np.inf)
    return LinkRun(run.scenario, np.nan_to_num(values[:rows]), sigma, run.touching(rows))


def wrench_link(
    layout: DatasetLayout,
    paths: Sequence[Array],
    rows: Sequence[int],
    jumps: Sequence[Array] | None = None,
    rates: Sequence[Array] | None = None,
    extra: Sequence[Array] | None = None,
) -> WrenchLink:
    """Contact and sensor on the paths (N, 7) of A in each run; jumps: (N,) [m] of A within a tick.

    rates: (N, 6) twist at t_k, None: the slope of the tick. extra: (N, 6) noise of the reading
        caused by the path's own noise [N, N m].
    """
    pairs = enumerate(zip(layout.runs, rows, strict=True))
    runs = [_force_run(run, layout, i, n) for i, (run, n) in pairs]
    if extra is not None:
        runs = _less_certain(runs, cut(extra, rows))
    jumps, rates = (x if x is None else cut(x, rows) for x in (jumps, rates))
    return WrenchLink(runs, cut(paths, rows), jumps, rates)


def cut(arrays: Sequence[Array], rows: Sequence[int]) -> list[Array]:
    return [np.ascontiguousarray(a[:n]) for a, n in zip(arrays, rows, strict=True)]


def _force_run(run: MeasuredRun, layout: DatasetLayout, i: int, rows: int) -> LinkRun:
    """A measured force less the offset of this run, with its noise."""
    group, record, force = "wrench_meas", run.record, layout.force
    least = layout.scales.force * np.array([MIN_FORCE_NOISE] * 3 + [FORCE_ARM_ERROR] * 3)
    level = np.maximum(layout.level(group), least) * force.colour
    reading = np.nan_to_num(record.data[group][:rows]) - force.offset[i]
    level = np.hypot(np.hypot(level, force.share * reading), record.rounding(group)[:rows])
    level = level * repetition_factor(run, group, rows)
    level = np.hypot(level, kink_errors(record, group)[:rows])
    valid = record.valid[group][:rows]
    sigma = np.where(valid, level, np.inf)
    sigma[:, [few_levels(run, name) for name in GROUPS[group].columns]] = np.inf
    path = next((g for g in ("pose_act", "pose_cmd") if record.has(g)), None)
    if path is not None:
        sigma[record.unknown(path, LINK_MEMORY + run.scenario.sensor.delay)[:rows]] = np.inf
    terms = [force.nuisances(rows, record.ticks, np.min(level, axis=0))]
    if layout.logged:
        terms.append(_late(record.filled(group)[:rows], layout.logged)[:, :, None])
    nuisances = np.concatenate(terms, axis=2)
    return LinkRun(
        run.scenario,
        np.where(valid, reading, 0.0),
        sigma,
        run.touching(rows),
        force.heavy,
        nuisances if nuisances.shape[2] else None,
    )


def _pose_run(run: MeasuredRun, noise: Mapping[str, float], doubt: Array, rows: int) -> LinkRun:
    """A measured pose as position and small rotation vector; an attitude counts where all of it was
    measured.

    An axis that was told to stay within a step or two of its converter, and did, does not count:
    its quantisation hides such motions. Where drives carry A and not all that acts on them is on
    record, symmetry leaves the axis of insertion: noise moves the others a little.
    """
    record = run.record
    valid = record.valid["pose_act"][:rows]
    turned = np.repeat(np.all(valid[:, 3:], axis=1)[:, None], 3, axis=1)
    floors = [noise.get(f"pose_act.{part}", 0.0) for part in ("px", "py", "pz", *ROTATIONS)]
    level = np.hypot(np.maximum(floors, MIN_POSE_NOISE), pose_rounding(run, "pose_act")[:rows])
    level = level * repetition_factor(run, "pose_act", rows)[:, :6]
    told = pose_rounding(run, "pose_cmd")[:rows] * repetition_factor(run, "pose_cmd", rows)[:, :6]
    counted = np.concatenate([valid[:, :3], turned], axis=1)
    sigma = np.where(counted, np.sqrt(level**2 + told**2 + doubt**2), np.inf)
    still = [few_levels(run, f"pose_act.{p}") and _told_to_stay(run, p) for p in POSE_PARTS]
    sigma[:, still] = np.inf
    acting = [g for g in ("pose_cmd", "wrench_meas") if record.has(g)]
    if not run.scenario.rig.platform.prescribed and not all(on_record(run, g) for g in acting):
        sigma[:, [0, 1, 3, 4, 5]] = np.inf
    sigma[record.unknown("pose_cmd", LINK_MEMORY)[:rows]] = np.inf
    # row 0 is the start, and stamps may be off by rows
    sigma[:UNUSED_END_ROWS] = sigma[record.ticks - UNUSED_END_ROWS :] = np.inf
    measured = np.nan_to_num(flat_pose(record.data["pose_act"][:rows]))
    return LinkRun(run.scenario, measured, sigma, run.touching(rows))


def _told_to_stay(run: MeasuredRun, part: str) -> bool:
    """Whether a command varies by less than what a quantised measurement shows the size of."""
    command = run.record.filled("pose_cmd")[:, POSE_PARTS.index(part)]
    return float(np.ptp(command)) < FEW_STEPS * run.record.steps[f"pose_act.{part}"]


def pose_rounding(run: MeasuredRun, group: str) -> Array:
    """(ticks, 6) 1 sigma of the rounding error of a written pose, as of :func:`flat_pose`."""
    rounding = run.record.rounding(group)
    return np.column_stack([rounding[:, :3], 2.0 * rounding[:, 3:6]])


def pose_steps(run: MeasuredRun, group: str) -> Array:
    """(6,) 1 sigma of the quantisation error of a pose, as position and small rotation vector."""
    steps = [run.record.steps.get(f"{group}.{part}", 0.0) for part in POSE_PARTS]
    return STEP_SIGMA * np.array(steps) * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


def interpolation_error(record: Record, group: str) -> Array:
    """``(ticks, parts)``, see `bends` of :class:`Record`; 0 where all rows are ticks."""
    return record.bends.get(group, np.zeros(record.data[group].shape))


def kink_errors(record: Record, group: str) -> Array:
    """``(ticks, parts)`` error of linear interpolation where a channel bends within a row, as a
    force does at a touch; 0 elsewhere.

    The spline through the samples departs from the polygon there, by at least a sixth of the error
    of the polygon (simulated for rates of the log from a quarter to 1.3 of the loop's, samples
    interpolated by the logger or not): the error is within three standard deviations. What noise
    does to the spline everywhere is no kink.
    """
    # a tick without a row lies further from a line, up to four times
    size = np.where(record.valid[group], np.abs(interpolation_error(record, group)), 0.0)
    return _kinks(size, KINK_ROWS)


def _kinks(size: Array, rows: int) -> Array:
    """(N, C) error within so many rows of a bend ``size`` (N, C) that is far from usual; else 0."""
    usual = np.array([float(np.median(x[x > 0.0])) if x.any() else 0.0 for x in size.T])
    peak = maximum_filter1d(size, rows, axis=0)
    return np.where(peak > KINK_RATIO * usual, 2.0 * peak, 0.0)


def smoothed_rms(changes: Array) -> Array:
    """(N, C) rms of changes (K, N, C) about each row."""
    square = uniform_filter1d(np.mean(np.square(changes), axis=0), SMOOTHING_ROWS, axis=0)
    return np.sqrt(np.maximum(square, 0.0))


def rms_differences(link: ModelLink, other: ModelLink) -> list[Array]:
    """``(N, channels)`` difference of two links in each run, rms about each row."""
    pairs = zip(link.shown_in_all(), other.shown_in_all(), strict=True)
    return [smoothed_rms((a - b)[None]) for a, b in pairs]
