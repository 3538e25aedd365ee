"""Whether the loop is stable in a contact, before a run: net damping, largest delay and stiffness, from the rig's measured response.

Along a direction, the insertion first of all, with the reduced mass m, a contact of stiffness k and damping c, the platform's response G
from command to pose, its compliance Y to the contact force, and a force that is used tau late,

    m s^2 + D(s) = 0,   D(s) = (k + c s) G(s) e^(-s tau)/(1 + (k + c s) Y(s))

The contact swings at the w of m w^2 = Re D(jw), and Im D(jw)/w is the damping that is left of it: below zero a contact gains energy. The
loop is at its limit where D(jw) = m w^2: |D| gives the w and the phase of D without tau the largest tau. For a second order with a delay
this is the critical damping of M. Zebenay, T. Boge, D. Choukroun, "Modeling, stability analysis, and testing of a hybrid docking
simulator", IEEE Trans. Industrial Electronics 62(10), 2015.

A contact that pulls is as stable as that. One that only pushes begins with a step, in which the rig makes energy however much damping is
left of what stays: it is stable where its bounce (:mod:`hiltestbed.bounce`) ends slower than it began, too.

The first contact of the approach is played besides (:mod:`hiltestbed.trial`): with the dry friction of the drives, which no response
holds, and with surfaces that curve and rub. What is told of its bounce is that.

Where a contact acts in other directions as well (:mod:`hiltestbed.contact.directions`), each is judged so, with the parts of G and Y along
it (:mod:`hiltestbed.rig_response`); the verdict is that of the one that bears the least further delay. A method that makes up for the
platform does so from the first touch on along the line that it meets first; on a surface that is not flat a later touch has another line,
and the platform's lag in full until that is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.contact.directions import Direction, directions, insertion
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects import by_link
from hiltestbed.frames import Array
from hiltestbed.ledger import contact_frequency, force_path_delay
from hiltestbed.numerical_model.bodies import mobility
from hiltestbed.rebounds import Rebounds
from hiltestbed.rig_response import EXACT, Complex, RigResponse, beyond_measure, measured_response, six_axis_response
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.trial import FirstContact, first_contact

NEUTRAL = 5e-3  # of the energy of a bounce, as of a run (:mod:`hiltestbed.assessment`)
HALVINGS = 20  # of a delay or a stiffness that is sought
LATER = "along the normal of a later touch"
WIDEST = 1e3  # times the stiffness, up to and down to which its limit is looked for


@dataclass(frozen=True)
class Stability:
    """What the loop leaves of a contact's damping.

    Attributes:
        stable: the contact loses energy. frequency: at which it swings [Hz]. damping: of the contact [N s/m]; net_damping: what is left
        [N s/m]. delay: of the force that is used, compensation taken off [s]; largest_delay: at which no damping is left [s], below 0
        where the platform alone takes more than there is; delay_margin: what is left [s]. stiffness: of the contact, largest_stiffness:
        at which no damping is left [N/m], None beyond a thousand times it.
        compensated: the compensation of the scenario counts as its ledger has it. direction: along or about what. turns: it is of an
        angle, in N m s/rad and N m/rad. rebound: speed after a bounce over that before it; rig_energy: that the rig makes in it, over
        the energy before it; both None of a contact that pulls.
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
        """The verdict, with what to act on."""
        head = "stable" if self.stable else "unstable"
        if self.direction != "along z":
            head += f" {self.direction}"
        damping, stiffness = ("N m s/rad", "N m/rad") if self.turns else ("N s/m", "N/m")
        parts = [f"{head}: net damping {self.net_damping:+.4g} {damping} of {self.damping:.4g}"]
        if self.rebound is not None and self.rig_energy is not None and self.rig_energy > NEUTRAL:
            made = f"{100.0 * self.rig_energy:.{0 if self.rig_energy >= 0.1 else 1}f} %"
            but = f" ({self.caveat})" if self.caveat else ""
            parts.append(f"the rig makes {made} of a bounce's energy, which ends at {self.rebound:.4g} times its speed{but}")
        if self.largest_delay is not None:
            size, now = f"{1e3 * abs(self.largest_delay):.3g} ms", f"uncompensated now: {1e3 * round(self.delay, 9):.3g} ms"
            parts.append(f"largest delay {size} ({now})" if self.largest_delay >= 0.0 else f"the platform alone is {size} too late ({now})")
        if self.largest_stiffness is not None:
            parts.append(f"largest stiffness {self.largest_stiffness:.3g} {stiffness} (now {self.stiffness:.3g} {stiffness})")
        return "; ".join(parts)


