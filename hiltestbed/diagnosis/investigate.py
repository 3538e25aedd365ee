"""From the layout of a dataset to an explanation of each link, in the order in which one link's finding helps the next."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis import judges
from hiltestbed.diagnosis.all_rows import on_all_rows
from hiltestbed.diagnosis.driven import ALONG_AN_AXIS, WAY, axis_link, mass_and_force, one_force
from hiltestbed.diagnosis.fit import Fit, fit, inflation, nothing, refit
from hiltestbed.diagnosis.jitter import JITTER, jitter_beside
from hiltestbed.diagnosis.layout import Layout, compensation_link, dynamics_link, lay_out, platform_link
from hiltestbed.diagnosis.lines import hum_beside, lines
from hiltestbed.diagnosis.links import AxisLink, CompensationLink, Link, LinkRun, PlatformLink, WrenchLink
from hiltestbed.diagnosis.paths import BestPath, best_path, make_wrench_link
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation, Progress, Search
from hiltestbed.diagnosis.settings import DETECTION, MOST_NOISE, ONE_OF_TWO, RECORD_LEFT
from hiltestbed.diagnosis.stiction import stick_starts
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.log import log_parameters
from hiltestbed.measured import MeasuredDataset
from hiltestbed.replay.wrench import shifted

RESTARTED = 0.9  # of chi-square, that another reading of the start has to leave at most to be taken
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
        whole["platform"] = platform_link(layout, layout.whole)
    if "compensation" not in layout.missing:
        candidates = _candidates(layout.scales, ("compensation", "log"))
        found["compensation"] = _explain_compensation(layout, compensation_link(layout, layout.rows), candidates, progress)
        whole["compensation"] = compensation_link(layout, layout.whole)
    if "wrench" not in layout.missing:
        _investigate_wrench(layout, found, whole, progress)
    if "dynamics" not in layout.missing:
        if layout.scales.driven is None:
            residual = Residual(dynamics_link(layout, layout.rows))
            search = Search(_candidates(layout.scales, ("dynamics",)), judges.of_dynamics(residual), (), _told(progress, "numerical model"))
            found["dynamics"] = search.explain(residual)
            whole["dynamics"] = dynamics_link(layout, layout.whole)
        else:
            found["dynamics"], whole["dynamics"] = _explain_axis(layout, _told(progress, "driven axis"))
    return Findings(layout, found, dict(layout.missing), whole)


def _candidates(scales: Scales, links: Sequence[str]) -> tuple[Candidate, ...]:
    """The hypotheses of every effect that acts on one of ``links``."""
    return tuple(c for effect in EFFECTS.values() if effect.link in links for c in effect.candidates(scales))


def _told(progress: Progress | None, link: str) -> Progress | None:
    return (lambda text: progress(f"{link}: {text}")) if progress else None


def _explain_platform(layout: Layout, link: PlatformLink, progress: Progress | None) -> Explanation:
    """With starts for stiction that the data tell."""
    noise = min((level for c in link.channels[:3] if (level := layout.noise.get(c))), default=0.0)
    scales = replace(layout.scales, sticks=stick_starts(link, noise, layout.scales.substeps))
    return Search(_candidates(scales, ("platform",)), progress=progress).explain(Residual(link))


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
    return Search(tuple(candidates), judge, (), _told(progress, "compensation")).explain(Residual(link))


def _investigate_wrench(layout: Layout, found: dict[str, Explanation], whole: dict[str, Link], progress: Progress | None) -> None:
    """Contact and sensor, which are one link to the data; and the compensation again where the record proves to be stamped late."""
    path = best_path(layout, found.get("platform"))
    link = _choose_lever(make_wrench_link(layout, path, layout.rows, decimate="compensation" not in found))
    scales = replace(layout.scales, lines=lines(link))
    unseen = ("platform",) if link.commands else ()  # what it does is in the path then
    candidates = _candidates(scales, (*WRENCH, *unseen) if "compensation" in found else (*WRENCH, *unseen, "log"))
    residual, given = Residual(link), _stamped_late(layout, link, found.get("compensation"))
    if given:  # which the contact alone cannot tell from a late sensor
        candidates = tuple(c for c in candidates if c.kind != "sensor.delay")
    search = Search(candidates, special=(jitter_beside, hum_beside), progress=_told(progress, "contact and sensor"))
    explanation = search.explain(residual, given[0] if given else None)
    if not given and (levered := _another_lever(explanation)):
        explanation = search.explain(Residual(levered))
    if not given and (pointed := _at_a_point(explanation)):
        explanation = search.explain(Residual(pointed))
    if given and not explanation.adequate and _other_reading_betters(explanation, given[1]):
        explanation = search.explain(residual, given[1])
    elif not given and (other := _on_a_grid(explanation)):
        explanation = search.explain(Residual(other))
    if given:
        explanation = replace(explanation, candidates=(*candidates, *given[0].causes))
    chosen = _wrench(explanation)
    if tuple(run.rows for run in chosen.runs) != tuple(layout.rows):
        everything = make_wrench_link(layout, path, layout.rows)
        explanation = on_all_rows(explanation, everything.reading(chosen.lever, chosen.grid, chosen.blunt))
    found["wrench"] = explanation
    whole["wrench"] = make_wrench_link(layout, path, layout.whole).reading(chosen.lever, chosen.grid, chosen.blunt)
    if given:
        _settle_compensation(layout, path, found, whole, progress)


def _wrench(explanation: Explanation) -> WrenchLink:
    """The link of contact and sensor that an explanation was found on."""
    link = explanation.residual.link
    if not isinstance(link, WrenchLink):
        raise TypeError(f"an explanation of the link {link.name} (got {type(link).__name__}); allowed is a WrenchLink")
    return link


def _at_a_point(explanation: Explanation) -> WrenchLink | None:
    """The link where the tip touches with its foremost point, if what was found, nothing, or a tilt fits better there.

    In the MJCF a plane is met by a ball: where the bodies turn, or the port is tilted, it is met beside that point. A facility may compute
    it at the point.
    """
    link = _wrench(explanation)
    if not explanation.departs or JITTER in explanation.chosen.kinds or not all(r.scenario.mechanism.flat for r in link.runs):
        return None
    other = link.reading(blunt=0.0)
    there = explanation.residual.through(other)
    tilts = [c for c in explanation.candidates if c.kind == "contact.misalignment"]
    fits = [nothing(there), *([refit(there, explanation.chosen)] if explanation.chosen.causes else [])]
    fits += [fit(there, (c,), c.grid) for c in tilts]
    return other if min(f.score for f in fits) < explanation.chosen.score - ONE_OF_TWO else None


def _on_a_grid(explanation: Explanation) -> WrenchLink | None:
    """The link where readings lie between the instants of the believed physics, if what was found, or nothing, fits better there."""
    link = _wrench(explanation)
    if not explanation.departs or JITTER in explanation.chosen.kinds:
        return None
    other = link.reading(grid=link.runs[0].scenario.substeps)
    there = explanation.residual.through(other)
    fits = [nothing(there), *([refit(there, explanation.chosen)] if explanation.chosen.causes else [])]
    return other if min(f.score for f in fits) < explanation.chosen.score - ONE_OF_TWO else None


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
    ticks, chosen = round(skew / layout.scales.tick), _wrench(explanation)
    in_time = [e for e in effects if e.link != "log"]
    links = []
    for rows in (layout.rows, layout.whole):
        wrench = make_wrench_link(layout, path, rows).reading(chosen.lever, chosen.grid, chosen.blunt)
        everything = range(len(wrench.runs))
        late, prompt = wrench.predict([(i, effects) for i in everything]), wrench.predict([(i, in_time) for i in everything])
        used = [_as_read(run, a, b, ticks) for run, a, b in zip(wrench.runs, late, prompt, strict=True)]
        link = compensation_link(layout, rows)
        links.append(link.on_used(used, [_without_end(run, ticks) for run in link.runs]))
    late_record = Candidate(
        EFFECTS["log.skew"], (), np.zeros(0), np.zeros(0), np.zeros(0, bool), ((),), {"delay": skew}
    )  # as the contact has it
    candidates = (*_candidates(layout.scales, ("compensation",)), late_record)
    found["compensation"], whole["compensation"] = _explain_compensation(layout, links[0], candidates, progress), links[1]


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


def _choose_lever(link: WrenchLink) -> WrenchLink:
    """Where between tip and surface the force acts: the reading of the geometry that the torques bear out."""

    def cost(other: WrenchLink) -> float:
        r = Residual(other)(())
        return float(np.sum(np.minimum(r * r, 100.0)))

    return _at_lever(link, cost)


def _at_lever(link: WrenchLink, cost: Callable[[WrenchLink], float]) -> WrenchLink:
    """The reading of the lever that costs least; itself where no friction tells the levers apart."""
    if all(r.scenario.mechanism.contact.friction == 0.0 for r in link.runs):
        return link
    costs = {lever: cost(link.reading(lever)) for lever in (0.5, 0.0, 1.0)}
    best = min(costs, key=lambda key: costs[key])
    bounds = (max(best - 0.5, 0.0), min(best + 0.5, 1.0))
    found: Any = minimize_scalar(lambda lever: cost(link.reading(lever)), bounds=bounds, method="bounded", options={"xatol": 0.01})
    return link.reading(float(found.x) if found.fun < costs[best] - ONE_OF_TWO else best)


def _another_lever(explanation: Explanation) -> WrenchLink | None:
    """The reading of the lever that the best cause bears out, where it leaves clearly less: it was chosen while nothing was known.

    The numbers of the cause follow the lever: what turns the torques, as a rotation of the sensor does, has gone along with the wrong one.
    """
    if explanation.adequate or not explanation.singles:
        return None
    best, residual = explanation.singles[0], explanation.residual

    def cost(link: WrenchLink) -> float:
        there = residual.through(link)
        return square(there(best.effects())) if JITTER in best.kinds else refit(there, best).chi2

    other = _at_lever(_wrench(explanation), cost)
    return other if cost(other) < best.chi2 - DETECTION * inflation(best) else None
