"""From the layout of a dataset to an explanation of each link, in the order in which one link's finding helps the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis import judges
from hiltestbed.diagnosis.all_rows import on_all_rows
from hiltestbed.diagnosis.driven import ALONG_AN_AXIS, WAY, axis_link, mass_and_force, one_force
from hiltestbed.diagnosis.fit import Fit, fit, inflation, nothing, refit
from hiltestbed.diagnosis.jitter import JITTER, jitter_beside
from hiltestbed.diagnosis.layout import Layout, compensation_link, dynamics_link, lay_out, platform_link, under
from hiltestbed.diagnosis.lines import hum_beside, lines
from hiltestbed.diagnosis.links import AxisLink, CompensationLink, Later, Link, LinkRun, PlatformLink, WrenchLink
from hiltestbed.diagnosis.paths import BestPath, best_path, between_rows, compared, filtered, make_wrench_link, unmoved
from hiltestbed.diagnosis.readings import (
    another_lever,
    at_a_point,
    choose_lever,
    choose_ring,
    choose_steps,
    lever_under,
    on_a_grid,
    other_steps,
    reading_under,
    wrench_link_of,
)
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.richer import Richer
from hiltestbed.diagnosis.search import Explanation, Progress, Search
from hiltestbed.diagnosis.settings import DETECTION, LEAST_COMPARED, MOST_NOISE, RECORD_LEFT
from hiltestbed.diagnosis.stiction import stick_starts
from hiltestbed.diagnosis.timing import FARTHEST, clocks_off, in_its_place, part_of_a_tick, place_under, stands_best
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.log import log_parameters
from hiltestbed.measured import MeasuredDataset
from hiltestbed.replay import follows_exactly
from hiltestbed.replay.wrench import shifted

RESTARTED = 0.9  # of chi-square, that another reading of the start has to leave at most to be taken
REFUTED = 0.25  # of a skew that the compensation shows: where contact and sensor show less, it is not the force's
AS_IF_MOVED = ("sensor.delay", "contact.damping", "contact.stiffness", "sensor.lag")  # what a path that is shifted in time looks like
WRENCH = ("contact", "sensor")  # links of the vocabulary that act between the pose and the reading


@dataclass(frozen=True)
class Findings:
    """What was found, link by link.

    Attributes:
        layout: the data as laid out. explanations: link to its explanation. missing: link to why it was not judged.
        whole: link on whole runs, to show what is left.
    """

    layout: Layout
    explanations: dict[str, Explanation]
    missing: dict[str, str]
    whole: dict[str, Link]

    @property
    def noise(self) -> dict[str, float]:
        """Channel to its floor."""
        return dict(self.layout.noise)


def investigate(dataset: MeasuredDataset, progress: Progress | None = None) -> Findings:
    """Explain every link that the dataset's channels allow."""
    layout = lay_out(dataset)
    found: dict[str, Explanation] = {}
    whole: dict[str, Link] = {}
    if "platform" not in layout.missing:
        link = platform_link(layout, layout.rows)
        found["platform"] = _explain_platform(layout, link, _told(progress, "platform"))
        whole["platform"] = platform_link(layout, layout.whole).stamped(found["platform"].residual.link.timing)
    if "compensation" not in layout.missing:
        candidates = _candidates(layout.scales, ("compensation", "log"))
        found["compensation"] = _explain_compensation(layout, compensation_link(layout, layout.rows), candidates, progress)
        whole["compensation"] = compensation_link(layout, layout.whole).stamped(found["compensation"].residual.link.timing)
    missing = dict(layout.missing)
    if "wrench" not in missing:
        if why := _investigate_wrench(layout, found, whole, progress):
            missing["wrench"] = why
        else:
            layout = _settle_platform(layout, found, whole, progress)
    if "dynamics" not in layout.missing:
        if layout.scales.driven is None:
            residual = Residual(dynamics_link(layout, layout.rows))
            search = Search(_candidates(layout.scales, ("dynamics",)), judges.of_dynamics(residual), (), _told(progress, "numerical model"))
            found["dynamics"] = in_its_place(residual, search)
            whole["dynamics"] = dynamics_link(layout, layout.whole).stamped(found["dynamics"].residual.link.timing)
        else:
            found["dynamics"], whole["dynamics"] = _explain_axis(layout, _told(progress, "driven axis"))
    return Findings(layout, found, missing, whole)


