"""Stage "decide": timing within a tick or a row: when a facility samples, obeys and stamps. No
definition states it; it is no departure.

A channel that is stamped a fraction of a row late makes the link before it too late and the one
after it too early, which no rig can be; a numerical model that steps with a part of its old twist
is a fraction of a tick late. A shift of the output in the record is a nuisance of each link, see
:mod:`hiltestbed.diagnosis.link_model`; and a delay of less than :data:`MAX_UNNAMED_DELAY_ROWS` rows
is a cause only where nothing else departs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.link_model import LATEST_INSTANT, TIME_ERROR
from hiltestbed.diagnosis.links.base import NO_SHIFT
from hiltestbed.effects.base import Effect

# [rows] two instants, each up to half a tick off, and the error of an integration in steps
MAX_UNNAMED_DELAY_ROWS = 2.0 * LATEST_INSTANT + TIME_ERROR
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


def shift_rows(e: Explanation) -> float:
    """Rows by which the output of a link was found to be late, with those of old twists."""
    t = e.timing()
    return (t.delay + t.before + t.obeyed) / e.link.tick + t.old


def _stamp_shift_rows(e: Explanation) -> float:
    """Rows by which the output is stamped later than the input, without those of old twists."""
    return shift_rows(e) - e.timing().old


def stamped_alone(explanations: Mapping[str, Explanation]) -> list[str]:
    """Links whose channels are stamped off by more than an instant, though the links before and
    after them, which share these channels, show no such offset: it is a delay of the loop.
    """
    out = []
    for name, e in explanations.items():
        own = set(LINK_CHANNELS[name])
        beside = [n for n in explanations if n != name and own & set(LINK_CHANNELS[n])]
        shared = own <= {c for n in beside for c in LINK_CHANNELS[n]}
        quiet = not any(explanations[n].departs or _off(explanations[n]) for n in beside)
        if shared and quiet and abs(_stamp_shift_rows(e)) > LATEST_INSTANT:
            out.append(name)
    return out


def delays_not_causes(explanations: Mapping[str, Explanation]) -> dict[str, dict[str, float]]:
    """Link to those of its delays that are no causes, with their rows: fractions of a tick where
    something else departs as well, and delays that the opposite shift of another link compensates,
    as for a channel that is stamped late. Neither is what cannot be told from one.
    """
    departing = {name: e for name, e in explanations.items() if e.departs}
    departures = sum(max(len(e.causes), int(not e.adequate)) for e in departing.values())
    departures += sum(shift_rows(e) != 0.0 for e in explanations.values())
    if departures < 2:
        return {}
    # stamps cancel around the loop
    taken_back = max(-sum(_stamp_shift_rows(e) for e in explanations.values()), 0.0)
    # whole rows, of which the instants of the platform hide a part; beyond the error of a fit
    whole = max(taken_back + 0.5, math.ceil(taken_back)) if taken_back > TIME_ERROR else 0.0
    out: dict[str, dict[str, float]] = {}
    for name, e in departing.items():
        for cause in e.causes:
            effect = cause.effect
            rivals = () if effect.kind in DELAY_EFFECTS else cause.others
            alike = [o for f in rivals for o in f.of.each() if o.kind not in e.kinds]
            for delay in (effect, *alike):
                rows = _delay_rows(delay, e.link.tick)
                most = whole if delay.kind in TICK_EFFECTS else taken_back + MAX_UNNAMED_DELAY_ROWS
                if rows is not None and rows <= most:
                    out.setdefault(name, {})[effect.kind] = rows
    return out


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
        when = f"{abs(self.rows):.2g} rows ({abs(self.delay):.3g} s)"
        way = "late" if self.rows > 0.0 else "early"
        text = f"{self.output} is {when} {way} relative to {self.given}: "
        also = ""
        if self.effect is not None:
            text = f"{self.output} is {when} later than {self.given} predicts ({self.effect}): "
            also = ", since something else departs as well"
        price = 100.0 * math.expm1(self.cor_log_error)
        return (
            f"{text}attributed to the timing of the facility, not to a cause{also}; if the loop "
            f"itself is as {way}, and not the record alone, it changes the coefficient of "
            f"restitution by {price:+.2g} %"
        )


def clock_offsets(explanations: Mapping[str, Explanation]) -> tuple[ClockOffset, ...]:
    """What is attributed to the timing of the facility."""
    found = [(n, shift_rows(e), None) for n, e in explanations.items() if _off(e)]
    for name, clocks in delays_not_causes(explanations).items():
        found += [(name, rows, kind) for kind, rows in clocks.items() if rows > 0.0]
    out = []
    for name, rows, kind in found:
        scenario = explanations[name].link.runs[0].scenario
        delay = rows * scenario.tick
        price = 0.5 * math.pi * contact_frequency(scenario) * delay
        out.append(ClockOffset(*LINK_CHANNELS[name], rows, delay, kind, price))
    return tuple(out)


def _off(e: Explanation) -> bool:
    return e.timing() != NO_SHIFT
