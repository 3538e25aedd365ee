"""A measured dataset laid out for the links: what each was driven with, what it showed, and its noise floor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.diagnosis.candidates import Scales
from hiltestbed.diagnosis.compensated import uncomputed
from hiltestbed.diagnosis.driven import unfollowed, yields
from hiltestbed.diagnosis.links import CompensationLink, DynamicsLink, Link, LinkRun, PlatformLink, WrenchLink, flat_pose
from hiltestbed.diagnosis.thin import thinned
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset, MeasuredRun
from hiltestbed.measured.noise import white_noise

DYNAMICS_FLOOR = 2e-6  # [m], [rad]: pose_cmd is computed, not measured; integrator details below this are harmless
COMPENSATION_FLOOR = 0.05  # of the force noise: wrench_comp is computed too
CORRELATED = 50  # rows of a computed channel that count as one
ENOUGH = 30  # samples from which a noise floor is read
UNEVEN = 3.0  # the most that the noise of one axis of translation exceeds another's
TAIL = 0.15  # [s] after the last contact that a search looks at
PLATFORM_LEAST = 1e-9  # [m] floor of a pose that carries no noise
FORCE_LEAST = 1e-6  # of the peak force: floor of a force that carries no noise
ARM_LEAST = 2e-6  # [m] arm of the peak force that makes the floor of a torque: where between tip and surface the force acts is not known


@dataclass
class Study:
    """The links of one dataset.

    Attributes:
        runs: as measured. rows: of each run that the search looks at. scales: what the data hold.
        noise: channel to its floor. links: by name, on the rows of the search. full: the same on whole runs.
        refused: link to why it cannot be replayed, though its channels are there.
    """

    runs: tuple[MeasuredRun, ...]
    rows: list[int]
    scales: Scales
    noise: dict[str, float]
    links: dict[str, Link] = field(default_factory=dict)
    full: dict[str, Link] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def make_study(dataset: MeasuredDataset) -> Study:
    """Everything but the wrench link, which waits for the platform: see `wrench_link`."""
    runs = dataset.runs
    noise = _floors(runs)
    study = Study(runs, [_rows(r) for r in runs], _scales(runs, noise), noise)
    reason = uncomputed([r.scenario for r in runs])
    if reason and _all(runs, "wrench_meas", "wrench_comp"):
        study.refused["compensation"] = reason
    yielding = _yielding(study)
    for target, rows in ((study.links, study.rows), (study.full, [r.record.ticks for r in runs])):
        if _all(runs, "pose_cmd", "pose_act") and "platform" not in study.refused:
            target["platform"] = _platform_link(study, yielding, rows)
        if _all(runs, "wrench_meas", "wrench_comp") and "compensation" not in study.refused:
            level = COMPENSATION_FLOOR * max(noise.get("wrench_meas.fz", 0.0), 1e-6) * np.sqrt(CORRELATED)
            target["compensation"] = CompensationLink(
                [_flat_run(r, r.record.data["wrench_comp"], level, n) for r, n in zip(runs, rows, strict=True)],
                [np.ascontiguousarray(r.record.filled("wrench_meas")[:n]) for r, n in zip(runs, rows, strict=True)],
            )
        if _all(runs, "wrench_comp", "pose_cmd"):
            level = DYNAMICS_FLOOR * np.sqrt(CORRELATED)
            target["dynamics"] = DynamicsLink(
                [_flat_run(r, flat_pose(r.record.data["pose_cmd"]), level, n) for r, n in zip(runs, rows, strict=True)],
                [np.ascontiguousarray(r.record.filled("wrench_comp")[:n]) for r, n in zip(runs, rows, strict=True)],
            )
    return study


def _yielding(study: Study) -> list[tuple[Array, Array]]:
    """Of each run (N, 3) how the believed drives depart from their command [m], and (N, 3) how well that is known."""
    if not _all(study.runs, "pose_cmd", "pose_act"):
        return []
    reason = unfollowed(study.runs)
    if reason:
        study.refused["platform"] = reason
        return []
    level, out = study.noise.get("wrench_meas.fz", 0.0), []
    for i, run in enumerate(study.runs):
        none = np.zeros((run.record.ticks, 3))
        found = yields(run, level) if run.scenario.rig.platform.tracking == "servo" else (none, none)
        if found is None:
            study.refused["platform"] = f"the believed servo cannot follow the command on record in run {i}"
            return []
        out.append(found)
    return out


def _platform_link(study: Study, yielding: list[tuple[Array, Array]], rows: Sequence[int]) -> PlatformLink:
    link_runs, commands = [], []
    for run, (_, doubt), n in zip(study.runs, yielding, rows, strict=True):
        link_run = _link_run(run, "pose_act", 3, study.noise, n, PLATFORM_LEAST)
        link_run.sigma = np.hypot(link_run.sigma, doubt[:n])
        link_runs.append(link_run)
        commands.append(np.ascontiguousarray(run.record.filled("pose_cmd")[:n]))
    return PlatformLink(link_runs, commands, [away[:n] for (away, _), n in zip(yielding, rows, strict=True)])


def wrench_link(
    study: Study, paths: Callable[[int], Array], whole: bool = False, jumps: Callable[[int], Array] | None = None
) -> WrenchLink:
    """Contact and sensor on the paths (N, 3) that the tip took in each run; jumps: (N,) [m] of it within a tick."""
    rows = [r.record.ticks for r in study.runs] if whole else study.rows
    least = study.scales.force * np.array([FORCE_LEAST] * 3 + [ARM_LEAST] * 3)
    runs = [_link_run(r, "wrench_meas", 6, study.noise, n, least) for r, n in zip(study.runs, rows, strict=True)]
    within = None if jumps is None else [jumps(i)[:n] for i, n in enumerate(rows)]
    link = WrenchLink(runs, [np.ascontiguousarray(paths(i)[:n]) for i, n in enumerate(rows)], jumps=within)
    row_by_row = whole or jumps is not None or "compensation" in study.links  # which goes on from the contact's rows
    return link if row_by_row else thinned(link)


def _all(runs: Sequence[MeasuredRun], *groups: str) -> bool:
    return all(r.record.has(g) for r in runs for g in groups)


def _rows(run: MeasuredRun) -> int:
    if not run.survey.contacts:
        return run.record.ticks
    end = max(c.end for c in run.survey.contacts)
    return min(run.record.ticks, end + round((TAIL + run.scenario.sensor.delay) * run.scenario.rate))


def touching(run: MeasuredRun, rows: int) -> np.ndarray:
    """(rows,) bool: in contact, or the sensor still shows it."""
    out = np.zeros(run.record.ticks, dtype=bool)
    late = round(run.scenario.sensor.delay * run.scenario.rate) + 3
    for c in run.survey.contacts:
        out[max(0, c.start - 2) : c.end + late] = True
    return out[:rows]


def _link_run(run: MeasuredRun, group: str, parts: int, noise: dict[str, float], rows: int, least: Array | float) -> LinkRun:
    names = _names(group)[:parts]
    level = np.maximum([noise.get(name, 0.0) for name in names], least)
    valid = run.record.valid[group][:rows, :parts]
    sigma = np.where(valid, level, np.inf)
    sigma[0] = np.inf if group == "pose_act" else sigma[0]  # the start pose stands for itself
    return LinkRun(run.scenario, run.record.data[group][:rows, :parts], sigma, touching(run, rows))


def _flat_run(run: MeasuredRun, values: Array, level: float, rows: int) -> LinkRun:
    sigma = np.where(np.isfinite(values[:rows]), level, np.inf)
    return LinkRun(run.scenario, values[:rows], sigma, touching(run, rows))


def _names(group: str) -> tuple[str, ...]:
    from hiltestbed.signals import GROUPS

    return GROUPS[group].columns


def _floors(runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Channel to noise floor: third differences away from contacts, pooled; readings that stand still there tell nothing."""
    floors = {}
    for name in dict.fromkeys(c for r in runs for c in r.record.columns()):
        found, still = [], 0
        for r in runs:
            if not r.record.has(name):
                continue
            values = r.record.column(name)
            outside = values[~touching(r, len(values))] if name.startswith("wrench") and r.survey.contacts else values
            outside = outside if len(outside) > ENOUGH else values  # a latched mechanism is never free
            still += int(len(outside) > 10 and np.median(np.abs(np.diff(outside))) == 0.0)
            found.append(max(white_noise(outside), r.record.steps.get(name, 0.0) / math.sqrt(12.0)))
        level = float(np.sqrt(np.mean(np.square(found)))) if found else 0.0
        if name.startswith("wrench_meas") and still * 2 > len(runs):  # a dead zone, or a sensor that is off between contacts
            believed = runs[0].scenario.sensor.noise if ".f" in name else runs[0].scenario.sensor.torque_noise
            inside = [white_noise(r.record.column(name)[touching(r, r.record.ticks)]) for r in runs if r.survey.contacts]
            level = believed or (float(np.median(inside)) if inside else 0.0)
        floors[name] = level
    places = [n for n in ("pose_act.px", "pose_act.py", "pose_act.pz") if floors.get(n)]
    for name in places:  # a platform that moves in jumps looks noisy on the axis that moves most
        floors[name] = min(floors[name], UNEVEN * min(floors[n] for n in places))
    return floors