def _candidates(scales: Scales, links: Sequence[str], rich: bool = False) -> tuple[Candidate, ...]:
    """The hypotheses of every effect that acts on one of ``links``; of those that are ``rich`` in numbers, or of the others."""
    return tuple(c for effect in EFFECTS.values() if effect.link in links and effect.rich == rich for c in effect.candidates(scales))


def _told(progress: Progress | None, link: str) -> Progress | None:
    return (lambda text: progress(f"{link}: {text}")) if progress else None


def _explain_platform(layout: Layout, link: PlatformLink, progress: Progress | None) -> Explanation:
    """With starts for stiction that the data tell."""
    noise = min((level for c in link.channels[:3] if (level := layout.noise.get(c))), default=0.0)
    scales = replace(layout.scales, sticks=stick_starts(link, noise, layout.scales.substeps))
    search = Search(_candidates(scales, ("platform",)), progress=progress, reread=place_under)
    found = in_its_place(Residual(link), search)
    richer = Richer(search, _candidates(scales, ("platform",), rich=True))
    other = richer.in_place_of(found)
    there = found.residual if other is found else place_under(other.residual, other.chosen)
    if there is other.residual:
        return other
    placed = richer.in_place_of(found, there)
    return other if placed is found else placed


def _explain_axis(layout: Layout, progress: Progress | None) -> tuple[Explanation, AxisLink]:
    """A mass that a force drives: its mass and what resists it, sought together from where a regression starts."""
    link = axis_link(layout.runs)
    candidates = tuple(c for c in _candidates(layout.scales, ("dynamics",)) if c.kind in ALONG_AN_AXIS)
    search = Search(one_force(candidates), judges.of_axis(link), (mass_and_force(candidates),), progress, beside=math.inf)
    explanation = search.explain(Residual(link.over(WAY)))
    if explanation.chosen.causes:
        again = link.restarted(explanation.chosen.effects())
        if refit(Residual(again.over(WAY)), explanation.chosen).chi2 < RESTARTED * explanation.chosen.chi2:
            return search.explain(Residual(again.over(WAY))), again
    return explanation, link


def _explain_compensation(
    layout: Layout, link: CompensationLink, candidates: Sequence[Candidate], progress: Progress | None
) -> Explanation:
    judge = judges.of_compensation(link, layout.noise)
    search = Search(tuple(candidates), judge, (), _told(progress, "compensation"))
    led = [link.noise_gain() * layout.noise.get(name.replace("comp", "meas"), 0.0) for name in link.channels]
    return in_its_place(Residual(link), search, weigh=lambda residual: residual.doubted(np.array(led)))


def _investigate_wrench(layout: Layout, found: dict[str, Explanation], whole: dict[str, Link], progress: Progress | None) -> str | None:
    """Contact and sensor, which are one link to the data; and the compensation again where the record proves to be stamped late.

    Returns why the data say nothing of them; None where they do.
    """
    path = _choose_path(layout, found, whole, progress)
    if (part := compared(layout, path)) < LEAST_COMPARED:
        return f"the least of causes decides what the mechanism does from the touch on: {part:.0%} of the rows in contact could be replayed"
    link = choose_steps(choose_ring(choose_lever(make_wrench_link(layout, path, layout.rows, decimate="compensation" not in found))))
    scales = replace(layout.scales, lines=lines(link))
    unseen = ("platform",) if link.commands else ()  # what it does is in the path then
    candidates = _candidates(scales, (*WRENCH, *unseen) if "compensation" in found else (*WRENCH, *unseen, "log"))
    given = _stamped_late(layout, link, found.get("compensation"))
    if given and _by_its_stamp(layout, link, found, whole, given[0], progress):
        given = []
    if given:  # which the contact alone cannot tell from a late sensor
        candidates = tuple(c for c in candidates if c.kind != "sensor.delay")
        levered = wrench_link_of(lever_under(Residual(link), given[0]))
        if levered is not link:
            link, given = levered, _stamped_late(layout, levered, found["compensation"]) or given
    residual = Residual(link)
    search = Search(candidates, special=(jitter_beside, hum_beside), progress=_told(progress, "contact and sensor"), reread=reading_under)
    late = given[0] if given else None
    explanation = in_its_place(residual, search, lambda there: search.explain(there, late), not given and clocks_off(found))
    if levered := another_lever(explanation):
        residual = Residual(levered)
        given = given and (_stamped_late(layout, levered, found["compensation"]) or given)
        explanation = search.explain(residual, given[0] if given else None)
    if not given and (stepped := other_steps(explanation)):
        explanation = search.explain(Residual(stepped))
    if not given and (pointed := at_a_point(explanation)):
        explanation = search.explain(Residual(pointed))
    if given and not explanation.adequate and _other_reading_betters(explanation, given[1]):
        explanation = search.explain(residual, given[1])
    elif not given and (other := on_a_grid(explanation)):
        explanation = search.explain(Residual(other))
    if given:
        explanation = replace(explanation, candidates=(*candidates, *given[0].causes))
    chosen = wrench_link_of(explanation.residual)
    if tuple(run.rows for run in chosen.runs) != tuple(layout.rows):
        everything = make_wrench_link(layout, path, layout.rows)
        explanation = on_all_rows(explanation, everything.as_read(chosen))
    found["wrench"] = explanation
    whole["wrench"] = make_wrench_link(layout, path, layout.whole).as_read(chosen)
    if given:
        _settle_compensation(layout, path, found, whole, progress)
    return None


