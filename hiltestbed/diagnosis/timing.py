"""Stage "select": timing within a tick or a row: when a facility samples, obeys and stamps. No
definition states it; it is no departure.

A channel that is stamped a fraction of a row late makes the link before it too late and the one
after it too early, which no rig can be; a numerical model that steps with a part of its old twist
is a fraction of a tick late. Where a link departs, a shift of its output and input in the record is
therefore fitted beside the causes; and a delay of less than :data:`MAX_UNNAMED_DELAY_ROWS` rows is
a cause only where nothing else departs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import BOUND_TOLERANCE, Fit, at_bound, fit, inflation, null_fit, refit
from hiltestbed.diagnosis.links import ModelLink, Timing
from hiltestbed.diagnosis.links.base import NO_SHIFT
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search, first_of_each
from hiltestbed.diagnosis.settings import AMBIGUITY, DETECTION, INTERPRETATION_PENALTY
from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

Explain = Callable[[Search, Residual], Explanation]
Weigh = Callable[[Residual], Residual]

# derived: two channels, each stamped up to a row off; a record with more is refused
MAX_STAMP_SHIFT_ROWS = 2.25
MAX_STAMP_ROWS = 1.0  # chosen: by which one channel is stamped off
# chosen: two instants, each up to half a tick off, and the error due to noise
MAX_UNNAMED_DELAY_ROWS = 1.05
# chosen: rows: of one shift, and of several together
STARTS, STARTS_TOGETHER = (0.15, 0.4, 1.0, 1.6), (0.4, 1.0)
MAX_ROUNDS = 2  # chosen: explanations of a link, each under the timing found with the last
MAX_BASES = 4  # chosen: sets of causes beside which the timing is fitted
# chosen: by which a link is early, beyond the error of its fit: its input is stamped late
HIDDEN_ROWS = 0.05
CONVERGED_ROWS = 0.02  # chosen: change of the timing below which a link is not explained again
# links whose output is interpolated between rows where their input lies there
INTERPOLATED_LINKS = ("platform", "compensation")
EARLY = (-MAX_STAMP_SHIFT_ROWS, 0.0)
EITHER = (-MAX_STAMP_SHIFT_ROWS, MAX_STAMP_SHIFT_ROWS)
LATE = (0.0, MAX_STAMP_SHIFT_ROWS)
# rows, ticks; a longer delay is a platform.delay
ENCODER, OBEYED = (-MAX_STAMP_SHIFT_ROWS, MAX_UNNAMED_DELAY_ROWS), (0.0, 0.5)
# rows: its stamp, half a tick of its instant, and the error due to noise
STAMPED_ENCODER = (-MAX_STAMP_SHIFT_ROWS, MAX_STAMP_ROWS + 0.55)
OLD_TWIST_RANGE = (0.0, 1.0)  # chosen: share of the old twist, instead of rows
# channels that are shifted together, each with its range [rows]
SHIFTS: Mapping[str, tuple[Mapping[str, tuple[float, float]], ...]] = {
    "platform": (
        *({"delay": ENCODER}, {"before": EITHER}, {"obeyed": OBEYED}),
        {"obeyed": OBEYED, "delay": STAMPED_ENCODER},
    ),
    "wrench": ({"delay": EARLY}, {"before": (-MAX_STAMP_SHIFT_ROWS, MAX_UNNAMED_DELAY_ROWS)}),
    "compensation": ({"delay": LATE}, {"before": LATE}),
    "dynamics": (
        *({"delay": EITHER}, {"before": EITHER}, {"old": OLD_TWIST_RANGE}),
        {"delay": EITHER, "before": EITHER, "old": OLD_TWIST_RANGE},
    ),
}
# of wrench_meas, when other links show its stamps
SHIFTS_AS_STAMPED = ({"delay": (-MAX_STAMP_SHIFT_ROWS, MAX_UNNAMED_DELAY_ROWS)},)
# on which a single cause that leaves only noise is not replaced by a shift
ONE_CAUSE_LINKS = ("platform", "compensation", "dynamics")
STEP_DELAY = "dynamics.step_delay"
DELAY_EFFECTS = ("platform.delay", "sensor.delay", "log.skew", STEP_DELAY, "dynamics.integrator")
# delays in whole ticks: explicit Euler acts as one
TICK_EFFECTS = {STEP_DELAY, "dynamics.integrator"}
LINK_CHANNELS = {
    "platform": ("pose_act", "pose_cmd"),
    "wrench": ("wrench_meas", "pose_act"),
    "compensation": ("wrench_comp", "wrench_meas"),
    "dynamics": ("pose_cmd", "wrench_comp"),
}  # output and input of a link


def explain_with_timing(
    residual: Residual,
    search: Search,
    explain: Explain = Search.explain,
    off: bool = True,
    weigh: Weigh = lambda r: r,
) -> Explanation:
    """The explanation of a link with the timing under which it explains most; with the believed
    timing where that is no worse.

    Args:
        search: of the link. explain: called in place of `Search.explain`, if given.
        off: whether anything shows that the facility's clocks are off; if not, the believed timing
            is kept.
        weigh: weights under which the timing of a computed channel is fitted: rows interpolated
            between others do not have their noise.
    """
    if not off:
        return explain(search, residual)
    if not noise_alone(search.judge(residual, ())) and (
        alone := _timing_alone(residual, search, weigh)
    ):
        residual = alone
    found = explain(search, residual)
    for _ in range(MAX_ROUNDS):
        place = _timing_of_explanation(found, weigh)
        if place is None:
            return found
        link = found.residual.link
        way = np.abs(_in_rows(place, link) - _in_rows(link.timing, link)).max()
        found = explain(search.after(found), without_ends(Residual(link.with_timing(place))))
        if way < CONVERGED_ROWS:
            break
    return found


def _timing_alone(residual: Residual, search: Search, weigh: Weigh) -> Residual | None:
    """The link with the timing that leaves only noise without any cause; None where there is none,
    or a named delay does as well.

    Nor where a single cause of the link does better than a shift by more than a row, if no other
    link shows that stamps are off.
    """
    weighed = weigh(without_ends(residual))
    null = null_fit(weighed)
    cost = _comparable_score(residual.link)
    best = min(
        (fit_with_timing(weighed, null, place) for place in timing_candidates(residual.link)),
        key=cost,
    )
    named = [
        fit(weighed, (c,), c.grid)
        for c in search.candidates
        if c.kind in DELAY_EFFECTS and not c.variant
    ]
    need = DETECTION * inflation(best)
    if cost(best) > min(f.score for f in (null, *named)) - need:
        return None
    link = residual.link
    if (
        link.name in ONE_CAUSE_LINKS
        and not link.known
        and np.abs(_in_rows(_fitted_timing(best), link)).max() > MAX_UNNAMED_DELAY_ROWS
    ):
        simple = (c for c in search.candidates if c.kind not in DELAY_EFFECTS and not c.variant)
        if any(fit(weighed, (c,), c.grid).score < cost(best) - need for c in simple):
            return None
    there = without_ends(
        Residual(residual.link.with_timing(residual.link.timing.plus(_fitted_timing(best))))
    )
    return there if noise_alone(search.judge(there, ())) else None


def timing_under(residual: Residual, best: Fit) -> Residual:
    """The residual with the timing that fits best beside the ``best`` cause, if that cause leaves
    more than noise; else itself.

    Further causes are sought under that timing: otherwise they would stand in for a shift.
    """
    if noise_alone(contact_leftovers(residual, best.effects())):
        return residual
    place = _better_timing(without_ends(residual), best, [null_fit(residual), best])
    return residual if place is None else without_ends(Residual(residual.link.with_timing(place)))


def _fitted_timing(fit: Fit) -> Timing:
    """The timing in a fit, which is its last hypothesis."""
    last = fit.effects()[-1]
    assert isinstance(last, Timing)
    return last


def _timing_of_explanation(found: Explanation, weigh: Weigh) -> Timing | None:
    """The timing beside the causes that then explain most; None where that is no better."""
    chosen = found.chosen
    settled = (
        found.adequate and found.residual.link.name in ONE_CAUSE_LINKS and len(chosen.causes) < 2
    )
    if not found.departs or settled:
        return None
    return _better_timing(weigh(without_ends(found.residual)), chosen, _bases(found), fewer=True)


def _better_timing(
    residual: Residual, chosen: Fit, bases: Sequence[Fit], fewer: bool = False
) -> Timing | None:
    """The timing that explains most beside one of the ``bases``; None where ``chosen`` does as well
    with the link's own timing.

    fewer: a shift is preferred to more causes that do as well, since it needs no fault; but a delay
        alone has a name.
    """
    link = residual.link
    here = chosen if JITTER in chosen.kinds else refit(residual, chosen)
    cost = _comparable_score(link)
    best, fits = here, []
    # the best first, so that those which will not come near are soon left
    for base in sorted(bases, key=lambda f: f.chi2):
        for place in timing_candidates(link):
            # twice the margin below: interpolation halves chi-square at most
            known = cost(best) + 2.0 * DETECTION * inflation(best)
            shifted = fit_with_timing(residual, base, place, known)
            if within_range(link, shifted):
                fits.append(shifted)
                best = min(best, shifted, key=cost)
    if not fits:
        return None
    best = min(fits, key=cost)
    need = DETECTION * inflation(best)
    if fewer:
        least = cost(best) + need
        best = min((f for f in fits if cost(f) < least), key=lambda f: (len(f.causes), cost(f)))
    if (
        fewer
        and len(best.causes) - 1 < len(chosen.causes)
        and not set(chosen.kinds) <= set(DELAY_EFFECTS)
    ):
        # a cause has to be detected beyond any shift
        need = -(AMBIGUITY if best.kinds[:-1] else DETECTION) * inflation(best)
    return link.timing.plus(_fitted_timing(best)) if cost(best) < cost(here) - need else None


def _comparable_score(link: ModelLink) -> Callable[[Fit], float]:
    """The score of a fit on ``link``, corrected for the noise that interpolation removes."""

    def cost(f: Fit) -> float:
        last = f.effects()[-1:]
        timing = link.timing.plus(last[0]) if last and isinstance(last[0], Timing) else link.timing
        part = timing.before / link.tick % 1.0 if link.name in INTERPOLATED_LINKS else 0.0
        return f.chi2 / (part * part + (1.0 - part) ** 2) + f.penalty

    return cost


def _in_rows(place: Timing, link: ModelLink) -> Array:
    tick = link.tick
    return np.array([place.delay / tick, place.before / tick, place.obeyed / tick, place.old])


def timing_candidates(link: ModelLink) -> list[Candidate]:
    """The timings that are tried, as hypotheses."""
    ways = SHIFTS_AS_STAMPED if link.known and link.name == "wrench" else SHIFTS[link.name]
    free = [{name: ends for name, ends in way.items() if name not in link.known} for way in ways]
    return [shift_candidate(link, way) for n, way in enumerate(free) if way and way not in free[:n]]


def shift_candidate(link: ModelLink, way: Mapping[str, tuple[float, float]]) -> Candidate:
    """The shifts named in ``way`` together, each within its range, as a hypothesis."""
    tick, now = link.tick, link.timing.parameters()
    names, ends = tuple(way), tuple(way.values())
    units = np.array([1.0 if name == "old" else tick for name in names])
    here = np.array([now[name] for name in names])
    sizes = STARTS if len(names) == 1 else STARTS_TOGETHER
    starts = [[s for s in (*(-s for s in sizes), *sizes) if low <= s <= high] for low, high in ends]
    grid = tuple(tuple(np.array(start) * units - here) for start in itertools.product(*starts))
    low, high = (np.array(end) * units - here for end in zip(*ends, strict=True))
    return Candidate(Timing, names, low, high, np.zeros(len(names), bool), grid)


def _bases(found: Explanation) -> list[Fit]:
    """The fits beside which timing is sought: none, the chosen one, the best single causes."""
    no_clock = next((f for f in found.singles if not set(f.kinds) & {*DELAY_EFFECTS, JITTER}), None)
    near = (
        found.chosen,
        *first_of_each(found.singles, "kinds")[:MAX_BASES],
        *found.more[:1],
        *([no_clock] if no_clock else []),
    )
    once = {tuple(c.key for c in f.causes): f for f in near if f.causes and JITTER not in f.kinds}
    return [null_fit(found.residual), *once.values()]


def timing_found(link: ModelLink) -> Candidate | None:
    """What of a link's timing its own record shows, as a hypothesis; None: nothing."""
    off = {
        name for name, value in link.timing.parameters().items() if value and name not in link.known
    }
    ways = sorted(
        (c for c in timing_candidates(link) if off <= set(c.names)), key=lambda c: len(c.names)
    )
    return ways[0] if off and ways else None


