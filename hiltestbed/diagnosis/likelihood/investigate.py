"""The explanation of each link by one likelihood, in the order in which one helps the next: a force
record that is stamped late shows in the compensation, and where A went in the platform.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hiltestbed.diagnosis.adequacy import Leftover
from hiltestbed.diagnosis.fit import Fit, fit, null_fit
from hiltestbed.diagnosis.investigate import ORDER, Findings, candidates_of, with_stiction
from hiltestbed.diagnosis.lacking import too_little
from hiltestbed.diagnosis.layout import (
    DatasetLayout,
    compensation_link,
    lay_out,
    levels,
    platform_link,
    pose_rounding,
    pose_steps,
    with_noise_beside,
)
from hiltestbed.diagnosis.likelihood.explain import Explained, explain
from hiltestbed.diagnosis.likelihood.model import LinkModel
from hiltestbed.diagnosis.links import (
    CompensationLink,
    DynamicsLink,
    LinkRun,
    ModelLink,
    WrenchLink,
    flat_pose,
)
from hiltestbed.diagnosis.paths import BestPath, best_path, make_wrench_link, too_divergent
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.readings import choose_lever, choose_ring, choose_steps
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Progress, labelled
from hiltestbed.diagnosis.settings import COMPENSATION_FLOOR, CORRELATED_ROWS, DYNAMICS_FLOOR
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import PosteriorFit as LikelyFit
from hiltestbed.inference.model import Hypothesis
from hiltestbed.measured import MeasuredDataset, MeasuredRun, Record
from hiltestbed.replay.compensation import needs
from hiltestbed.sensor.effects import SensorJitter
from hiltestbed.signals import GROUPS

JITTERS = (0.3, 1.0, 3.0)  # [rows] from which a jitter is sought
MANY_LOST = 0.02  # share of the rows
# mean square over that of the floor, from which a computed force is not what the record gives: one
# that is, leaves 1e-20; written digits of which four are right leave 0.02, which the rules know
INEXACT = 0.05
SAME_RATE = 1e-3  # of the loop's rate, by which that of a log may be off
LISTED = 8  # hypotheses of one cause, and of several, that an explanation lists
# of the variance of the noise: what lies between two rows has its own, and a quarter of that of
# each of the two beside
LOST_NOISE = 1.5
FORGOTTEN = 0.01  # of the variance of a reading, below which a compensation has forgotten it
STEP_SIGMA = 1.0 / math.sqrt(12.0)  # of a step, standard deviation of the error by rounding to it


def investigate_by_likelihood(
    dataset: MeasuredDataset, progress: Progress | None = None
) -> Findings:
    """Explain every link that the dataset's channels allow."""
    layout = lay_out(dataset)
    judged = [name for name in ORDER if name not in layout.missing]
    found: dict[str, Explained] = {}
    whole: dict[str, ModelLink] = {}
    missing = dict(layout.missing)

    def told(name: str) -> Progress | None:
        words = f"link {judged.index(name) + 1} of {len(judged)}, {LINK_NAMES[name]}"
        return labelled(progress, words)

    scales = layout.scales
    if "compensation" in judged:
        # of a late record each row is tried: a delay that is a row off fits no better than none
        candidates = likely_candidates(replace(scales, jumps=True), ("compensation", "log"))
        model = LinkModel(compensation(layout, layout.rows))
        found["compensation"] = explain(model, candidates, told("compensation"))
        whole["compensation"] = compensation(layout, layout.whole)
    if "dynamics" in judged:
        model = LinkModel(dynamics(layout, layout.rows))
        found["dynamics"] = explain(
            model, likely_candidates(scales, ("dynamics",)), told("dynamics")
        )
        whole["dynamics"] = dynamics(layout, layout.whole)
    if "platform" in judged:
        link = platform_link(layout, layout.rows)
        candidates = likely_candidates(with_stiction(layout, link)[0], ("platform",))
        found["platform"] = explain(LinkModel(link), candidates, told("platform"))
        whole["platform"] = platform_link(layout, layout.whole)
    if "wrench" in judged:
        layout, path = _path(layout, found)
        if why := too_divergent(layout, path):
            missing["wrench"] = why
        else:
            contact = make_wrench_link(layout, path, layout.rows)
            contact = choose_steps(choose_ring(choose_lever(contact)))
            candidates = _wrench_candidates(
                replace(scales, jumps=contact.jumps is not None),
                found.get("compensation"),
                bool(contact.commands),
            )
            found["wrench"] = explain(LinkModel(contact), candidates, told("wrench"))
            read = found["wrench"].link
            assert isinstance(read, WrenchLink)
            whole["wrench"] = make_wrench_link(layout, path, layout.whole).as_interpreted(read)
    for name, explained in found.items():
        if not explained.departs and (why := too_little(explained.link)):
            missing[name] = why
    order = [name for name in LINK_NAMES if name in found]
    timed = {name: link.with_timing(found[name].timing()) for name, link in whole.items()}
    return Findings(layout, {n: explanation(found[n]) for n in order}, missing, timed)