def _choose_path(layout: Layout, found: dict[str, Explanation], whole: dict[str, Link], progress: Progress | None) -> BestPath:
    """The path that contact and sensor bear out, of those that the platform leaves open; the platform as that path has it."""
    best = best_path(layout, found.get("platform"))
    if other := unmoved(layout, found.get("platform"), best):
        links = [choose_lever(make_wrench_link(layout, between_rows(layout, path), layout.rows)) for path in (best, other)]
        resembling = [c for c in _candidates(layout.scales, WRENCH) if c.kind in AS_IF_MOVED and not c.variant]
        if stands_best(links, resembling):
            best = other
            found["platform"], whole["platform"] = _stamped_elsewhere(layout, found["platform"], progress)
    off = clocks_off(found) or any(r.record.bends for r in layout.runs)
    return filtered(layout, between_rows(layout, best) if off else best)


def _stamped_elsewhere(layout: Layout, platform: Explanation, progress: Progress | None) -> tuple[Explanation, Link]:
    """The platform where parts of a tick by which it is late are the stamp's: explained anew, and on whole runs."""
    tick, timing = layout.scales.tick, platform.residual.link.timing
    for effect in platform.chosen.effects():
        if part_of_a_tick(effect, tick):
            timing = timing.plus(Later(delay=effect.parameters()["delay"]))
    again = _explain_platform(layout, platform_link(layout, layout.rows).stamped(timing), _told(progress, "platform"))
    return again, platform_link(layout, layout.whole).stamped(again.residual.link.timing)


def _stamped_late(layout: Layout, link: WrenchLink, compensation: Explanation | None) -> list[Fit]:
    """A record that is stamped late, in each of its readings, the likelier first; none where the compensation shows no such thing.

    The compensation tells the delay to a tick. A contact that does not bear it out may hide it: a late reading looks like less damping.
    """
    skew = log_parameters(compensation.chosen.effects()).skew if compensation else 0.0
    if compensation is None or not skew:
        return []
    residual = Residual(link)
    candidates = _candidates(replace(layout.scales, late=skew), ("log",))
    fits = sorted((fit(residual, (c,), c.grid) for c in candidates), key=lambda f: f.chi2)
    residual = residual.wary(fits[0].effects())
    fits = [refit(residual, f) for f in fits]
    borne_out = nothing(residual).chi2 - fits[0].chi2 > DETECTION
    return fits if borne_out or compensation.chosen.chi2 < RECORD_LEFT * compensation.null.chi2 else []


def _by_its_stamp(
    layout: Layout, link: WrenchLink, found: dict[str, Explanation], whole: dict[str, Link], late: Fit, progress: Progress | None
) -> bool:
    """Whether wrench_comp is stamped early, and not wrench_meas late: contact and sensor depart more under a record that is ``late``.

    The compensation is explained anew then.
    """
    skew = log_parameters(found["compensation"].chosen.effects()).skew
    residual = Residual(link)
    told = square(residual([c.at(np.array([skew])) for c in late.causes]))
    refuted = float(late.theta[-1]) < REFUTED * skew or told > nothing(residual).chi2 + DETECTION
    if skew > FARTHEST * layout.scales.tick or not refuted:
        return False
    early = compensation_link(layout, layout.rows).stamped(Later(delay=-skew))
    found["compensation"] = _explain_compensation(layout, early, _candidates(layout.scales, ("compensation",)), progress)
    whole["compensation"] = compensation_link(layout, layout.whole).stamped(found["compensation"].residual.link.timing)
    return True