def fit_with_timing(
    residual: Residual,
    base: Fit,
    later: Candidate,
    known: float = math.inf,
    starts: Sequence[Array] | None = None,
) -> Fit:
    """``base`` with the timing ``later``, from ``starts`` or its grid; known: see :func:`fit`."""
    begun = [np.concatenate([base.theta, s]) for s in (later.grid if starts is None else starts)]
    return fit(residual, (*base.causes, later), begun, tries=2, known=known)


def within_range(link: ModelLink, found: Fit) -> bool:
    """Whether stamps and instants are off by less than the largest shifts."""
    shift = found.causes[-1]
    timing = link.timing.plus(_fitted_timing(found))
    theta = found.part(len(found.causes) - 1)
    if "old" in shift.names:  # all of an old twist is explicit Euler
        old = shift.names.index("old")
        shift, theta = shift.held(old, theta[old]), np.delete(theta, old)
    at_an_end = at_bound(shift, theta)
    largest = (1.0 - BOUND_TOLERANCE) * MAX_STAMP_SHIFT_ROWS * link.tick
    return not at_an_end and abs(timing.delay + timing.before) < largest


def without_ends(residual: Residual, memory: int = 0) -> Residual:
    """Without the rows for which a shifted channel has no data; memory: more of the first."""
    ends = math.ceil(MAX_STAMP_SHIFT_ROWS)
    weight = [w.copy() for w in residual.weight]
    for w in weight:
        w[: ends + memory], w[len(w) - ends :] = 0.0, 0.0
    return Residual(residual.link, residual.runs, weight)


