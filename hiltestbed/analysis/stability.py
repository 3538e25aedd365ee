"""Stability of the loop in a contact, before a run: net damping, largest delay and stiffness, from
the rig's measured response.

Along a direction (first of all the insertion), with the reduced mass m, a contact of stiffness k
and damping c, the platform's response G from command to pose, its compliance Y to the contact
force, and a force that is delayed by tau,

    m s^2 + D(s) = 0,   D(s) = (k + c s) G(s) e^(-s tau)/(1 + (k + c s) Y(s))

The contact oscillates at the w with m w^2 = Re D(jw), and Im D(jw)/w is its net damping: if it is
negative, the contact gains energy. At the stability limit D(jw) = m w^2: |D| gives w, and the phase
of D without tau gives the largest tau. For a second-order system with a delay this is the critical
damping of M. Zebenay, T. Boge, D. Choukroun, "Modeling, stability analysis, and testing of a hybrid
docking simulator", IEEE Trans. Industrial Electronics 62(10), 2015.

For a contact that can pull, this is the stability criterion. A contact that only pushes begins with
a force step, in which the rig makes energy whatever the net damping is. It counts as stable if, in
addition, its bounce (:mod:`hiltestbed.analysis.trial`) ends slower than it began.

The first contact of the approach is also simulated (:mod:`hiltestbed.analysis.trial`), with the dry
friction of the drives, which no response includes, and with curved surfaces and their friction. Its
reported bounce is the simulated one.

If a contact also acts in other directions (:mod:`hiltestbed.contact.directions`), each is judged in
this way, with the parts of G and Y along it (:mod:`hiltestbed.analysis.rig_response`); the verdict
is that of the direction with the smallest delay margin. A method that compensates the platform does
so from the first touch on, along the line of that touch; on a curved surface a later touch has
another line, and the full lag of the platform counts until that line is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from hiltestbed.analysis.assessment import NEUTRAL
from hiltestbed.analysis.ledger import contact_frequency, corrects_platform, force_path_delay
from hiltestbed.analysis.rig_response import (
    EXACT,
    Complex,
    RigResponse,
    beyond_measure,
    measured_response,
    six_axis_response,
)
from hiltestbed.analysis.trial import FirstContact, Rebounds, first_contact
from hiltestbed.contact.directions import Direction, directions
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects import by_link
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import mobility
from hiltestbed.scenario import Scenario

LATER = "along the normal of a later touch"
# range of the search for the stiffness limit: the stiffness times or divided by this
SEARCH_RANGE = 1e3


@dataclass(frozen=True)
class Stability:
    """Stability of the loop in one direction of a contact.

    Attributes:
        stable: the contact loses energy. frequency: of its oscillation [Hz]. damping: of the
            contact [N s/m]; net_damping: damping minus what the loop removes [N s/m]. delay: of the
            used force, minus compensation [s]; largest_delay: at the stability limit [s], negative
            if the platform alone removes more than the damping; delay_margin: largest_delay - delay
            [s]. stiffness: of the
        contact, largest_stiffness: at the stability limit [N/m], None beyond a thousand times the
            stiffness.
        compensated: the compensation of the scenario is included as in its ledger. direction: along
            or about which axis. turns: the direction is a rotation, with units N m s/rad and N
            m/rad. rebound: speed after a bounce over that before it; rig_energy: made by the rig in
            it, over the energy before it; both None for a contact that can pull. caveat: why the
            bounce may differ in the run.
    """

    stable: bool
    frequency: float
    damping: float
    net_damping: float
    delay: float
    largest_delay: float | None
    delay_margin: float | None
    stiffness: float
    largest_stiffness: float | None
    compensated: bool
    direction: str
    turns: bool
    rebound: float | None
    rig_energy: float | None
    caveat: str | None

    def sentence(self) -> str:
        """The verdict, with the quantities to act on."""
        head = "stable" if self.stable else "unstable"
        if self.direction != "along z":
            head += f" {self.direction}"
        damping, stiffness = ("N m s/rad", "N m/rad") if self.turns else ("N s/m", "N/m")
        parts = [f"{head}: net damping {self.net_damping:+.4g} {damping} of {self.damping:.4g}"]
        if self.rebound is not None and self.rig_energy is not None and self.rig_energy > NEUTRAL:
            made = f"{100.0 * self.rig_energy:.{0 if self.rig_energy >= 0.1 else 1}f} %"
            but = f" ({self.caveat})" if self.caveat else ""
            parts.append(
                f"the rig makes {made} of a bounce's energy, which ends at {self.rebound:.4g} "
                f"times its speed{but}"
            )
        if self.largest_delay is not None:
            size, now = (
                f"{1e3 * abs(self.largest_delay):.3g} ms",
                f"{1e3 * round(self.delay, 9):.3g} ms remain after compensation",
            )
            parts.append(
                f"largest delay {size} ({now})"
                if self.largest_delay >= 0.0
                else f"the platform alone is {size} too late ({now})"
            )
        if self.largest_stiffness is not None:
            parts.append(
                f"largest stiffness {self.largest_stiffness:.3g} {stiffness} (now "
                f"{self.stiffness:.3g} {stiffness})"
            )
        return "; ".join(parts)


def stability(scenario: Scenario) -> dict[str, Any] | None:
    """``summary["stability"]`` of a scenario: with its compensation, and under `uncompensated`
    without; None if there is no loop or the contact frequency is beyond the measured response.
    """
    if scenario.rig.platform.physical:
        return None
    if why := beyond_measure(scenario):
        return _unjudged(f"not judged: {why}") | {"uncompensated": None}
    bare = worst_of(scenario, force_path_delay(scenario, compensated=False), compensated=False)
    if bare is None:
        return None
    without = _as_summary(bare)
    force = scenario.compensation.force
    if force.adds_force:
        verdict = (
            f"not judged with {force.kind}, which adds a force of its own; without it "
            f"{bare[0].sentence()}"
        )
        return _unjudged(verdict) | {"uncompensated": without}
    corrects = corrects_platform(scenario)
    left = force_path_delay(scenario, compensated=True)
    if not corrects and left == bare[0].delay:
        found = [replace(judged, compensated=True) for judged in bare]
    else:
        found = worst_of(scenario, left, compensated=True, exact=corrects)
    if found is None:
        return None
    motion = scenario.compensation.motion
    if motion.reads and not motion.corrects_force:  # unlike the rig's response
        verdict = (
            f"not judged with {motion.kind}, which changes the command by "
            f"measurements; without it {found[0].sentence()}"
        )
        return _unjudged(verdict) | {"uncompensated": without}
    return _as_summary(found) | {"uncompensated": without}


def _unjudged(verdict: str) -> dict[str, Any]:
    """No figures, and ``verdict``."""
    return dict.fromkeys(f.name for f in fields(Stability)) | {
        "compensated": True,
        "directions": [],
        "verdict": verdict,
    }


def _as_summary(judged: list[Stability]) -> dict[str, Any]:
    """The worst direction, its verdict, and every direction."""
    return asdict(judged[0]) | {
        "verdict": judged[0].sentence(),
        "directions": [asdict(j) for j in judged],
    }


def worst_of(
    scenario: Scenario, delay: float, compensated: bool, exact: bool = False
) -> list[Stability] | None:
    """Every direction of a scenario's contact within the measured frequencies, that with the
    smallest delay margin first; or None.

    ``exact``: the method also compensates the platform.
    """
    ways = directions(scenario.impact)
    corrected = exact and scenario.compensation.motion.corrects_force
    simulated = (
        first_contact(scenario, ideal=exact and not corrected, corrected=corrected)
        if any(way.first for way in ways) and not _computes(scenario, ways, exact)
        else None
    )
    judged = (
        [judge(scenario, EXACT, delay, compensated, way, simulated) for way in ways]
        if exact
        else []
    )
    if exact:  # later touches, elsewhere on the surface, are not compensated exactly
        ways = [replace(way, name=LATER, first=False) for way in ways if way.slant]
    if len(ways) == 1 and not ways[0].slant:
        judged += [
            judge(scenario, measured_response(scenario), delay, compensated, ways[0], simulated)
        ]
    elif ways:
        six, inverse = six_axis_response(scenario), mobility(scenario.spacecraft)
        judged += [
            judge(scenario, six.along(way.row, inverse), delay, compensated, way, simulated)
            for way in ways
        ]
    return sorted((j for j in judged if j is not None), key=_left) or None


def _computes(scenario: Scenario, ways: Sequence[Direction], exact: bool) -> bool:
    """Whether the first contact is a spring and damper along one line on an ideal rig."""
    straight = len(ways) == 1 and not ways[0].slant and scenario.mechanism.contact.friction == 0.0
    straight &= not any(e.link == "contact" for e in scenario.effects)
    straight &= not (exact and scenario.compensation.motion.corrects_force)
    return straight and (exact or measured_response(scenario) is EXACT)


def _left(judged: Stability) -> float:
    """Delay margin of a direction [s]; infinite if it is beyond the measured frequencies."""
    if judged.delay_margin is None:
        return math.inf if judged.stable else -math.inf
    return judged.delay_margin


def judge(
    scenario: Scenario,
    response: RigResponse,
    delay: float,
    compensated: bool,
    way: Direction,
    simulated: FirstContact | None,
) -> Stability | None:
    """The stability of a scenario's contact ``way`` on a rig with a response, for a force with a
    ``delay`` [s]; None if its frequency was not measured. ``simulated``: simulates the first
    contact, used if ``way`` is the first contact.
    """
    contact, fine = way, response.finer()
    found = net_damping(fine, contact.mass, contact.stiffness, contact.damping, delay)
    if found is None:
        return None
    frequency, left = found
    rebounds = Rebounds(response, contact, simulated if contact.first else None)
    ends = None if contact.pulls else rebounds.first(delay, contact.stiffness)
    stable = left > 0.0 and (ends is None or ends.rebound < 1.0)
    largest = _bears(rebounds, fine, contact)
    return Stability(
        stable=stable,
        frequency=frequency,
        damping=contact.damping,
        net_damping=left,
        delay=delay,
        largest_delay=largest,
        delay_margin=None if largest is None else largest - delay,
        stiffness=contact.stiffness,
        largest_stiffness=_largest_stiffness(rebounds, fine, contact, delay, stable),
        compensated=compensated,
        direction=contact.name,
        turns=contact.turns,
        rebound=ends.rebound if ends else None,
        rig_energy=ends.energy if ends else None,
        caveat=_caveat(scenario, contact) if ends else None,
    )


def _caveat(scenario: Scenario, contact: Direction) -> str | None:
    """Why the bounce of a contact may differ from that in the run."""
    if contact.name == LATER:
        return (
            "an upper bound: the line of a later touch is not known, and the platform's "
            "lag counts in full"
        )
    if contact.first:
        w = contact_frequency(scenario)
        left_out = sorted(
            {
                e.kind
                for e in by_link(scenario.effects, "sensor", "dynamics")
                if e.worth(scenario.tick, w) is None
            }
        )
        return f"without {', '.join(left_out)}" if left_out else None
    if sides_of(scenario.mechanism).rigid:
        return "of a head-on touch without friction, through the response at one amplitude"
    return (
        "of its springs and dampers alone: mass and friction of its moving parts change it, to "
        "either side"
    )


def _bears(rebounds: Rebounds, fine: RigResponse, contact: Direction) -> float | None:
    """Delay of the force [s] from which a contact gains energy, or a bounce ends no slower."""
    most = largest_delay(fine, contact.mass, contact.stiffness, contact.damping)
    if most is None or contact.pulls or rebounds.at(most, contact.stiffness).rebound < 1.0:
        return most

    def seek() -> float:
        # a lead that equals the rig's lag: no delay in total
        least = min(0.0, -rebounds.lag)
        return bisected(least, most, lambda delay: rebounds.slower(delay, contact.stiffness))

    return rebounds.settled(seek, lambda delay: (delay, contact.stiffness))


def bisected(inside: float, outside: float, holds: Callable[[float], bool | None]) -> float:
    """The limit up to which something ``holds``, to a millionth of the range."""
    for _ in range(20):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def net_damping(
    fine: RigResponse, mass: float, stiffness: float, damping: float, delay: float
) -> tuple[float, float] | None:
    """Frequency of the contact [Hz], its net damping [N s/m]; None beyond those measured."""
    w = 2.0 * math.pi * fine.frequency
    dynamic = _dynamic(fine, stiffness, damping) * np.exp(-1j * w * delay)
    found = _at_crossing(w, dynamic.real - mass * w * w, dynamic.imag)
    return None if found is None else (found[0] / (2.0 * math.pi), found[1] / found[0])


def largest_delay(fine: RigResponse, mass: float, stiffness: float, damping: float) -> float | None:
    """Delay of the force [s] at which the net damping is zero; None beyond those measured."""
    w = 2.0 * math.pi * fine.frequency
    dynamic = _dynamic(fine, stiffness, damping)
    found = _at_crossing(w, np.abs(dynamic) - mass * w * w, np.unwrap(np.angle(dynamic)))
    return None if found is None else found[1] / found[0]


def _dynamic(fine: RigResponse, stiffness: float, damping: float) -> Complex:
    contact = stiffness + 2j * math.pi * fine.frequency * damping
    return contact * fine.follows / (1.0 + contact * fine.yields)


def _at_crossing(w: Array, balance: Array, values: Array) -> tuple[float, float] | None:
    """Frequency [rad/s] at which ``balance`` first falls below zero, and ``values`` there."""
    below = np.flatnonzero(balance < 0.0)
    if not len(below) or below[0] == 0:
        return None
    k = int(below[0]) - 1
    at = balance[k] / (balance[k] - balance[k + 1])
    swing, value = (float(v[k] + at * (v[k + 1] - v[k])) for v in (w, values))
    return swing, value


def _largest_stiffness(
    rebounds: Rebounds, fine: RigResponse, contact: Direction, delay: float, stable: bool
) -> float | None:
    """Stiffness [N/m] from which a contact gains energy: above its own if stable, else below."""

    def left(factor: float) -> bool | None:
        found = net_damping(fine, contact.mass, contact.stiffness * factor, contact.damping, delay)
        if found is None or found[1] <= 0.0 or contact.pulls:
            return None if found is None else found[1] > 0.0
        return rebounds.slower(delay, contact.stiffness * factor)

    def seek() -> float | None:
        factor = 1.0
        step = 1.25 if stable else 0.8
        while 1.0 / SEARCH_RANGE < factor < SEARCH_RANGE:
            following = factor * step
            state = left(following)
            if state is None:
                return None
            if state != stable:
                inside, outside = (factor, following) if stable else (following, factor)
                log = bisected(math.log(inside), math.log(outside), lambda x: left(math.exp(x)))
                return contact.stiffness * math.exp(log)
            factor = following
        return None

    return rebounds.settled(seek, lambda stiffness: (delay, stiffness))
