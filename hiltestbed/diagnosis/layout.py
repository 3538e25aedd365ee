"""Stage "layout": a measured dataset as the links need it: inputs and outputs of each link, rows
and noise floors.

Takes a `MeasuredDataset`, gives a `Layout`; `platform_link`, `wrench_link`, `compensation_link` and
`dynamics_link` make the links of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis.bridged import (
    CORRELATION_FACTOR,
    bridged,
    interpolation_errors,
    kink_errors,
    rms_differences,
)
from hiltestbed.diagnosis.floors import floors, repetition_factor
from hiltestbed.diagnosis.lacking import every_run_has, lacking, on_record
from hiltestbed.diagnosis.links import (
    CompensationLink,
    DynamicsLink,
    LinkRun,
    PlatformLink,
    WrenchLink,
    flat_pose,
)
from hiltestbed.diagnosis.low_pass import LowPass, low_pass_between
from hiltestbed.diagnosis.noise import FEW_STEPS, POSE_PARTS, ForceNoise, few_levels, force_noise
from hiltestbed.diagnosis.scales import scales_of
from hiltestbed.diagnosis.settings import COMPENSATION_FLOOR, DYNAMICS_FLOOR, MIN_POSE_NOISE
from hiltestbed.diagnosis.yielding import Deflection, deflection, engagement
from hiltestbed.effects.search import Scales
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset, MeasuredRun
from hiltestbed.replay import Engaged
from hiltestbed.replay.compensation import needs
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

MIN_FORCE_NOISE = 1e-6  # chosen: share of the peak force: floor of a force without noise
# chosen: [m] uncertainty of the point of application; times the peak force it is the floor of a
# torque
FORCE_ARM_ERROR = 2e-6
# chosen: [s] after the last contact that the search includes, where charge leakage and ringing show
TAIL_TIME = 0.15

# chosen: [s] for which a missing sample is taken to affect platform, contact and compensation
GAP_MEMORY = 0.05
# rows at each end whose command may not be on record: loggers stamp each channel up to two rows
# early or late
UNUSED_END_ROWS = 3
# chosen: of the computed force, above which a compensation on differentiated poses shows nothing
MAX_RATE_ERROR = 0.1
ROTATIONS = ("rx", "ry", "rz")


@dataclass(frozen=True)
class DatasetLayout:
    """One dataset as the links see it.

    Attributes:
        runs: as measured. rows: of each run, that the search uses. scales: orders of magnitude of
            the data. noise: channel to its floor.
        force: the noise model of the force, from free flight.
        deflection: of each run, departure of the believed rig from its command; None where it
            cannot be replayed or is not needed.
        missing: link to the reason why it cannot be replayed.
        logged: the filter through which the force went to the log but not to the loop; None: there
            is none.
    """

    runs: tuple[MeasuredRun, ...]
    rows: tuple[int, ...]
    scales: Scales
    noise: Mapping[str, float]
    force: ForceNoise
    deflection: tuple[Deflection, ...] | None
    missing: Mapping[str, str]
    logged: LowPass | None = None

    def assumed(self) -> tuple[str, ...]:
        """The assumptions on the recorded force, in sentences."""
        return (
            *self.force.words(),
            *([self.logged.words(1.0 / self.scales.tick)] if self.logged else []),
        )

    @property
    def least_force(self) -> float:
        """[N] the least noise floor of a force."""
        return MIN_FORCE_NOISE * self.scales.force

    @property
    def whole(self) -> tuple[int, ...]:
        """The rows of each run."""
        return tuple(r.record.ticks for r in self.runs)


def lay_out(dataset: MeasuredDataset) -> DatasetLayout:
    """Rows, noise floors and scales of a dataset, and which links can be replayed."""
    runs = dataset.runs
    force = force_noise(runs)
    noise = floors(runs) | force.levels()
    missing = lacking(runs)
    given, engaged = None, tuple(None if "platform" in missing else engagement(r) for r in runs)
    if "platform" not in missing:
        given, lost = _deflections(runs, noise, engaged)
        if lost is not None:
            missing["platform"] = (
                f"the believed rig cannot follow the command on record in {lost.name}"
            )
    elif (
        "wrench" not in missing
        and not every_run_has(runs, "pose_act")
        and every_run_has(runs, "pose_cmd")
    ):
        # in place of the pose that was not measured
        given, lost = _deflections(runs, noise, engaged)
        if lost is not None:
            missing["wrench"] = (
                f"needs pose_act: the believed rig cannot follow the command on record in "
                f"{lost.name}"
            )
    scales = scales_of(runs, noise)
    layout = DatasetLayout(
        runs, tuple(_rows(r) for r in runs), scales, noise, force, given, missing
    )
    if "compensation" in missing:
        return layout
    link = compensation_link(layout, layout.whole)
    if _share_of_rates(link) > MAX_RATE_ERROR:
        why = (
            "needs twist_act in every run: the compensation depends on it more closely "
            "than differences of pose_act show it"
        )
        return replace(layout, missing=missing | {"compensation": why})
    logged = _logger_filter(link)
    if logged is None:
        return layout
    # third differences underestimate filtered noise
    force, white = force_noise(runs, logged), link.noise_gain() * logged.colour
    led = {c.replace("comp", "meas"): noise[c] / white for c in link.channels if noise.get(c)}
    return replace(layout, force=force, noise=noise | led | force.levels(), logged=logged)


def _share_of_rates(link: CompensationLink) -> float:
    """Share of the computed force that differentiating pose_act is off by; 0: it is not needed."""
    other = link.with_central_rates()
    if other is None:
        return 0.0
    computed = np.concatenate([link.shown(i) for i in range(len(link.runs))])[:, :3]
    missed = np.concatenate(rms_differences(link, other))[:, :3]
    return float(np.linalg.norm(missed) / max(np.linalg.norm(computed), 1e-12))


def _logger_filter(link: CompensationLink) -> LowPass | None:
    """The filter through which the force went to the log but not to the loop, if any."""
    behind = link.shown_in_all()
    known = [np.asarray(np.isfinite(run.sigma).all(axis=1)) for run in link.runs]
    return low_pass_between([run.measured for run in link.runs], behind, known)


def with_noise_beside(layout: DatasetLayout, shown: Sequence[Array]) -> DatasetLayout:
    """The same with a latched mechanism's noise beside readings ``shown`` (N, 6) by the contact."""
    force, before = force_noise(layout.runs, layout.logged, shown), layout.force.levels()
    others = {c: v for c, v in layout.noise.items() if c not in before}
    return replace(layout, force=force, noise=floors(layout.runs) | others | force.levels())