def stability(scenario: Scenario) -> dict[str, Any] | None:
    """``summary["stability"]`` of a scenario: with its compensation, and under `uncompensated` without; None where there is no loop,
    or the contact swings faster than the rig was measured."""
    if scenario.rig.platform.physical:
        return None
    if why := beyond_measure(scenario):
        return _unjudged(f"not judged: {why}") | {"uncompensated": None}
    bare = worst_of(scenario, force_path_delay(scenario, compensated=False), compensated=False)
    if bare is None:
        return None
    without = told(bare)
    force = scenario.compensation.force
    if force.adds_force:
        said = f"not judged with {force.kind}, which adds a force of its own; without it {bare[0].sentence()}"
        return _unjudged(said) | {"uncompensated": without}
    corrects = scenario.compensation.force.corrects_platform or scenario.compensation.motion.corrects_force
    left = force_path_delay(scenario, compensated=True)
    if not corrects and left == bare[0].delay:
        return told([replace(judged, compensated=True) for judged in bare]) | {"uncompensated": without}
    found = worst_of(scenario, left, compensated=True, exact=corrects)
    return told(found) | {"uncompensated": without} if found is not None else None


def _unjudged(said: str) -> dict[str, Any]:
    """No figure, and ``said`` for a verdict."""
    return dict.fromkeys(f.name for f in fields(Stability)) | {"compensated": True, "directions": [], "verdict": said}


def told(judged: list[Stability]) -> dict[str, Any]:
    """The worst direction, its verdict, and every direction."""
    return asdict(judged[0]) | {"verdict": judged[0].sentence(), "directions": [asdict(j) for j in judged]}


def worst_of(scenario: Scenario, delay: float, compensated: bool, exact: bool = False) -> list[Stability] | None:
    """Every direction of a scenario's contact whose frequency was measured, the one that bears the least further delay first; or None.

    ``exact``: the compensation makes up for the platform.
    """
    ways = directions(scenario)
    played = first_contact(scenario, exact) if any(way.first for way in ways) and not _computes(scenario, ways, exact) else None
    judged = [judge(scenario, EXACT, delay, compensated, way, played) for way in ways] if exact else []
    if exact:  # what is met later, elsewhere on the surface, is not
        ways = [replace(way, name=LATER, first=False) for way in ways if way.slant]
    if len(ways) == 1 and not ways[0].slant:
        judged += [judge(scenario, measured_response(scenario), delay, compensated, ways[0], played)]
    elif ways:
        six, inverse = six_axis_response(scenario), mobility(scenario)
        judged += [judge(scenario, six.along(way.row, inverse), delay, compensated, way, played) for way in ways]
    return sorted((j for j in judged if j is not None), key=_left) or None


def _computes(scenario: Scenario, ways: Sequence[Direction], exact: bool) -> bool:
    """Whether the first contact is a spring and a damper along one line on a rig that follows exactly: what is computed is then so."""
    straight = len(ways) == 1 and not ways[0].slant and scenario.mechanism.contact.friction == 0.0
    straight &= not any(e.link == "contact" for e in scenario.effects)
    return straight and (exact or measured_response(scenario) is EXACT)


def stability_of_file(path: str | Path, set: Mapping[str, Any] | None = None) -> dict[str, Any] | None:
    """The same of a scenario's file, which holds, with dotted keys overridden."""
    return stability(load_scenario(path, set))


def _left(judged: Stability) -> float:
    """How much more delay a direction bears [s], where that was within what was measured."""
    if judged.delay_margin is None:
        return math.inf if judged.stable else -math.inf
    return judged.delay_margin


def judge(
    scenario: Scenario,
    response: RigResponse,
    delay: float,
    compensated: bool = True,
    way: Direction | None = None,
    played: FirstContact | None = None,
) -> Stability | None:
    """The stability of a scenario's contact ``way`` (the insertion) on a rig of that response with a force that is ``delay`` [s] late;
    None where its frequency was not measured. ``played``: the first contact, which is that of ``way`` where this is the first."""
    contact = insertion(scenario) if way is None else way
    fine = response.finer()
    found = net_damping(fine, contact.mass, contact.stiffness, contact.damping, delay)
    if found is None:
        return None
    frequency, left = found
    rebounds = Rebounds(response, contact, played if contact.first else None)
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
    """Why the bounce of a contact is not that of the first one to come, or what acts on that one and is not in it."""
    if contact.name == LATER:
        return "an upper bound: the line of a later touch is not known, and the platform's lag counts in full"
    if contact.first:
        w = contact_frequency(scenario)
        left_out = sorted({e.kind for e in by_link(scenario.effects, "sensor", "dynamics") if e.worth(scenario, w) is None})
        return f"without {', '.join(left_out)}" if left_out else None
    if sides_of(scenario.mechanism).rigid:
        return "of a head-on touch without friction, through the response at one amplitude"
    return "of its surfaces alone: parts that give way behind them take less force and damp less, to either side"