def _scales(runs: Sequence[MeasuredRun], noise: dict[str, float]) -> Scales:
    contacts = [c for r in runs for c in r.survey.contacts]
    stiffness = float(np.median([r.scenario.mechanism.contact.stiffness for r in runs]))
    depth = max([c.penetration or 0.0 for c in contacts], default=1e-3) or 1e-3
    force = max([abs(c.peak_force or 0.0) for c in contacts], default=0.0) or stiffness * depth
    speeds = [abs(v) for r in runs for v in r.scenario.approach.velocity if v] or _commanded_speeds(runs) or [0.01]
    peaks = sorted({round(abs(c.peak_force), 6) for c in contacts if c.peak_force}, reverse=True)
    return Scales(
        force, depth, stiffness, runs[0].scenario.tick, noise.get("wrench_meas.fz", 0.01 * force) or 1e-3 * force, min(speeds), max(speeds),
        min(r.record.ticks * r.scenario.tick for r in runs), tuple(peaks[:3]),
        max((float(np.max(np.ptp(r.record.filled("pose_cmd")[:, :3], axis=0))) for r in runs if r.record.has("pose_cmd")), default=0.0),
    )  # fmt: skip


def _commanded_speeds(runs: Sequence[MeasuredRun]) -> list[float]:
    """The largest speed [m/s] that each run commands on any axis."""
    rates = [np.diff(r.record.filled("pose_cmd")[:, :3], axis=0) / r.scenario.tick for r in runs if r.record.has("pose_cmd")]
    return [float(np.max(np.abs(v))) for v in rates if v.any()]
