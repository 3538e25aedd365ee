"""From a measured dataset to an explanation of each link, in the order in which one link's finding helps the next."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from hiltestbed.diagnosis.adequacy import Leftover
from hiltestbed.diagnosis.candidates import (
    Candidate,
    compensation_candidates,
    contact_candidates,
    dynamics_candidates,
    platform_candidates,
    sensor_candidates,
    skew_candidates,
)
from hiltestbed.diagnosis.compensated import noise_gain
from hiltestbed.diagnosis.fit import Fit, Residual, fit, refit
from hiltestbed.diagnosis.links import CompensationLink, Effects, Link, PlatformLink, WrenchLink, unstamped
from hiltestbed.diagnosis.search import ALARM, JITTER, Explanation, inflation, jitter_beside, null_fit, search
from hiltestbed.diagnosis.stiction import stick_starts
from hiltestbed.diagnosis.study import CORRELATED, DYNAMICS_FLOOR, Study, make_study, wrench_link
from hiltestbed.diagnosis.tones import tone_beside, tones
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset

SMOOTH = 31  # rows of the Savitzky-Golay filter, order 3, where only a noisy pose is left to go by
CHOICE = 2.0 * math.log(2.0)  # of chi-square: the price of one of two readings
RELATIVE = 0.01  # of the departure of a computed channel that an explanation may leave
UNEXPLAINED = 0.2  # of what a late record does to the compensation, that its interpolation between rows may leave
LEAD_NOISE = 1.7  # times the led noise, up to which a residual of the compensation may be noise of the record

Progress = Callable[[str], None]


@dataclass
class Findings:
    """What was found, link by link.

    Attributes:
        study: the data as laid out. explanations: link to its explanation. residuals: link to what was fitted.
        weighed: link to the candidates that were searched.
        missing: link to why it could not be replayed.
    """

    study: Study
    explanations: dict[str, Explanation] = field(default_factory=dict)
    residuals: dict[str, Residual] = field(default_factory=dict)
    weighed: dict[str, list[Candidate]] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)


def investigate(dataset: MeasuredDataset, progress: Progress | None = None) -> Findings:
    """Explain every link that the dataset's channels allow."""
    study = make_study(dataset)
    out = Findings(study)
    for name, ends in (
        ("platform", "pose_cmd, pose_act"),
        ("compensation", "wrench_meas, wrench_comp"),
        ("dynamics", "wrench_comp, pose_cmd"),
    ):
        if name not in study.links:
            out.missing[name] = study.refused.get(name, f"needs {ends} in every run")
    s = study.scales
    if "platform" in study.links:
        _explain(out, "platform", _platform_candidates(study), progress)
    if "compensation" in study.links:
        _explain_compensation(out, compensation_candidates(s), progress)
    _investigate_wrench(out, progress)
    if "dynamics" in study.links:
        residual, candidates = Residual(study.links["dynamics"]), dynamics_candidates(s.tick)
        judge, told = _dynamics_judge(residual), _named(progress, "dynamics")
        out.explanations["dynamics"] = search(residual, candidates, judge, progress=told)
        out.residuals["dynamics"], out.weighed["dynamics"] = residual, candidates
    return out


def _explain(out: Findings, name: str, candidates: list[Candidate], progress: Progress | None) -> None:
    residual = Residual(out.study.links[name])
    out.explanations[name] = search(residual, candidates, progress=_named(progress, name))
    out.residuals[name], out.weighed[name] = residual, candidates


def _platform_candidates(study: Study) -> list[Candidate]:
    """Those of the platform, with starts for stiction that the data tell."""
    link, substeps = _platform(study.links), study.runs[0].scenario.substeps
    noise = min((level for c in link.channels if (level := study.noise.get(c))), default=0.0)
    return platform_candidates(study.scales, substeps, stick_starts(link, noise, substeps))


def _platform(links: Mapping[str, Link]) -> PlatformLink:
    """The platform among `links`, which hold it where its two ends were measured."""
    link = links["platform"]
    if not isinstance(link, PlatformLink):
        raise TypeError(f"links['platform'] is a {type(link).__name__}; allowed is a PlatformLink")
    return link