def _bears(rebounds: Rebounds, fine: RigResponse, contact: Direction) -> float | None:
    """Delay of the force [s] at which a contact gains energy: no damping is left of it, or a bounce ends as fast as it began."""
    most = largest_delay(fine, contact.mass, contact.stiffness, contact.damping)
    if most is None or contact.pulls or rebounds.at(most, contact.stiffness).rebound < 1.0:
        return most

    def seek() -> float:
        low, high = min(0.0, -rebounds.lag), most  # a force that leads by the rig's lag is used when it acts
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if rebounds.slower(middle, contact.stiffness) else (low, middle)
        return low

    return rebounds.settled(seek, lambda delay: (delay, contact.stiffness))


def net_damping(fine: RigResponse, mass: float, stiffness: float, damping: float, delay: float) -> tuple[float, float] | None:
    """Frequency [Hz] at which the contact swings and the damping that is left of it [N s/m]; None beyond what was measured."""
    w = 2.0 * math.pi * fine.frequency
    dynamic = _dynamic(fine, stiffness, damping) * np.exp(-1j * w * delay)
    balance = dynamic.real - mass * w * w
    k = _crossing(balance)
    if k is None:
        return None
    at = _between(balance, k)
    swing = w[k] + at * (w[k + 1] - w[k])
    across = dynamic.imag[k] + at * (dynamic.imag[k + 1] - dynamic.imag[k])
    return float(swing / (2.0 * math.pi)), float(across / swing)


def largest_delay(fine: RigResponse, mass: float, stiffness: float, damping: float) -> float | None:
    """Delay of the force [s] at which no damping is left; None beyond what was measured."""
    w = 2.0 * math.pi * fine.frequency
    dynamic = _dynamic(fine, stiffness, damping)
    balance = np.abs(dynamic) - mass * w * w
    k = _crossing(balance)
    if k is None:
        return None
    at = _between(balance, k)
    phase = np.unwrap(np.angle(dynamic))
    swing = w[k] + at * (w[k + 1] - w[k])
    return float((phase[k] + at * (phase[k + 1] - phase[k])) / swing)


def _dynamic(fine: RigResponse, stiffness: float, damping: float) -> Complex:
    contact = stiffness + 2j * math.pi * fine.frequency * damping
    return contact * fine.follows / (1.0 + contact * fine.yields)


def _crossing(balance: Array) -> int | None:
    """Where a balance first falls below zero."""
    below = np.flatnonzero(balance < 0.0)
    return int(below[0]) - 1 if len(below) and below[0] > 0 else None


def _between(balance: Array, k: int) -> float:
    return float(balance[k] / (balance[k] - balance[k + 1]))


def _largest_stiffness(rebounds: Rebounds, fine: RigResponse, contact: Direction, delay: float, stable: bool) -> float | None:
    """Stiffness [N/m] from which a contact gains energy, above its own where it is stable, else below it."""

    def left(factor: float) -> bool | None:
        found = net_damping(fine, contact.mass, contact.stiffness * factor, contact.damping, delay)
        if found is None or found[1] <= 0.0 or contact.pulls:
            return None if found is None else found[1] > 0.0
        return rebounds.slower(delay, contact.stiffness * factor)

    def seek() -> float | None:
        factor = 1.0
        step = 1.25 if stable else 0.8
        while 1.0 / WIDEST < factor < WIDEST:
            following = factor * step
            state = left(following)
            if state is None:
                return None
            if state != stable:
                inside, outside = (factor, following) if stable else (following, factor)
                for _ in range(HALVINGS):
                    middle = math.sqrt(inside * outside)
                    inside, outside = (middle, outside) if left(middle) else (inside, middle)
                return contact.stiffness * inside
            factor = following
        return None

    return rebounds.settled(seek, lambda stiffness: (delay, stiffness))