def output_shift_rows(explanation: Explanation) -> float:
    """Rows by which the output of a link was found to be late."""
    return float(_in_rows(explanation.residual.link.timing, explanation.residual.link).sum())


def _stamp_shift_rows(link: ModelLink) -> float:
    """Rows by which the output is stamped later than the input, without those of old twists."""
    return float(_in_rows(link.timing, link)[:-1].sum())


def delays_not_causes(explanations: Mapping[str, Explanation]) -> dict[str, dict[str, float]]:
    """Link to those of its delays that are no causes, with their rows: fractions of a tick where
    something else departs as well, and delays that the opposite shift of another link compensates,
    as for a channel that is stamped late. Neither is what cannot be told from one.
    """
    departing = {name: e for name, e in explanations.items() if e.departs}
    departures = sum(max(len(e.chosen.causes), int(not e.adequate)) for e in departing.values())
    departures += sum(output_shift_rows(e) != 0.0 for e in explanations.values())
    if departures < 2:
        return {}
    # stamps cancel around the loop
    taken_back = max(-sum(_stamp_shift_rows(e.residual.link) for e in explanations.values()), 0.0)
    # whole rows, of which the instants of the platform hide a part
    whole = max(taken_back + 0.5, math.ceil(taken_back)) if taken_back > HIDDEN_ROWS else 0.0
    out: dict[str, dict[str, float]] = {}
    for name, e in departing.items():
        for i, effect in enumerate(e.chosen.effects()):
            rivals = e.rivals[i] if e.rivals and effect.kind not in DELAY_EFFECTS else ()
            alike = [o for f in rivals for o in f.effects() if o.kind not in e.chosen.kinds]
            for delay in (effect, *alike):
                rows = _delay_rows(delay, e.residual.link.tick)
                ticks = delay.kind in TICK_EFFECTS
                if rows is not None and rows <= (
                    whole if ticks else taken_back + MAX_UNNAMED_DELAY_ROWS
                ):
                    out.setdefault(name, {})[effect.kind] = rows
    return out