def _compensation(links: Mapping[str, Link]) -> CompensationLink:
    """The compensation among `links`, which hold it where its two ends were measured."""
    link = links["compensation"]
    if not isinstance(link, CompensationLink):
        raise TypeError(f"links['compensation'] is a {type(link).__name__}; allowed is a CompensationLink")
    return link


def _wrench(residual: Residual) -> WrenchLink:
    """Contact and sensor, of which `residual` is."""
    if not isinstance(residual.link, WrenchLink):
        raise TypeError(f"a residual of the link {residual.link.name} (got {type(residual.link).__name__}); allowed is a WrenchLink")
    return residual.link


def _named(progress: Progress | None, link: str) -> Progress | None:
    return (lambda text: progress(f"{link}: {text}")) if progress else None


def _investigate_wrench(out: Findings, progress: Progress | None) -> None:
    study = out.study
    reason = _no_wrench(study)
    if reason:
        out.missing["wrench"] = reason
        return
    link = choose_lever(study, make_wrench_link(out))
    candidates = _wrench_candidates(study, link)
    if "compensation" not in out.explanations:
        candidates += skew_candidates(study.scales.tick)
    residual, given = Residual(link), _stamped_late(out, link)
    if given:  # which the contact alone cannot tell from a late sensor
        candidates = [c for c in candidates if c.effect != "sensor.delay"]
    found = _search_wrench(residual, candidates, given[0] if given else None, progress)
    if given and not found.adequate and _other_reading_betters(residual, found.chosen, given[1]):
        residual = Residual(link)
        found = _search_wrench(residual, candidates, given[1], progress)
    elif not given and (other := _on_a_grid(residual, found)):
        residual = Residual(other)
        found = _search_wrench(residual, candidates, None, progress)
    out.explanations["wrench"], out.residuals["wrench"] = found, residual
    out.weighed["wrench"] = [*candidates, *(given[0].causes if given else ())]
    if given:
        _settle_compensation(out, progress)


def _on_a_grid(residual: Residual, found: Explanation) -> WrenchLink | None:
    """The link where readings lie between the instants of the believed physics, if what was found, or nothing, fits better there."""
    link = _wrench(residual)
    if not found.alarm or JITTER in {c.effect for c in found.chosen.causes}:
        return None
    other = copy(link)
    other.grid = link.runs[0].scenario.substeps
    there = residual.through(other)
    fits = [null_fit(there), *([refit(there, found.chosen)] if found.chosen.causes else [])]
    return other if min(f.score for f in fits) < found.chosen.score - CHOICE else None


def _search_wrench(residual: Residual, candidates: list[Candidate], given: Fit | None, progress: Progress | None) -> Explanation:
    special = [jitter_beside, tone_beside]
    return search(residual, candidates, special=special, progress=_named(progress, "contact and sensor"), given=given)


def _stamped_late(out: Findings, link: WrenchLink) -> list[Fit]:
    """A record that is stamped late, in each of its readings, the likelier first; none where the compensation shows no such thing.

    The compensation tells the delay to a tick. A contact that does not bear it out may hide it: a late reading is a damper's lack.
    """
    comp = out.explanations.get("compensation")
    delay = next((p["delay"] for kind, p in comp.chosen.effects() if kind == "log.skew"), None) if comp else None
    if comp is None or delay is None:
        return []
    residual = Residual(link)
    fits = sorted((fit(residual, (c,), c.grid) for c in skew_candidates(out.study.scales.tick, delay)), key=lambda f: f.chi2)
    residual.beware(fits[0].effects())
    fits = [refit(residual, f) for f in fits]
    borne_out = null_fit(residual).chi2 - fits[0].chi2 > ALARM
    return fits if borne_out or comp.chosen.chi2 < UNEXPLAINED * comp.null.chi2 else []


def _other_reading_betters(residual: Residual, chosen: Fit, other: Fit) -> bool:
    """Whether `chosen`, whose first cause is a record stamped late, fits better with the reading of `other` for it."""
    causes = (*other.causes, *chosen.causes[1:])
    if any(c.effect == JITTER for c in causes):
        return False
    return fit(residual, causes, [chosen.theta], tries=1).chi2 < chosen.chi2 - ALARM * inflation(chosen)


