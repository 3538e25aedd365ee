"""Stage "decide": timing within a tick or a row: when a facility samples, obeys and stamps. No
definition states it; it is no departure.

A channel that is stamped a fraction of a row late makes the link before it too late and the one
after it too early, which no rig can be; a numerical model that steps with a part of its old twist
is a fraction of a tick late. A shift of the output in the record is a nuisance of each link, see
:mod:`hiltestbed.diagnosis.link_model`; how large it may be is known where the other links are
explained, since stamps cancel around the loop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from scipy.stats import norm
from scipy.stats import t as student

from hiltestbed.analysis.ledger import contact_frequency
from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.link_model import (
    INSTANT_SIGMA,
    LATEST_INSTANT,
    SHIFT_SIGMA,
    TIME_ERROR,
)

DELAY_EFFECTS = (
    "platform.delay",
    "sensor.delay",
    "log.skew",
    "dynamics.step_delay",
    "dynamics.integrator",
)
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


def clocks_of(name: str, explanations: Mapping[str, Explanation]) -> tuple[float, float]:
    """[rows] mean and standard deviation of the shift of a link, by what the others show.

    Stamps cancel around the loop: where all others are explained without a delay of their own, the
    shift is minus the sum of theirs, as exactly as these are known, but for the instants at which
    the facility reads and obeys. A facility is as exact in one place as in another: shifts scatter
    as those of the others do, of which so few tell a scatter that the shift over it has Student's
    distribution; the normal one with the same 95 % interval stands for it.
    """
    others = [e for n, e in explanations.items() if n != name and not delayed(e)]
    if not others:
        return 0.0, SHIFT_SIGMA
    few = float(student.ppf(0.975, len(others)) / norm.ppf(0.975))
    seen = few * math.sqrt(sum(shift_rows(e) ** 2 for e in others) / len(others))
    if len(others) < len(LINK_CHANNELS) - 1:
        return 0.0, min(seen, SHIFT_SIGMA)
    instants = min(seen, math.sqrt(2.0) * INSTANT_SIGMA)
    mean = -sum(map(_stamp_shift_rows, others))
    sigma = math.hypot(instants, *(e.stamp_error() for e in others))
    return mean * (abs(mean) > TIME_ERROR), min(sigma, SHIFT_SIGMA)


def delayed(e: Explanation) -> bool:
    """Whether a link has a delay among its causes, or its timing is not determined."""
    return not e.adequate or bool(set(e.kinds) & set(DELAY_EFFECTS))


def judged_again(explanations: Mapping[str, Explanation]) -> list[str]:
    """Links whose delay is judged by the clocks that the others show: a delay among the causes, or
    a shift that the others do not share.
    """
    out = []
    for name, e in explanations.items():
        mean, _ = clocks_of(name, explanations)
        if (delayed(e) and e.adequate) or abs(_stamp_shift_rows(e) - mean) > LATEST_INSTANT:
            out.append(name)
    return out


@dataclass(frozen=True)
class ClockOffset:
    """What was attributed to the timing of the facility, and its price if it lies in the loop and
    not in the record alone.

    Attributes:
        output, given: channels of a link; the output is later than the input allows by ``rows``, in
            seconds ``delay``; negative: earlier.
        cor_log_error: change of ln of the coefficient of restitution by the same delay of the loop,
            (pi/2) w delay.
    """

    output: str
    given: str
    rows: float
    delay: float
    cor_log_error: float

    def sentence(self) -> str:
        when = f"{abs(self.rows):.2g} rows ({abs(self.delay):.3g} s)"
        way = "late" if self.rows > 0.0 else "early"
        price = 100.0 * math.expm1(self.cor_log_error)
        return (
            f"{self.output} is {when} {way} relative to {self.given}: attributed to the timing of "
            f"the facility, not to a cause; if the loop "
            f"itself is as {way}, and not the record alone, it changes the coefficient of "
            f"restitution by {price:+.2g} %"
        )


def clock_offsets(explanations: Mapping[str, Explanation]) -> tuple[ClockOffset, ...]:
    """What is attributed to the timing of the facility."""
    out = []
    for name, rows in ((n, shift_rows(e)) for n, e in explanations.items() if is_off(e)):
        scenario = explanations[name].link.runs[0].scenario
        delay = rows * scenario.tick
        price = 0.5 * math.pi * contact_frequency(scenario) * delay
        out.append(ClockOffset(*LINK_CHANNELS[name], rows, delay, price))
    return tuple(out)


def is_off(e: Explanation) -> bool:
    """Whether the timing of a link differs from the believed one by more than an integration in
    steps does.
    """
    return abs(shift_rows(e)) > TIME_ERROR
