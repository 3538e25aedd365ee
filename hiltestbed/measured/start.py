"""Position and velocity at the start of a run, compared with gap, offset and approach velocity of
its scenario.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hiltestbed.measured.noise import FREE_MINIMUM, MAD_TO_SIGMA, OUTLIER_SIGMA
from hiltestbed.measured.ratio import (
    CLEAR,
    OTHER_UNIT,
    REVERSED,
    factor_text,
    likely_scale,
    scale_fix,
    share,
)
from hiltestbed.measured.record import LOGGER, Record
from hiltestbed.measured.remark import Remark, error
from hiltestbed.measured.survey import Survey
from hiltestbed.scenario import Scenario

# deviation of the start from the scenario's, of the position per gap and of a command's speed per
# speed, above which it is an error; a platform has lag and scale errors
OTHER = {"pose_cmd.pz": 0.05, "pose_act.pz": 0.5}
UNTOUCHED = 0.7  # of the way to the nominal first touch: a cone is touched before that


@dataclass(frozen=True)
class Start:
    """One translation of one run at its start.

    Attributes:
        begin: [m], travel: [m] before the first touch; expected_begin, expected_travel: [m] of the
            scenario. ratio: of the path to the scenario's; 0 if it is not proportional to that.
        velocity: [m/s] of the scenario. rate: [m/s] at the first row, by a parabola through the
            free flight without outliers, since a spurious force reading makes it accelerate;
            rate_sd: [m/s] of it. gap: [m] of the scenario.
    """

    begin: float
    travel: float
    ratio: float
    expected_begin: float
    expected_travel: float
    velocity: float
    rate: float
    rate_sd: float
    gap: float

    @property
    def unit(self) -> float | None:
        """Ratio of the numbers to those in metres; None if they appear to be in metres."""
        size = abs(self.ratio)
        return None if not size or 1.0 / OTHER_UNIT < size < OTHER_UNIT else size

    @property
    def reversed(self) -> bool:
        return self.ratio < REVERSED


def start_of(record: Record, found: Survey, scenario: Scenario, name: str) -> Start | None:
    """The start of the translation ``name``; None if too little of it was measured."""
    axis, approach = "xyz".index(name[-1]), scenario.approach
    velocity = approach.velocity[axis]
    values, sigma = record.column(name), found.noise[name].white
    known = np.flatnonzero(np.isfinite(values[: max(found.free, FREE_MINIMUM)]))
    t = record.t[known]
    speed, gap = approach.velocity[2], approach.gap
    way = gap / speed if speed > 0 and gap > 0 else math.inf  # [s] to the nominal first touch
    untouched = t <= t[:1] + UNTOUCHED * way if len(known) else known > 0
    known = known[untouched] if untouched.sum() > FREE_MINIMUM else known
    if len(known) < 3:
        return None
    t, values = record.t[known], values[known]
    begin, end = float(np.median(values[:3])), float(np.median(values[-3:]))
    # a command is reached a tick later
    reached = float(record.t[1]) if name.startswith("pose_cmd") else 0.0
    path = (*approach.offset, -approach.gap)[axis] + velocity * (t + reached)
    moved = values - values.mean() if velocity else values
    clear = np.sqrt(np.mean(moved**2)) > CLEAR * sigma and np.abs(path).max() > 1e-6
    ratio = share(path, values, moved) if clear else 0.0
    # the median of three rows is where the second is
    expected = float(path[1]), velocity * float(t[-1] - t[0])
    # otherwise a touch before the nominal one is possible
    rate = velocity, math.inf
    if scenario.mechanism.flat or found.contacts:
        terms = np.vander(t - t[0], 3, increasing=True)
        left = np.abs(values - terms @ (np.linalg.pinv(terms) @ values))
        near = left <= OUTLIER_SIGMA * max(MAD_TO_SIGMA * float(np.median(left)), sigma)
        slope = np.linalg.pinv(terms[near])[1]
        rate = float(slope @ values[near]), sigma * float(np.linalg.norm(slope))
    return Start(begin, end - begin, ratio, *expected, velocity, *rate, approach.gap)


def starts_at_fault(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for a translation with another unit, with a reversed sign, or from another run."""
    if scenario.mechanism.captured:
        return
    names = [f"{group}.p{a}" for group in ("pose_cmd", "pose_act") for a in "xyz"]
    for name in (n for n in names if record.has(n)):
        start = start_of(record, found, scenario, name)
        if start is not None:
            yield from _fault(record, name, start)


def _fault(record: Record, name: str, start: Start) -> Iterator[Remark]:
    seen = (
        f"starts at {start.begin:.4g} and moves by {start.travel:.4g} before the first touch; "
        f"the scenario has {start.expected_begin:.4g} m and {start.expected_travel:.4g} m"
    )
    size, run = start.unit, record.run
    if size is not None:
        fix = (
            f"{scale_fix(name, likely_scale(size, 'm'))}; or set the approach of this "
            f"run, if it was another: set: {{approach.gap: ...}}"
        )
        yield error("unit", run, name, f"{seen}: {factor_text(size, 'm')}", fix)
    elif start.reversed:
        text = f"{seen}: the sign is reversed"
        yield error("sign", run, name, text, scale_fix(name, -1.0))
    elif name in OTHER and start.velocity:
        yield from _another(record, name, start)


def _another(record: Record, name: str, start: Start) -> Iterator[Remark]:
    """Errors for another approach than the scenario's, which would be blamed on a link."""
    speed, place = start.velocity, start.expected_begin
    commanded = name == "pose_cmd.pz"
    stamped = LOGGER * abs(speed) * float(record.t[1])
    if commanded and abs(start.rate - speed) > OTHER[name] * abs(speed) + CLEAR * start.rate_sd:
        text = f"begins at {start.rate:.4g} m/s; the scenario approaches at {speed:.4g} m/s"
        given = f"{{approach.velocity.2: {start.rate:.4g}}}"
        fix = f"if this is right, set in the entry of the run: set: {given}"
        yield error("start", record.run, name, text, fix)
    elif abs(start.begin - place) > OTHER[name] * start.gap + stamped:
        text = (
            f"begins at {start.begin:.4g} m; by its approach the scenario is at {place:.4g} m then"
        )
        gap, offset = start.gap + place - start.begin, place - start.begin
        fix = f"if the numbers have another origin, channels: {{{name}: {{offset: {offset:.4g}}}}}"
        if gap > 0.0 and commanded:
            fix = f"set in the entry of the run: set: {{approach.gap: {gap:.4g}}}; or, {fix}"
        yield error("start", record.run, name, text, fix)