def _settle_compensation(out: Findings, progress: Progress | None) -> None:
    """The compensation again, where the contact has told how late the record is: with the readings that the loop used."""
    study, found = out.study, out.explanations["wrench"]
    skew = next((p["delay"] for kind, p in found.chosen.effects() if kind == "log.skew"), None)
    if skew is None or not found.adequate:
        return
    effects, ticks = found.chosen.effects(), round(skew / study.scales.tick)
    in_time = [(kind, p) for kind, p in effects if kind != "log.skew"]
    for links, whole in ((study.links, False), (study.full, True)):
        wrench, link = make_wrench_link(out, whole), _compensation(links)
        found_link = _wrench(out.residuals["wrench"])
        wrench.lever, wrench.grid = found_link.lever, found_link.grid
        pairs = enumerate(wrench.runs)
        link.used = [unstamped(run, wrench.predict(i, effects), wrench.predict(i, in_time), ticks) for i, run in pairs]
        for run in link.runs:
            run.sigma[len(run.sigma) - ticks :] = np.inf  # what the loop read last was not stamped within the record
    late = Candidate("log.skew", (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), {"delay": skew})
    _explain_compensation(out, [c for c in compensation_candidates(study.scales) if c.effect != "log.skew"] + [late], progress)


def _explain_compensation(out: Findings, candidates: list[Candidate], progress: Progress | None) -> None:
    residual = Residual(out.study.links["compensation"])
    out.explanations["compensation"] = search(
        residual, candidates, _compensation_judge(out.study), progress=_named(progress, "compensation")
    )
    out.residuals["compensation"], out.weighed["compensation"] = residual, candidates


def full_links(out: Findings) -> dict:
    """The links on whole runs."""
    links = {name: link for name, link in out.study.full.items() if name in out.explanations}
    if "wrench" in out.explanations:
        wrench = make_wrench_link(out, whole=True)
        found = _wrench(out.residuals["wrench"])
        wrench.lever, wrench.grid = found.lever, found.grid
        links["wrench"] = wrench
    return links


def _no_wrench(study: Study) -> str | None:
    runs = study.runs
    if not all(r.record.has("wrench_meas") for r in runs):
        return "needs wrench_meas in every run"
    if not all(r.record.has("pose_act") or r.record.has("pose_cmd") for r in runs):
        return "needs pose_act or pose_cmd in every run"
    if any(r.scenario.mechanism.kind == "probe_cone" for r in runs):
        return "a probe in a cone is not replayed"
    if any(r.scenario.mechanism.mount is not None for r in runs):
        return "a compliant mount is not replayed"
    if not any(r.survey.contacts for r in runs):
        return "needs a contact"
    return None


def make_wrench_link(out: Findings, whole: bool = False) -> WrenchLink:
    """Contact and sensor on the path through the explained platform; on the smoothed pose where the platform is not explained."""
    study = out.study
    platform = out.explanations.get("platform")
    if platform is not None and platform.adequate:
        effects = platform.chosen.effects()
        full = _platform(study.full)
        sticks = any(kind == "platform.friction" for kind, _ in effects)
        return wrench_link(study, lambda i: full.path(i, effects), whole, (lambda i: _jumps(full.path(i, effects))) if sticks else None)
    clean = platform is None and not any(r.record.has("pose_act") for r in study.runs)
    link = wrench_link(study, lambda i: _smooth_path(out, i), whole)
    if not clean:
        _widen(study, link)
    return link


def _jumps(path: Array) -> Array:
    """(N,) how far a tip that sticks and jumps along path (N, 3) moved [m] in the tick that ends at each row."""
    return np.linalg.norm(np.diff(path, axis=0, prepend=path[:1]), axis=1)


def _smooth_path(out: Findings, i: int) -> Array:
    run = out.study.runs[i]
    if not run.record.has("pose_act"):  # the commanded pose, one row on: ideal tracking believed
        command = run.record.filled("pose_cmd")[:, :3]
        a = run.scenario.approach
        return np.concatenate([[[*a.offset, -a.gap]], command[:-1]])
    measured = run.record.filled("pose_act")[:, :3]
    platform = out.explanations.get("platform")
    if platform is None:
        return np.asarray(savgol_filter(measured, SMOOTH, 3, axis=0))
    near = _platform(out.study.full).path(i, platform.chosen.effects())
    return near + np.asarray(savgol_filter(measured - near, SMOOTH, 3, axis=0))