def log_has_errors(dataset: MeasuredDataset) -> bool:
    """Whether the log has errors of its own: rows are lost, or a computed force differs from what
    the readings on record give by what does not follow it, so that it was computed from others.
    """
    rates = [run.record.sample_rate / run.scenario.rate for run in dataset.runs]
    if any(abs(rate - 1.0) > SAME_RATE for rate in rates):  # its rows are not the loop's ticks
        return False
    for run in dataset.runs:
        for group in ("wrench_comp", "wrench_meas", "pose_cmd", "pose_act"):
            if run.record.has(group) and run.record.lost(group).mean() > MANY_LOST:
                return True
    layout = lay_out(dataset)
    if "compensation" in layout.missing or layout.logged:
        return False
    link = compensation(layout, layout.rows)
    if link.colour() is None:  # it does more than respond linearly to the readings
        return False
    model = LinkModel(link)
    left = model.residuals(Hypothesis((), np.zeros(0), np.zeros(0)))
    rows = sum(map(len, left[:-1]))
    exact = sum(float(x @ x) for x in left[:-1]) <= INEXACT * rows
    return not exact and model.leaves_noise(left)


def explanation(e: Explained) -> Explanation:
    """What a likelihood explains, as the stages that decide and report take it."""
    residual = Residual(e.link.with_timing(e.timing()), e.model.members, e.model.weight)
    null = null_fit(residual)
    chosen = _as_fit(residual, e.fit, again=True) if e.conclusion.causes else null
    by_key = {c.cause.key: c.others for c in e.conclusion.causes}
    rivals = tuple(
        tuple(_as_fit(residual, f) for f in by_key.get(c.key, ())) for c in chosen.causes
    )
    listed = [f for f in e.conclusion.visited if f.causes and np.isfinite(f.evidence)]
    fits = [_as_fit(residual, f) for f in listed[: 2 * LISTED]]
    singles = tuple(f for f in fits if len(f.causes) == 1)[:LISTED]
    more = tuple(f for f in fits if len(f.causes) > 1)[:LISTED]
    left, before = (_leftovers(e, f) for f in (e.fit, e.conclusion.null))
    explained = partial(Explanation, residual, e.candidates, null, chosen, e.adequate, e.departs)
    return explained(left, before, singles, more, rivals)


def _as_fit(residual: Residual, found: LikelyFit, again: bool = False) -> Fit:
    """A fit without its nuisances, ``again`` by least squares."""
    causes, theta, start = [], [], 0
    for c in found.causes:
        own = found.of.theta[start : start + len(c.names)]
        start += len(c.names)
        if c.sigma is None:
            causes.append(c)
            theta.append(own)
    at = np.concatenate([np.zeros(0), *theta])
    if again:
        return fit(residual, causes, [at], tries=1)
    r = residual([c.at(x) for c, x in zip(causes, theta, strict=True)])
    return Fit(tuple(causes), at, float(r @ r), r, np.zeros((len(r), len(at))))


def _leftovers(e: Explained, found: LikelyFit) -> dict[str, Leftover]:
    """Channel to its excess over what noise leaves, in contact or outside it."""
    out: dict[str, Leftover] = {}
    computed = e.model.link.computed
    for (c, _), left in e.model.leftovers(found.left).items():
        excess = e.model.excess(found.left) if computed else left.excess
        name = e.model.link.channels[c]
        if name not in out or excess > out[name].excess:
            out[name] = Leftover(0.0, excess, 1.0, 1.0, 0)
    return out


def likely_candidates(scales: Scales, links: Sequence[str]) -> tuple[Candidate, ...]:
    """The hypotheses of every effect on ``links``; of a jitter as well, which changes the variance
    of a reading more than its mean.
    """
    found = candidates_of(scales, links, rich=None)
    if SensorJitter.link not in links:
        return found
    return (*found, candidate(SensorJitter, {"sigma": [x * scales.tick for x in JITTERS]}))


def _wrench_candidates(
    scales: Scales, late_record: Explained | None, commanded: bool
) -> Sequence[Candidate]:
    """Those of contact and sensor, which the data cannot separate into two links; of the log where
    the compensation shows it late, and then not of a late sensor, or where it was not judged; of
    the platform where only its command is on record.
    """
    links = ["contact", "sensor", *(["platform"] if commanded else [])]
    late = late_record is not None and "log.skew" in late_record.kinds
    if late or late_record is None:
        links.append("log")
    found = likely_candidates(scales, links)
    return [c for c in found if not (late and c.kind == "sensor.delay")]


