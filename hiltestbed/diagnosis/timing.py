"""When a facility samples, obeys and stamps, within a tick or a row: no definition says it, and none of it is a departure.

A channel that is stamped a part of a row late makes the link before it too late and the one after it too early, which no rig can be; a
numerical model that steps with a part of its old twist is a part of a tick late. Where a link departs, it is asked whether its output
stands elsewhere in the record than its input says; and a delay of less than :data:`PARTS` rows is a cause only where nothing else departs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit, inflation, nothing, refit
from hiltestbed.diagnosis.links import Later, Link
from hiltestbed.diagnosis.links.base import PROMPT
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search, first_of_each
from hiltestbed.diagnosis.settings import AMBIGUITY, DETECTION, ONE_OF_TWO
from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

Explain = Callable[[Residual], Explanation]
Weigh = Callable[[Residual], Residual]

FARTHEST = 2.25  # rows: two channels, each stamped up to a row off; beyond that a record is refused
PARTS = 1.05  # rows: two instants, each up to half a tick off, and what noise leaves of them
STARTS, FEWER = (0.15, 0.4, 1.0, 1.6), (0.4, 1.0)  # rows: of one number, and of several together
AGAIN = 2  # times that a link is explained anew under the place that was found
NEAREST = 4  # causes beside which a place is sought
FINE = 0.02  # rows, by which a place may move without the link being explained anew
BETWEEN = ("platform", "compensation")  # links whose output is read between rows where their input lies there
EARLY, EITHER, LATE = (-FARTHEST, 0.0), (-FARTHEST, FARTHEST), (0.0, FARTHEST)
ENCODER, OBEYED = (-FARTHEST, PARTS), (0.0, 0.5)  # what is later than that is a platform.delay
PART = (0.0, 1.0)  # of the old twist, in place of rows
WAYS: Mapping[str, tuple[Mapping[str, tuple[float, float]], ...]] = {  # in which channels may stand elsewhere, each with its range [rows]
    "platform": ({"delay": ENCODER}, {"before": EITHER}, {"obeyed": OBEYED}, {"obeyed": OBEYED, "delay": ENCODER}),
    "wrench": ({"delay": EARLY}, {"before": (-FARTHEST, PARTS)}),
    "compensation": ({"delay": LATE}, {"before": LATE}),
    "dynamics": ({"delay": EITHER}, {"before": EITHER}, {"old": PART}, {"delay": EITHER, "before": EITHER, "old": PART}),
}
SETTLED = ("platform", "compensation", "dynamics")  # links on which one cause that leaves noise is not for a place to replace
WHOLE_TICKS = "dynamics.step_delay"
CLOCKS = ("platform.delay", "sensor.delay", "log.skew", WHOLE_TICKS, "dynamics.integrator")
OF_TICKS = {WHOLE_TICKS, "dynamics.integrator"}  # explicit Euler acts as one tick
CHANNELS = {
    "platform": ("pose_act", "pose_cmd"),
    "wrench": ("wrench_meas", "pose_act"),
    "compensation": ("wrench_comp", "wrench_meas"),
    "dynamics": ("pose_cmd", "wrench_comp"),
}  # output and input of a link


def in_its_place(
    residual: Residual, search: Search, explain: Explain | None = None, off: bool = True, weigh: Weigh = lambda r: r
) -> Explanation:
    """The explanation of a link with its channels where they stand in the record, where that explains more than where they should.

    Args:
        search: of the link. explain: what it is asked; itself by default.
        off: whether something says that the facility's clocks are off; else the channels stand where they should.
        weigh: weights under which a place is sought, of a computed channel: rows that are read between others do not share their noise.
    """
    explain = explain or search.explain
    if not off:
        return explain(residual)
    if not noise_alone(search.judge(residual, ())) and (alone := _alone(residual, search, weigh)):
        residual = alone
    found = explain(residual)
    for _ in range(AGAIN):
        place = _place(found, weigh)
        if place is None:
            return found
        link = found.residual.link
        way = np.abs(_numbers(place, link) - _numbers(link.timing, link)).max()
        found = explain(_without_ends(Residual(link.stamped(place))))
        if way < FINE:
            break
    return found


def _alone(residual: Residual, search: Search, weigh: Weigh) -> Residual | None:
    """The link in the place that leaves noise without any cause; None where there is none, or a delay with a name does as well."""
    weighed = weigh(_without_ends(residual))
    null = nothing(weighed)
    cost = _cost_on(residual.link)
    best = min((_beside(weighed, null, place) for place in _places(residual.link)), key=cost)
    named = [fit(weighed, (c,), c.grid) for c in search.candidates if c.kind in CLOCKS and not c.variant]
    if cost(best) > min(f.score for f in (null, *named)) - DETECTION * inflation(best):
        return None
    there = _without_ends(Residual(residual.link.stamped(residual.link.timing.plus(_later(best)))))
    return there if noise_alone(search.judge(there, ())) else None


def place_under(residual: Residual, best: Fit) -> Residual:
    """With the channels where the ``best`` cause alone has them, if it leaves more than noise and less there; itself where it does not.

    Further causes are sought there: without it they would stand in for what a place does.
    """
    if noise_alone(contact_leftovers(residual, best.effects())):
        return residual
    place = _better_place(_without_ends(residual), best, [nothing(residual), best])
    return residual if place is None else _without_ends(Residual(residual.link.stamped(place)))


def _later(fit: Fit) -> Later:
    """The place of a fit, its last hypothesis."""
    last = fit.effects()[-1]
    assert isinstance(last, Later)
    return last


def _place(found: Explanation, weigh: Weigh) -> Later | None:
    """When the facility samples, stamps and steps, under the causes that then explain most; None where that is no better."""
    chosen = found.chosen
    settled = found.adequate and found.residual.link.name in SETTLED and len(chosen.causes) < 2
    if not found.departs or settled:
        return None
    return _better_place(weigh(_without_ends(found.residual)), chosen, _bases(found), fewer=True)


def _better_place(residual: Residual, chosen: Fit, bases: Sequence[Fit], fewer: bool = False) -> Later | None:
    """The place that explains most beside one of the ``bases``; None where ``chosen`` does as well where the link is.

    fewer: a place does where more causes would do as well, since it needs no fault; but a delay alone has a name.
    """
    link = residual.link
    here = chosen if JITTER in chosen.kinds else refit(residual, chosen)
    fits = [_beside(residual, base, place) for base in bases for place in _places(link)]
    cost = _cost_on(link)
    best = min(fits, key=cost)
    need = DETECTION * inflation(best)
    if fewer:
        least = cost(best) + need
        best = min((f for f in fits if cost(f) < least), key=lambda f: (len(f.causes), cost(f)))
    if fewer and len(best.causes) - 1 < len(chosen.causes) and not set(chosen.kinds) <= set(CLOCKS):
        need = -AMBIGUITY * inflation(best)
    return link.timing.plus(_later(best)) if cost(best) < cost(here) - need else None


def _cost_on(link: Link) -> Callable[[Fit], float]:
    """The score of a fit on ``link``; where outputs are read between rows, which takes noise away, as if it did not."""

    def cost(f: Fit) -> float:
        last = f.effects()[-1:]
        timing = link.timing.plus(last[0]) if last and isinstance(last[0], Later) else link.timing
        part = timing.before / link.runs[0].scenario.tick % 1.0 if link.name in BETWEEN else 0.0
        return f.chi2 / (part * part + (1.0 - part) ** 2) + f.penalty

    return cost


def _numbers(place: Later, link: Link) -> Array:
    tick = link.runs[0].scenario.tick
    return np.array([place.delay / tick, place.before / tick, place.obeyed / tick, place.old])


def _places(link: Link) -> list[Candidate]:
    """The places that are tried, as hypotheses."""
    tick, now, out = link.runs[0].scenario.tick, link.timing.parameters(), []
    for way in WAYS[link.name]:
        names, ends = tuple(way), tuple(way.values())
        units = np.array([1.0 if name == "old" else tick for name in names])
        here = np.array([now[name] for name in names])
        sizes = STARTS if len(names) == 1 else FEWER
        starts = [[s for s in (*(-s for s in sizes), *sizes) if low <= s <= high] for low, high in ends]
        grid = tuple(tuple(np.array(start) * units - here) for start in itertools.product(*starts))
        low, high = (np.array(end) * units - here for end in zip(*ends, strict=True))
        out.append(Candidate(Later, names, low, high, np.zeros(len(names), bool), grid))
    return out


def _bases(found: Explanation) -> list[Fit]:
    """What the place is sought beside: nothing, what was chosen, and what comes nearest alone."""
    no_clock = next((f for f in found.singles if not set(f.kinds) & {*CLOCKS, JITTER}), None)
    near = (found.chosen, *first_of_each(found.singles, "kinds")[:NEAREST], *found.more[:1], *([no_clock] if no_clock else []))
    once = {tuple(c.key for c in f.causes): f for f in near if f.causes and JITTER not in f.kinds}
    return [nothing(found.residual), *once.values()]


def _beside(residual: Residual, base: Fit, later: Candidate) -> Fit:
    """``base`` with the output elsewhere."""
    return fit(residual, (*base.causes, later), [np.concatenate([base.theta, s]) for s in later.grid], tries=2)


def _without_ends(residual: Residual) -> Residual:
    """Without the first and the last rows, for which a channel that is moved has nothing."""
    ends = math.ceil(FARTHEST)
    weight = [w.copy() for w in residual.weight]
    for w in weight:
        w[:ends], w[len(w) - ends :] = 0.0, 0.0
    return Residual(residual.link, residual.runs, weight)


def rows_of(explanation: Explanation) -> float:
    """Rows by which the output of a link was found to be stamped late."""
    return float(_numbers(explanation.residual.link.timing, explanation.residual.link).sum())


def no_causes(explanations: Mapping[str, Explanation]) -> dict[str, dict[str, float]]:
    """Link to the clocks among its causes that are none, with their rows: parts of a tick where something else departs as well, and what
    another link takes back, as it does of a channel that is stamped late."""
    departing = {name: e for name, e in explanations.items() if e.departs}
    places = [rows_of(e) for e in explanations.values()]
    departures = sum(max(len(e.chosen.causes), int(not e.adequate)) for e in departing.values()) + sum(rows != 0.0 for rows in places)
    if departures < 2:
        return {}
    taken_back = -sum(min(rows, 0.0) for rows in places)
    out: dict[str, dict[str, float]] = {}
    for name, e in departing.items():
        for effect in e.chosen.effects():
            rows = _rows(effect, e.residual.link.runs[0].scenario.tick)
            parts = 0.0 if effect.kind in OF_TICKS else PARTS
            if rows is not None and rows <= max(parts, taken_back + 0.5 if taken_back else 0.0):
                out.setdefault(name, {})[effect.kind] = rows
    return out


def part_of_a_tick(effect: Effect, tick: float) -> bool:
    """Whether an effect is a delay that a facility's instants may be worth."""
    rows = _rows(effect, tick)
    return effect.kind not in OF_TICKS and rows is not None and 0.0 < rows <= PARTS