def _deflections(
    runs: Sequence[MeasuredRun],
    noise: Mapping[str, float],
    engaged: Sequence[Engaged | None],
) -> tuple[tuple[Deflection, ...] | None, MeasuredRun | None]:
    """The believed rig's departure from its command in each run, or a run it cannot follow."""
    found = []
    for i, run in enumerate(runs):
        one = deflection(run, noise.get("wrench_meas.fz", 0.0), None, engaged[i])
        if one is None:
            return None, run
        found.append(one)
    return tuple(found), None


def platform_link(layout: DatasetLayout, rows: Sequence[int]) -> PlatformLink:
    """The platform on the first ``rows`` of each run."""
    assert layout.deflection is not None  # else the link is missing
    runs, commands, away = [], [], []
    for run, found, n in zip(layout.runs, layout.deflection, rows, strict=True):
        one = _pose_run(run, layout.noise, found.doubt[:n], n)
        runs.append(
            replace(one, scenario=_from_where_it_stood(run)) if "wrench" in layout.missing else one
        )
        commands.append(np.ascontiguousarray(run.record.filled("pose_cmd")[:n]))
        away.append(found.away[:n])
    return PlatformLink(runs, commands, away).with_rounding(
        _cut([r.record.unsmoothed() for r in layout.runs], rows)
    )


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
    believed = np.where(
        uncommanded, run.record.filled("pose_cmd")[0, :3], (*approach.offset, -approach.gap)
    )
    begin = np.where(np.isfinite(first), first, believed)
    moved = approach.model_copy(
        update={"offset": (float(begin[0]), float(begin[1])), "gap": -float(begin[2])}
    )
    return scenario.model_copy(update={"approach": moved})