def instants_off(explanations: Mapping[str, Explanation]) -> float:
    """[s] by which a delay may be off because instants are; 0 where none is seen to be."""
    links = [e.residual.link for e in explanations.values()]
    off = any(link.timing != NO_SHIFT for link in links) or bool(delays_not_causes(explanations))
    return MAX_UNNAMED_DELAY_ROWS * links[0].runs[0].scenario.tick if off else 0.0


def part_of_a_tick(effect: Effect, tick: float, most: float = MAX_UNNAMED_DELAY_ROWS) -> bool:
    """Whether an effect is a delay, of ``most`` rows, that the timing of a facility can explain."""
    rows = _delay_rows(effect, tick)
    return effect.kind not in TICK_EFFECTS and rows is not None and 0.0 < rows <= most


def may_be_stamp(effect: Effect, link: ModelLink) -> bool:
    """Whether a delay may be the stamp's: by a row more where other links show stamps off."""
    more = MAX_STAMP_ROWS if link.known else 0.0
    return part_of_a_tick(effect, link.tick, MAX_UNNAMED_DELAY_ROWS + more)


def best_placed(links: Sequence[ModelLink], candidates: Sequence[Candidate]) -> int:
    """The index of the link that leaves least under its best timing, with no other cause known: 0
    unless another is clearly better.

    candidates: causes that look like a shifted input. A link that needs one of them explains no
        more than the first link does with another size of it.
    """

    def best(link: ModelLink) -> Fit:
        residual = without_ends(Residual(link))
        null = null_fit(residual)
        placed = [fit_with_timing(residual, null, place) for place in timing_candidates(link)]
        return min(
            (null, *placed, *(fit(residual, (c,), c.grid) for c in candidates)),
            key=lambda f: f.score,
        )

    kinds, fits = {c.kind for c in candidates}, [best(link) for link in links]
    costs = [f.score for f in fits]
    least = int(np.argmin(costs))
    if costs[least] < costs[0] - INTERPRETATION_PENALTY and not kinds & set(fits[least].kinds):
        return least
    return 0