def _path(layout: DatasetLayout, found: Mapping[str, Explained]) -> tuple[DatasetLayout, BestPath]:
    """The path of A, and the layout with the noise of a latched mechanism's force from what the
    believed contact on that path leaves of the readings.
    """
    platform = found.get("platform")
    path = best_path(layout, None if platform is None else explanation(platform))
    if not any(r.scenario.mechanism.captured for r in layout.runs):
        return layout, path
    link = choose_ring(choose_lever(make_wrench_link(layout, path, layout.whole)))
    shown = link.shown_in_all()
    return with_noise_beside(layout, shown), path


def compensation(layout: DatasetLayout, rows: Sequence[int]) -> CompensationLink:
    """The compensation on the first ``rows`` of each run; that of the rules where it does not
    respond linearly to the readings. Rows do not count that depend on readings which are not on
    record: one wrong reading shows in many rows of the output.
    """
    noise = levels(layout, "wrench_meas")
    level = COMPENSATION_FLOOR * max(noise[2], 1e-6) * math.sqrt(CORRELATED_ROWS)
    pairs = list(zip(layout.runs, rows, strict=True))
    groups = {g for r in layout.runs for g in needs(r.scenario)} - {"wrench_meas"}
    if groups or layout.logged:
        return compensation_link(layout, rows)
    wrenches = [np.ascontiguousarray(r.record.filled("wrench_meas")[:n]) for r, n in pairs]
    first = [_computed(r, r.record.data["wrench_comp"], level, n) for r, n in pairs]
    link, runs = CompensationLink(first, wrenches, {}), []
    for (r, n), run in zip(pairs, first, strict=True):
        own = r.record.rounding("wrench_comp")[:n]
        passed = link.passed(input_variance(r.record, "wrench_meas", noise)[:n])
        sigma = np.sqrt(run.sigma**2 + own**2 + passed)
        bridged = np.where(r.record.lost("wrench_meas")[:n, None], noise**2, 0.0)
        sigma[link.passed(bridged) > FORGOTTEN * noise**2] = np.inf
        sigma[:, [name in r.record.absent for name in GROUPS["wrench_meas"].columns]] = np.inf
        runs.append(replace(run, sigma=sigma))
    return CompensationLink(runs, wrenches, {})


def dynamics(layout: DatasetLayout, rows: Sequence[int]) -> DynamicsLink:
    """The numerical model on the first ``rows`` of each run."""
    level = DYNAMICS_FLOOR * math.sqrt(CORRELATED_ROWS)
    noise, runs, wrenches, variance = levels(layout, "wrench_comp"), [], [], []
    for r, n in zip(layout.runs, rows, strict=True):
        run = _computed(r, flat_pose(r.record.data["pose_cmd"]), level, n)
        written, quantised = pose_rounding(r, "pose_cmd")[:n], pose_steps(r, "pose_cmd")
        runs.append(replace(run, sigma=np.sqrt(run.sigma**2 + written**2 + quantised**2)))
        wrenches.append(np.ascontiguousarray(r.record.filled("wrench_comp")[:n]))
        variance.append(input_variance(r.record, "wrench_comp", noise)[:n])
    link = DynamicsLink(runs, wrenches)
    return link.with_input_errors(variance) if any(v.any() for v in variance) else link


def input_variance(record: Record, group: str, noise: Array) -> Array:
    """(ticks, 6) variance of the errors of recorded wrenches, where they are the input of a link:
    of written digits, of converter steps, and of what bridges lost rows: noise, and the difference
    of the rows beside, by as much as which a reading jumps at a touch. ``noise``: (6,) of it.
    """
    out = record.rounding(group) ** 2
    for j, name in enumerate(GROUPS[group].columns):
        if name in record.absent:
            continue
        out[:, j] += (STEP_SIGMA * record.steps.get(name, 0.0)) ** 2
        known = np.flatnonzero(record.measured(name))
        lost = record.lost(group) & ~record.measured(name)
        if not lost.any() or not len(known):
            continue
        values = record.column(name)[known]
        at = np.searchsorted(known, np.flatnonzero(lost))
        before, after = values[np.maximum(at - 1, 0)], values[np.minimum(at, len(known) - 1)]
        inside = (at > 0) & (at < len(known))
        error = np.where(inside, np.abs(after - before), np.maximum(abs(before), abs(after)))
        # the errors of one stretch are alike
        edges = np.flatnonzero(np.diff(np.r_[False, lost, False])).reshape(-1, 2)
        length = np.repeat(edges[:, 1] - edges[:, 0], edges[:, 1] - edges[:, 0])
        out[lost, j] += length * error**2 + LOST_NOISE * noise[j] ** 2
    return out


def _computed(run: MeasuredRun, values: Array, level: float, rows: int) -> LinkRun:
    sigma = np.where(np.isfinite(values[:rows]), level, np.inf)
    return LinkRun(run.scenario, np.nan_to_num(values[:rows]), sigma, run.touching(rows))