def compensation_link(layout: DatasetLayout, rows: Sequence[int]) -> CompensationLink:
    """The compensation on the first ``rows`` of each run."""
    level = COMPENSATION_FLOOR * max(layout.noise.get("wrench_meas.fz", 0.0), 1e-6)
    level *= CORRELATION_FACTOR
    groups = {g for r in layout.runs for g in needs(r.scenario)} - {"wrench_meas"}
    twists = {
        g.replace("pose", "twist")
        for g in groups
        if every_run_has(layout.runs, g.replace("pose", "twist"))
    }
    pairs = list(zip(layout.runs, rows, strict=True))
    records = {g: _filled(layout, g, rows) for g in groups | twists}
    wrenches = _filled(layout, "wrench_meas", rows)

    def computed(memory: float) -> list[LinkRun]:
        return [
            _computed_run(r, r.record.data["wrench_comp"], level, n, "wrench_meas", memory)
            for r, n in pairs
        ]

    link = CompensationLink(computed(GAP_MEMORY), wrenches, records)
    gain, runs = link.noise_gain(), computed(link.memory() or GAP_MEMORY)
    written = [
        np.hypot(r.record.rounding("wrench_comp"), gain * r.record.rounding("wrench_meas"))[:n]
        for r, n in pairs
    ]
    runs = _less_certain(runs, written)
    bends = interpolation_errors(layout.runs, "wrench_meas", rows)
    if any(b.any() for b in bends):
        straight = [w - b for w, b in zip(wrenches, bends, strict=True)]
        missed = rms_differences(
            CompensationLink(runs, wrenches, records), CompensationLink(runs, straight, records)
        )
        own = interpolation_errors(layout.runs, "wrench_comp", rows)
        runs = _less_certain(runs, [np.hypot(m, b) for m, b in zip(missed, own, strict=True)])
    if layout.logged:
        runs = [_filtered(run, layout.logged) for run in runs]
    link = CompensationLink(runs, wrenches, records)
    if (other := link.with_central_rates()) is not None:
        runs = _less_certain(runs, rms_differences(link, other))
    return CompensationLink(runs, wrenches, records)


def _less_certain(
    runs: Sequence[LinkRun], errors: Sequence[Array], factor: float = CORRELATION_FACTOR
) -> list[LinkRun]:
    """The runs with further ``errors`` (N, C), which are correlated over rows."""
    pairs = zip(runs, errors, strict=True)
    return [replace(run, sigma=np.hypot(run.sigma, factor * e)) for run, e in pairs]


def _filtered(run: LinkRun, logged: LowPass) -> LinkRun:
    """The computed force filtered like the recorded one it is compared with."""
    sigma = np.hypot(run.sigma, CORRELATION_FACTOR * logged.missed(run.measured))
    filtered = logged(run.measured)
    return replace(
        run, measured=filtered, sigma=sigma, nuisances=_late(filtered, logged)[:, :, None]
    )


def _late(force: Array, logged: LowPass) -> Array:
    """(N, C) change of a force by the filter's uncertain delay, at one standard deviation."""
    return np.asarray(logged.delay_error * np.gradient(force, axis=0))