def _other_reading_betters(found: Explanation, other: Fit) -> bool:
    """Whether what was found, whose first cause is a record stamped late, fits better with the reading of `other` for it."""
    causes = (*other.causes, *found.chosen.causes[1:])
    if any(c.kind == JITTER for c in causes):
        return False
    again = fit(found.residual, causes, [found.chosen.theta], tries=1)
    return again.chi2 < found.chosen.chi2 - DETECTION * inflation(found.chosen)


def _settle_compensation(
    layout: Layout, path: BestPath, found: dict[str, Explanation], whole: dict[str, Link], progress: Progress | None
) -> None:
    """The compensation again, where the contact has told how late the record is: with the readings that the loop used."""
    explanation = found["wrench"]
    effects = explanation.chosen.effects()
    skew = log_parameters(effects).skew
    if not skew or not explanation.adequate:
        return
    ticks, chosen = round(skew / layout.scales.tick), wrench_link_of(explanation.residual)
    in_time = [e for e in effects if e.link != "log"]
    links = []
    for rows in (layout.rows, layout.whole):
        wrench = make_wrench_link(layout, path, rows).as_read(chosen)
        everything = range(len(wrench.runs))
        late, prompt = wrench.predict([(i, effects) for i in everything]), wrench.predict([(i, in_time) for i in everything])
        used = [_as_read(run, a, b, ticks) for run, a, b in zip(wrench.runs, late, prompt, strict=True)]
        link = compensation_link(layout, rows)
        links.append(link.on_used(used, [_without_end(run, ticks) for run in link.runs]))
    late_record = Candidate(
        EFFECTS["log.skew"], (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), {"delay": skew}
    )  # as the contact has it
    candidates = (*_candidates(layout.scales, ("compensation",)), late_record)
    found["compensation"] = _explain_compensation(layout, links[0], candidates, progress)
    whole["compensation"] = links[1].stamped(found["compensation"].residual.link.timing)


def _settle_platform(layout: Layout, found: dict[str, Explanation], whole: dict[str, Link], progress: Progress | None) -> Layout:
    """The platform again, where the sensor has proved to show another wrench than the one that the drives bear; the layout with that one.

    What was recorded is changed by the difference of two replays, with what was found of the sensor and without: what the replay does not
    know of the contact is the same in both.
    """
    explanation, platform = found["wrench"], found.get("platform")
    effects = explanation.chosen.effects()
    in_truth = [e for e in effects if e.link not in ("sensor", "log")]
    if platform is None or not platform.departs or not explanation.adequate or len(in_truth) == len(effects):
        return layout
    if all(follows_exactly(r.scenario) for r in layout.runs):
        return layout
    wrench = whole["wrench"]
    everything = range(len(layout.runs))
    shown, borne = wrench.predict([(i, effects) for i in everything]), wrench.predict([(i, in_truth) for i in everything])
    readings = [r.record.filled("wrench_meas") + b - s for r, b, s in zip(layout.runs, borne, shown, strict=True)]
    again = under(layout, readings)
    if again is None:
        return layout
    found["platform"] = _explain_platform(again, platform_link(again, again.rows), _told(progress, "platform under the force found"))
    whole["platform"] = platform_link(again, again.whole).stamped(found["platform"].residual.link.timing)
    return again


def _as_read(run: LinkRun, modelled: Array, in_time: Array, ticks: int) -> Array:
    """(N, 6) what the loop read, of which the record, `run.measured`, was stamped so many ticks late.

    modelled: (N, 6) what the record should show. in_time: what the loop should have read. Only noise is shifted, the difference of record
    and model: across a touch no reading can be made up from the rows beside it, and a larger difference is the model's error there.
    """
    most = MOST_NOISE * np.where(np.isfinite(run.sigma), run.sigma, 0.0)
    return in_time + shifted(np.clip(run.measured - modelled, -most, most), float(ticks))


def _without_end(run: LinkRun, ticks: int) -> LinkRun:
    """Without the last rows: what the loop read last was not stamped within the record."""
    sigma = run.sigma.copy()
    sigma[len(sigma) - ticks :] = np.inf
    return replace(run, sigma=sigma)
