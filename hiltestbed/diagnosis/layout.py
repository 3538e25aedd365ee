"""Stage "layout": from a measured dataset to a `DatasetLayout`: rows and noise floors, the logger's
filter, which links can be judged, and the orders of magnitude from which a search takes its starts
and bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.floors import floors
from hiltestbed.diagnosis.lacking import every_run_has, lacking
from hiltestbed.diagnosis.links import CompensationLink
from hiltestbed.diagnosis.low_pass import LowPass, low_pass_between
from hiltestbed.diagnosis.noise import force_noise
from hiltestbed.diagnosis.recorded import DatasetLayout, compensation_link, rms_differences
from hiltestbed.diagnosis.yielding import Deflection, deflection, engagement
from hiltestbed.effects.search import Scales
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset, MeasuredRun
from hiltestbed.replay import Engaged

# chosen: [s] after the last contact that the search includes, where charge leakage and ringing show
TAIL_TIME = 0.15
# chosen: of the computed force, above which a compensation on differentiated poses shows nothing
MAX_RATE_ERROR = 0.1


def lay_out(dataset: MeasuredDataset) -> DatasetLayout:
    """Rows, noise floors and scales of a dataset, and which links can be replayed."""
    runs = dataset.runs
    force = force_noise(runs)
    noise = floors(runs) | force.levels()
    missing, given, lost = lacking(runs), None, None
    if "platform" not in missing:
        given, lost = _deflections(runs, noise, [engagement(r) for r in runs])
        if lost is not None:
            why = f"the believed rig cannot follow the command on record in {lost}"
            missing["platform"] = why
    elif (
        "wrench" not in missing
        and not every_run_has(runs, "pose_act")
        and every_run_has(runs, "pose_cmd")
    ):
        # in place of the pose that was not measured
        given, lost = _deflections(runs, noise, [None] * len(runs))
        if lost is not None:
            why = f"the believed rig cannot follow the command on record in {lost}"
            missing["wrench"] = f"needs pose_act: {why}"
    rows, scales = tuple(_rows(r) for r in runs), scales_of(runs, noise)
    layout = DatasetLayout(runs, rows, scales, noise, force, given, missing)
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
    computed = np.concatenate(link.shown_in_all())[:, :3]
    missed = np.concatenate(rms_differences(link, other))[:, :3]
    return float(np.linalg.norm(missed) / max(np.linalg.norm(computed), 1e-12))


def _logger_filter(link: CompensationLink) -> LowPass | None:
    """The filter through which the force went to the log but not to the loop, if any."""
    known = [np.asarray(np.isfinite(run.sigma).all(axis=1)) for run in link.runs]
    return low_pass_between([run.measured for run in link.runs], link.shown_in_all(), known)


def with_noise_beside(layout: DatasetLayout, shown: Sequence[Array]) -> DatasetLayout:
    """The same with a latched mechanism's noise beside readings ``shown`` (N, 6) by the contact."""
    force, before = force_noise(layout.runs, layout.logged, shown), layout.force.levels()
    others = {c: v for c, v in layout.noise.items() if c not in before}
    return replace(layout, force=force, noise=floors(layout.runs) | others | force.levels())


def _deflections(
    runs: Sequence[MeasuredRun], noise: Mapping[str, float], engaged: Sequence[Engaged | None]
) -> tuple[tuple[Deflection, ...] | None, str | None]:
    """The believed rig's departure from its command in each run, or a run it cannot follow."""
    found = []
    for run, acts in zip(runs, engaged, strict=True):
        one = deflection(run, noise.get("wrench_meas.fz", 0.0), engaged=acts)
        if one is None:
            return None, run.name
        found.append(one)
    return tuple(found), None


def _rows(run: MeasuredRun) -> int:
    if not run.survey.contacts:
        return run.record.ticks
    end = max(c.end for c in run.survey.contacts)
    tail = round((TAIL_TIME + run.scenario.sensor.delay) * run.scenario.rate)
    return min(run.record.ticks, end + tail)


def scales_of(runs: Sequence[MeasuredRun], noise: Mapping[str, float]) -> Scales:
    """Scales of a dataset; ``noise``: channel to its floor."""
    contacts = [c for r in runs for c in r.survey.contacts]
    first, commands = runs[0].scenario, _commands(runs)
    stiffness = float(np.median([r.scenario.mechanism.contact.stiffness for r in runs]))
    force = max([abs(c.peak_force or 0.0) for c in contacts], default=0.0)
    depth = force / stiffness
    # measured on a flat surface, else derived from the peak force
    if first.mechanism.flat or first.mechanism.captured or not depth:
        depth = max([c.penetration or 0.0 for c in contacts], default=1e-3) or 1e-3
    force = force or stiffness * depth
    speeds = [abs(v) for r in runs for v in r.scenario.approach.velocity if v]
    if not speeds:  # the largest that each run commands on any axis
        rates = [np.abs(np.diff(c, axis=0)) / r.scenario.tick for c, r in commands]
        speeds = [float(v.max()) for v in rates if v.any()] or [0.01]
    peaks = sorted({round(abs(c.peak_force), 6) for c in contacts if c.peak_force}, reverse=True)
    return Scales(
        force=force,
        depth=depth,
        stiffness=stiffness,
        tick=first.tick,
        noise=noise.get("wrench_meas.fz", 0.01 * force) or 1e-3 * force,
        slow=min(speeds),
        fast=max(speeds),
        duration=min(r.record.ticks * r.scenario.tick for r in runs),
        reading=tuple(peaks[:3]),
        travel=max((float(np.ptp(c, axis=0).max()) for c, _ in commands), default=0.0),
        substeps=first.substeps,
        captured=first.mechanism.captured,
        slides=_slides(runs),
    )


def _commands(runs: Sequence[MeasuredRun]) -> list[tuple[Array, MeasuredRun]]:
    """(N, 3) commanded positions [m], and the run."""
    return [(r.record.filled("pose_cmd")[:, :3], r) for r in runs if r.record.has("pose_cmd")]


def _slides(runs: Sequence[MeasuredRun]) -> bool:
    mechanism = runs[0].scenario.mechanism
    curved = not (mechanism.flat or mechanism.captured)
    lateral = any(any(r.scenario.approach.velocity[:2]) for r in runs)
    return lateral or mechanism.contact.friction > 0 or curved