def dynamics_link(layout: DatasetLayout, rows: Sequence[int]) -> DynamicsLink:
    """The numerical model on the first ``rows`` of each run."""
    level = DYNAMICS_FLOOR * CORRELATION_FACTOR
    pairs = list(zip(layout.runs, rows, strict=True))
    # [s] for which a lost sample matters: to the end of the run, unless its bridge has a known
    # error
    gone = {True: 0.0, False: None}
    short = [r.record.only_short_gaps("wrench_comp") for r in layout.runs]
    runs = [
        _computed_run(r, flat_pose(r.record.data["pose_cmd"]), level, n, "wrench_comp", gone[s])
        for (r, n), s in zip(pairs, short, strict=True)
    ]
    wrenches = _filled(layout, "wrench_comp", rows)
    missing = [r.record.lost("wrench_comp")[:n] & s for (r, n), s in zip(pairs, short, strict=True)]
    bends = interpolation_errors(layout.runs, "wrench_comp", rows)
    # at most
    half_digits = [
        math.sqrt(3.0) * np.hypot(pose_rounding(r, "pose_cmd"), pose_steps(r, "pose_cmd"))[:n]
        for r, n in pairs
    ]
    runs = _less_certain(runs, half_digits)
    level = levels(layout, "wrench_comp")
    runs = bridged(runs, lambda given: DynamicsLink(runs, given), wrenches, missing, bends, level)
    if any(b.any() for b in bends):
        # interpolation errors may add up in the motion
        coherent = [w + np.abs(b) for w, b in zip(wrenches, bends, strict=True)]
        missed = rms_differences(DynamicsLink(runs, wrenches), DynamicsLink(runs, coherent))
        # one error a run, in however many rows
        lasting = [math.sqrt(len(m)) * np.maximum.accumulate(m, axis=0) for m in missed]
        runs = _less_certain(runs, lasting, 1.0)
    return DynamicsLink(runs, wrenches)


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
    least = layout.scales.force * np.array([MIN_FORCE_NOISE] * 3 + [FORCE_ARM_ERROR] * 3)
    pairs = enumerate(zip(layout.runs, rows, strict=True))
    runs = [_force_run(run, layout, i, n, least) for i, (run, n) in pairs]
    if extra is not None:
        runs = _less_certain(runs, _cut(extra, rows), 1.0)
    return WrenchLink(
        runs,
        _cut(paths, rows),
        None if jumps is None else _cut(jumps, rows),
        None if rates is None else _cut(rates, rows),
    )


def levels(layout: DatasetLayout, group: str) -> Array:
    """(6,) noise of the wrench of a group."""
    return np.array([layout.noise.get(name, 0.0) for name in GROUPS[group].columns])


def _filled(layout: DatasetLayout, group: str, rows: Sequence[int]) -> list[Array]:
    """The first ``rows`` of a group in each run, with gaps bridged."""
    return _cut([r.record.filled(group) for r in layout.runs], rows)


def _cut(arrays: Sequence[Array], rows: Sequence[int]) -> list[Array]:
    return [np.ascontiguousarray(a[:n]) for a, n in zip(arrays, rows, strict=True)]


def _rows(run: MeasuredRun) -> int:
    if not run.survey.contacts:
        return run.record.ticks
    end = max(c.end for c in run.survey.contacts)
    return min(
        run.record.ticks, end + round((TAIL_TIME + run.scenario.sensor.delay) * run.scenario.rate)
    )


def _force_run(run: MeasuredRun, layout: DatasetLayout, i: int, rows: int, least: Array) -> LinkRun:
    """A measured force less the offset of this run, with its noise."""
    level = np.maximum(levels(layout, "wrench_meas"), least) * layout.force.colour
    reading = np.nan_to_num(run.record.data["wrench_meas"][:rows]) - layout.force.offset[i]
    written, kinks = run.record.rounding("wrench_meas"), kink_errors(run.record, "wrench_meas")
    level = np.hypot(np.hypot(level, layout.force.share * reading), written[:rows])
    level = np.hypot(level * repetition_factor(run, "wrench_meas", rows), kinks[:rows])
    sigma = np.where(run.record.valid["wrench_meas"][:rows], level, np.inf)
    sigma[:, [few_levels(run, name) for name in GROUPS["wrench_meas"].columns]] = np.inf
    path = next((g for g in ("pose_act", "pose_cmd") if run.record.has(g)), None)
    if path is not None:
        sigma[run.record.unknown(path, GAP_MEMORY + run.scenario.sensor.delay)[:rows]] = np.inf
    measured = np.where(run.record.valid["wrench_meas"][:rows], reading, 0.0)
    force = layout.force
    nuisances = force.nuisances(rows, run.record.ticks, np.min(level, axis=0))
    if layout.logged:
        late = _late(run.record.filled("wrench_meas")[:rows], layout.logged)
        nuisances = np.concatenate([nuisances, late[:, :, None]], axis=2)
    terms = nuisances if nuisances.shape[2] else None
    return LinkRun(run.scenario, measured, sigma, run.touching(rows), force.heavy, terms)