def _widen(study: Study, link: WrenchLink) -> None:
    """Add what the noise of a smoothed pose makes of k x + c v to the noise of the readings in contact."""
    noise = study.noise.get("pose_act.pz", 0.0)
    for run in link.runs:
        contact, tick = run.scenario.mechanism.contact, study.scales.tick
        place = float(np.linalg.norm(savgol_coeffs(SMOOTH, 3))) * noise
        rate = float(np.linalg.norm(savgol_coeffs(SMOOTH, 3, deriv=1))) * noise / tick
        extra = 2.0 * math.hypot(contact.stiffness * place, contact.damping * rate)
        run.sigma = np.where(run.touching[:, None] & (np.arange(6) < 3), np.hypot(run.sigma, extra), run.sigma)


def choose_lever(study: Study, link: WrenchLink) -> WrenchLink:
    """Where between tip and surface the force acts: the reading of the geometry that the torques bear out."""
    if all(r.scenario.mechanism.contact.friction == 0.0 for r in study.runs):
        return link
    costs = {}
    for lever in (0.5, 0.0, 1.0):
        link.lever = lever
        r = Residual(link)(())
        costs[lever] = float(np.sum(np.minimum(r * r, 100.0)))
    link.lever = min(costs, key=lambda key: costs[key])
    return link


def _wrench_candidates(study: Study, link: WrenchLink) -> list[Candidate]:
    first = study.runs[0].scenario
    lateral = any(any(r.scenario.approach.velocity[:2]) for r in study.runs)
    contact = contact_candidates(study.scales, first.mechanism.kind == "latched", lateral or first.mechanism.contact.friction > 0)
    return contact + sensor_candidates(study.scales, tones(link))


def _compensation_judge(study: Study) -> Callable:
    """Computed, not measured: the residual is nothing, or led noise of the record, no larger in contact than out of it."""
    run = study.runs[0].scenario
    gain = noise_gain(run)

    def judge(residual: Residual, effects: Effects) -> dict[str, Leftover]:
        out = {}
        z = [residual.of_run(i, effects) for i in residual.runs]
        for c, name in enumerate(residual.link.channels):
            level = residual.link.runs[residual.runs[0]].sigma[0, c]
            inside = np.concatenate([r[residual.link.runs[i].touching, c] for i, r in zip(residual.runs, z, strict=True)])
            outside = np.concatenate([r[~residual.link.runs[i].touching, c] for i, r in zip(residual.runs, z, strict=True)])
            rms_in, rms_out = (float(np.sqrt(np.mean(x * x))) * level if len(x) else 0.0 for x in (inside, outside))
            noise = study.noise.get(name.replace("comp", "meas"), 0.0)
            apart = rms_out if len(outside) > SMOOTH else rms_in  # a latched mechanism is never free
            if any(kind == "log.skew" for kind, _ in effects):  # what the loop read is known from a late record but for its noise
                apart = gain * noise
            floor = max(level / math.sqrt(CORRELATED), min(apart, LEAD_NOISE * gain * noise))
            out[name] = Leftover((max(rms_in, rms_out) / floor) ** 2, 0.0, 1.3, 1.0, len(inside))
        return out

    return judge


def _dynamics_judge(residual: Residual) -> Callable:
    """Computed: nothing but what integrators may differ by, or a hundredth of the departure that was explained."""
    departures = _rms(residual, ())

    def judge(_: Residual, effects: Effects) -> dict[str, Leftover]:
        out = {}
        for name, rms, departure in zip(residual.link.channels, _rms(residual, effects), departures, strict=True):
            allowed = max(DYNAMICS_FLOOR, RELATIVE * departure if effects else 0.0)
            out[name] = Leftover((rms / allowed) ** 2, 0.0, 1.0, 1.0, len(residual.runs))
        return out

    return judge


def _rms(residual: Residual, effects: Effects) -> list[float]:
    z = np.concatenate([residual.of_run(i, effects) for i in residual.runs])
    return [float(v) * DYNAMICS_FLOOR * math.sqrt(CORRELATED) for v in np.sqrt(np.mean(z * z, axis=0))]