def _delay_rows(effect: Effect, tick: float) -> float | None:
    """Rows by which an effect delays its link; None for an effect that is no delay."""
    if effect.kind not in DELAY_EFFECTS:
        return None
    given = effect.parameters()
    if effect.kind in TICK_EFFECTS:
        return float(given.get("ticks", 1.0))
    return float(given["delay"]) / tick


@dataclass(frozen=True)
class ClockOffset:
    """What was attributed to the timing of the facility, and its price if it lies in the loop and
    not in the record alone.

    Attributes:
        output, given: channels of a link; the output is later than the input allows by ``rows``, in
            seconds ``delay``; negative: earlier. effect: the delay that this would be as a cause,
            or None where a shift of the stamps was fitted.
        cor_log_error: change of ln of the coefficient of restitution by the same delay of the loop,
            (pi/2) w delay.
    """

    output: str
    given: str
    rows: float
    delay: float
    effect: str | None
    cor_log_error: float

    def sentence(self) -> str:
        """In words, with its price."""
        when = f"{abs(self.rows):.2g} rows ({abs(self.delay):.3g} s)"
        way = "late" if self.rows > 0.0 else "early"
        if self.effect is None:
            text = f"{self.output} is {when} {way} relative to {self.given}: "
            why = "attributed to the timing of the facility, not to a cause"
        else:
            text = f"{self.output} is {when} later than {self.given} predicts ({self.effect}): "
            why = (
                "attributed to the timing of the facility, not to a cause, since something else "
                "departs as well"
            )
        price = 100.0 * math.expm1(self.cor_log_error)
        return (
            f"{text}{why}; if the loop itself is as {way}, and not the record alone, it changes "
            f"the coefficient of restitution by {price:+.2g} %"
        )


def clock_offsets(explanations: Mapping[str, Explanation]) -> tuple[ClockOffset, ...]:
    """What is attributed to the timing of the facility."""
    found = [(n, output_shift_rows(e), None) for n, e in explanations.items() if _off(e)]
    found += [
        (name, rows, kind)
        for name, clocks in delays_not_causes(explanations).items()
        for kind, rows in clocks.items()
        if rows > 0.0
    ]
    out = []
    for name, rows, kind in found:
        scenario = explanations[name].residual.link.runs[0].scenario
        delay = rows * scenario.tick
        price = 0.5 * math.pi * contact_frequency(scenario) * delay
        out.append(ClockOffset(*LINK_CHANNELS[name], rows, delay, kind, price))
    return tuple(out)


def _off(e: Explanation) -> bool:
    return e.residual.link.timing != NO_SHIFT


def timing_departs(explanations: Mapping[str, Explanation]) -> bool:
    """Whether a link shows channels stamped, or instants, off by fractions of a row."""
    return any(
        _off(e) or any(part_of_a_tick(c, e.residual.link.tick) for c in e.chosen.effects())
        for e in explanations.values()
        if e.departs or _off(e)
    )