def _pose_run(run: MeasuredRun, noise: Mapping[str, float], doubt: Array, rows: int) -> LinkRun:
    """A measured pose as position and small rotation vector; an attitude counts where all of it was
    measured.

    An axis that was told to stay within a step or two of its converter, and did, does not count:
    its quantisation hides such motions. Where drives carry A and not all that acts on them is on
    record, symmetry leaves the axis of insertion: noise moves the others a little.
    """
    valid = run.record.valid["pose_act"][:rows]
    level = np.maximum(
        [noise.get(f"pose_act.{part}", 0.0) for part in ("px", "py", "pz", *ROTATIONS)],
        MIN_POSE_NOISE,
    )
    counted = np.concatenate(
        [valid[:, :3], np.repeat(np.all(valid[:, 3:], axis=1)[:, None], 3, axis=1)], axis=1
    )
    level = (
        np.hypot(level, pose_rounding(run, "pose_act")[:rows])
        * repetition_factor(run, "pose_act", rows)[:, :6]
    )
    told = pose_rounding(run, "pose_cmd")[:rows] * repetition_factor(run, "pose_cmd", rows)[:, :6]
    sigma = np.where(counted, np.sqrt(level**2 + told**2 + doubt**2), np.inf)
    sigma[
        :, [few_levels(run, f"pose_act.{part}") and _told_to_stay(run, part) for part in POSE_PARTS]
    ] = np.inf
    acting = [g for g in ("pose_cmd", "wrench_meas") if run.record.has(g)]
    if not run.scenario.rig.platform.prescribed and not all(on_record(run, g) for g in acting):
        sigma[:, [0, 1, 3, 4, 5]] = np.inf
    sigma[run.record.unknown("pose_cmd", GAP_MEMORY)[:rows]] = np.inf
    # row 0 is the start, and stamps may be off by rows
    sigma[:UNUSED_END_ROWS] = sigma[run.record.ticks - UNUSED_END_ROWS :] = np.inf
    return LinkRun(
        run.scenario,
        np.nan_to_num(flat_pose(run.record.data["pose_act"][:rows])),
        sigma,
        run.touching(rows),
    )


def _told_to_stay(run: MeasuredRun, part: str) -> bool:
    """Whether a command varies by less than what a quantised measurement shows the size of."""
    return (
        float(np.ptp(run.record.filled("pose_cmd")[:, POSE_PARTS.index(part)]))
        < FEW_STEPS * run.record.steps[f"pose_act.{part}"]
    )


def pose_rounding(run: MeasuredRun, group: str) -> Array:
    """(ticks, 6) 1 sigma of the rounding error of a written pose, as of :func:`flat_pose`."""
    rounding = run.record.rounding(group)
    return np.column_stack([rounding[:, :3], 2.0 * rounding[:, 3:6]])


def pose_steps(run: MeasuredRun, group: str) -> Array:
    """(6,) 1 sigma of the quantisation error of a pose, as position and small rotation vector."""
    steps = [run.record.steps.get(f"{group}.{part}", 0.0) for part in POSE_PARTS]
    return np.array(steps) * np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]) / math.sqrt(12.0)


def _computed_run(
    run: MeasuredRun, values: Array, level: float, rows: int, given: str, memory: float | None
) -> LinkRun:
    """The run of a channel computed from the group ``given``; memory: as of `Record.unknown`."""
    sigma = np.where(np.isfinite(values[:rows]), level, np.inf)
    sigma[run.record.unknown(given, memory)[:rows]] = np.inf
    if given == "wrench_meas":  # axis by axis: an axis that was not measured gives nothing
        sigma[:, [name in run.record.absent for name in GROUPS[given].columns]] = np.inf
    return LinkRun(run.scenario, np.nan_to_num(values[:rows]), sigma, run.touching(rows))