def stands_best(links: Sequence[Link], candidates: Sequence[Candidate]) -> int:
    """Which one leaves least wherever its output stands in the record, while no cause is known: the first where none is clearly so.

    candidates: causes that an input which stands elsewhere resembles. One that needs such a cause itself explains no more than the first
    does with another size of it.
    """

    def best(link: Link) -> Fit:
        residual = _without_ends(Residual(link))
        null = nothing(residual)
        placed = [_beside(residual, null, place) for place in _places(link)]
        return min((null, *placed, *(fit(residual, (c,), c.grid) for c in candidates)), key=lambda f: f.score)

    kinds, fits = {c.kind for c in candidates}, [best(link) for link in links]
    costs = [f.score for f in fits]
    least = int(np.argmin(costs))
    return least if costs[least] < costs[0] - ONE_OF_TWO and not kinds & set(fits[least].kinds) else 0


def _rows(effect: Effect, tick: float) -> float | None:
    """Rows by which an effect makes its link late; None for one that is no clock."""
    if effect.kind not in CLOCKS:
        return None
    given = effect.parameters()
    return float(given.get("ticks", 1.0)) if effect.kind in OF_TICKS else float(given["delay"]) / tick


def words(explanations: Mapping[str, Explanation]) -> tuple[str, ...]:
    """What was assumed of when the facility samples and stamps, in sentences."""
    out = []
    for name, e in explanations.items():
        rows, link = rows_of(e), e.residual.link
        output, given = CHANNELS[name]
        if link.timing != PROMPT:
            seconds = rows * link.runs[0].scenario.tick
            when = f"{abs(rows):.2g} rows ({abs(seconds):.3g} s) {'late' if rows > 0.0 else 'early'}"
            out.append(f"{output} stands {when} against {given}: taken for how the facility samples and stamps, not for a cause")
    for name, clocks in no_causes(explanations).items():
        for kind, rows in clocks.items():
            output, given = CHANNELS[name]
            seconds = rows * explanations[name].residual.link.runs[0].scenario.tick
            if rows > 0.0:
                out.append(
                    f"{output} is {rows:.2g} rows ({seconds:.3g} s) later than {given} makes it ({kind}): taken for how the facility "
                    "samples and stamps, not for a cause, since something else departs as well"
                )
    return tuple(out)


def clocks_off(explanations: Mapping[str, Explanation]) -> bool:
    """Whether a link shows that channels are stamped, or instants lie, parts of a row otherwise than believed."""
    return any(
        e.residual.link.timing != PROMPT or any(part_of_a_tick(c, e.residual.link.runs[0].scenario.tick) for c in e.chosen.effects())
        for e in explanations.values()
        if e.departs or e.residual.link.timing != PROMPT
    )
