"""The first contact of a scenario, simulated on its own rig before the run: its rebound, and the
energy that the rig makes in it.

A response measured with sines is valid at their amplitude and along one direction. It does not
include dry friction of seals and gears: in drives with feed-forward, friction shortens the travel
by f_c/k_p at each reversal, whatever the speed of the contact, and holds a leg that has stopped.
Nor does it include that the normal of a socket turns while a tip slides in it, which changes the
mass along the normal and adds friction. The blocks of the loop model both, so the first contact is
simulated with them: the scenario's platform, surfaces and vehicles, and an ideal sensor except for
a delay, that of the force in the loop; no other compensation is active, unless asked for. Vehicles
in an FMU, which has its own start, are replaced by those of `spacecraft`. The simulation begins
:data:`APPROACH` before the touch, within the times :data:`LEAD`: drives with friction yield at the
start, and this transient needs some travel to decay (hydraulic legs at 5 mm/s: starting 0.5 mm
before the touch, the rebound is 1.5 % above that of the run, 5 mm before 0.4 %).

A bounce is also computed, for many delays and stiffnesses. Net damping decides whether the
oscillation of a closed contact decays. A touch, however, begins with a force step: the damper
exerts c v at once, and this reaches the numerical model a lag tau later, during which it continues
at full speed. For a free flyer of mass m the rig then makes

    E = integral of F v_act - F_used v_cmd = (tau/m) integral of F^2 dt = tau k integral of v^2 dt +
    (tau c/2)(v_0^2 + v_1^2)

to first order in tau. The first term is the damping -k tau of the delay ledger; the second comes
from both ends of the contact and is of the order of c tau/m of the approach energy. A light tip in
a well-damped cone has c tau/m of 1 and more: it may rebound faster than it approached although the
net damping is far above zero. The bounce is therefore computed: in the coordinate x along the
direction, with the force F = k x + c x' (never pulling), and g the impulse response of x to the
force, through the numerical model and the rig,

    x(t) = v_0 t - integral of g(t - s) F(s) ds,   g <-> G(s) e^(-s tau)/(m s^2) + Y(s)

G and Y are those of :mod:`hiltestbed.analysis.rig_response`. The inverse transform is the closed
form of a second-order system with the same lag, plus a sum over the measured lines of the
remainder, which decreases with the third power of the frequency.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.analysis.metrics import along_impulse
from hiltestbed.analysis.rig_response import RigResponse
from hiltestbed.build import runnable_from
from hiltestbed.compiled.jit import interpreted
from hiltestbed.contact.directions import Direction, acting_along_z, time_of_touch
from hiltestbed.contact.sides import sides_of
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, attitude_deg_from_quat, pose_step
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility
from hiltestbed.scenario import Scenario, resolved

LEAD = (0.1, 1.0)  # [s] of uniform motion before the touch, minimum and maximum
APPROACH = 5e-3  # [m] of uniform motion before the touch
# [s] longest head-on bounce that is simulated: one that takes minutes will not end within the run
# either
LONGEST = 20.0
SLIDING_FACTOR = 2.0  # simulated duration, in durations of a head-on bounce, for a sliding tip
BELOW_ANY_BOUNCE = 1e-12  # [m/s] limit for a latch to close, below the speed of any bounce
ROUNDS = 4  # searches for a limit, at most
# relative change at which a limit has converged; relative resolution of a computed rebound
SAME = 2e-3
STEPS = 500  # per bounce: error of e 2e-3
# half periods of the contact, and lags of the loop, that together bound the duration of a bounce
HALF_PERIODS, LAGS = 1.3, 3.0


class FirstContact:
    """The first contact of a scenario.

    Attributes:
        simulable: whether it is short enough to be simulated, see :data:`LONGEST`.
    """

    def __init__(
        self, scenario: Scenario, touch: float, ideal: bool = False, corrected: bool = False
    ) -> None:
        """``touch``: its earliest time [s]; ``ideal``: on a rig with ideal tracking; ``corrected``:
        with the motion method that corrects the force, and the identification that it needs.
        """
        self._data, self._ideal = (
            resolved(scenario),
            scenario.rig.platform.reference() if ideal else None,
        )
        links = ("contact",) if ideal else ("contact", "platform")
        pairs = zip(scenario.effects, self._data["effects"], strict=True)
        self._effects = [keys for effect, keys in pairs if effect.link in links]
        self._inverse, motion = mobility(scenario.spacecraft), scenario.compensation.motion
        self._motion = motion.model_dump(mode="json") if corrected else motion.of_the_rig()
        self._identification = self._data["identification"] if corrected else {"kind": "none"}
        speed = max(float(np.linalg.norm(scenario.approach.velocity)), APPROACH / LEAD[1])
        self._mass, self._lead = (
            effective_mass(scenario.spacecraft),
            min(touch, max(APPROACH / speed, LEAD[0])),
        )
        self._stiffness, _ = acting_along_z(scenario.impact)
        self._own = self._lasts(self._stiffness, scenario.sensor.delay)
        self.simulable = self._own <= LONGEST
        if touch > self._lead:
            start, pose = approach_state(scenario.approach), np.empty(7)
            interpreted(pose_step)(start[:7], start[7:], touch - self._lead, pose)
            x, y, z = (float(v) for v in pose[:3])
            attitude = attitude_deg_from_quat(pose[3:]).tolist()
            self._data["approach"] |= {"gap": -z, "offset": [x, y], "attitude_deg": attitude}

    def _lasts(self, stiffness: float, late: float) -> float:
        """[s] upper bound of the duration of a head-on bounce."""
        return HALF_PERIODS * math.pi * math.sqrt(self._mass / stiffness) + LAGS * late

    def bounce(self, delay: float, factor: float = 1.0, lag: float = 0.0) -> Bounce | None:
        """The bounce with a force that is ``delay`` [s] late, in a contact ``factor`` times as
        stiff as the scenario's, on a rig with that ``lag`` [s]; None if it does not end in time,
        diverges, or its scenario is invalid.
        """
        try:
            loop = Loop([self._scenario(delay, factor, lag)])
        # in the search for a limit, a stiffness may be invalid with the effects of the contact
        except InputError:
            return None
        while loop.k < loop.scenarios[0].ticks and loop.alive[0]:
            try:
                loop.step()
            # a denominator is zero or has overflowed, with numbers far from those of any rig
            except ZeroDivisionError:
                return None
            if loop.tally.rebounded[0]:
                break
        return self._ended(loop) if loop.alive[0] else None

    def _ended(self, loop: Loop) -> Bounce | None:
        impulse, before, after = loop.tally.first_contact(0)
        rebound = along_impulse(impulse, before, after)
        if rebound is None:
            return None
        energy = 0.5 * float(impulse @ before) ** 2 / float(impulse @ self._inverse @ impulse)
        return Bounce(rebound, float(loop.tally.energy[0]) / energy)

    def _scenario(self, delay: float, factor: float, lag: float) -> Scenario:
        data = self._data
        lasts = self._lasts(factor * self._stiffness, max(delay + lag, 0.0))
        contact = data["mechanism"]["contact"]
        mechanism: dict[str, Any] = data["mechanism"] | {
            "contact": contact | {"stiffness": factor * contact["stiffness"]}
        }
        if mechanism.get("latch"):
            mechanism["latch"] = mechanism["latch"] | {"speed": BELOW_ANY_BOUNCE}
        changed = {
            "name": "first contact",
            "description": "",
            "seed": 0,
            "mechanism": mechanism,
            "sensor": {"delay": delay},
            "numerical_model": {"kind": "free_flyers"},
            "duration": self._lead + SLIDING_FACTOR * min(lasts, max(self._own, data["duration"])),
            "identification": self._identification,
            "monitoring": None,
            "compensation": {"force": {"kind": "none"}, "motion": self._motion},
            "safety": dict.fromkeys(data["safety"]),
            "effects": self._effects,
        }
        if self._ideal:
            changed["rig"] = data["rig"] | {
                "platform": self._ideal,
                "upper": data["rig"]["upper"] | {"tracking": "ideal"},
            }
            changed["compensation"]["motion"] = {"kind": "none"}
        return runnable_from(data | changed)


def first_contact(
    scenario: Scenario, ideal: bool = False, corrected: bool = False
) -> FirstContact | None:
    """The first contact of a scenario, for simulation, with the arguments of FirstContact. None if
    it is latched from the start, nothing touches, or the contact lasts for minutes; also if parts
    move or MuJoCo detects the contacts: the first contact is then part of the capture.
    """
    if scenario.mechanism.captured or not sides_of(scenario.mechanism).rigid:
        return None
    touch = time_of_touch(scenario.impact, scenario.duration)
    if touch is None:
        return None
    contact = FirstContact(scenario, touch, ideal, corrected)
    return contact if contact.simulable else None


def corrected_log_error(scenario: Scenario, delay: float) -> float | None:
    """``ln(e/e_ref)`` of the first contact with a motion method that corrects the force and a
    ``delay`` [s] of the force: what the platform did before the method knew the contact is not
    corrected. None if it cannot be simulated.
    """
    found = [
        contact.bounce(late)
        for contact, late in (
            (first_contact(scenario, corrected=True), max(delay, 0.0)),
            (first_contact(scenario, ideal=True), 0.0),
        )
        if contact is not None
    ]
    if len(found) < 2 or not all(b is not None and b.rebound > 0.0 for b in found):
        return None
    corrected, reference = (b.rebound for b in found if b is not None)
    return math.log(corrected / reference)


class Rebounds:
    """Bounces of a contact ``way`` on a rig, over delay and stiffness; ``simulated`` simulates
    them, None: only computed.

    Computed bounces are cheap and depend on delay and stiffness like simulated ones, except for a
    factor of the rebound that changes slowly with either; the factor of the last simulated bounce
    is used for its neighbours. A limit that is found with computed bounces is simulated, and the
    search is repeated until the limit does not change. If the first simulated bounce equals the
    computed one, the rig is linear, and no further bounce is simulated.
    """

    def __init__(
        self, response: RigResponse, way: Direction, simulated: FirstContact | None = None
    ) -> None:
        self._response, self._way, self._simulated = response, way, simulated
        self._factor = 1.0
        self.lag = lag_of(response)

    def first(self, delay: float, stiffness: float) -> Bounce:
        """The contact's own bounce; if it equals the computed one, no further one is simulated."""
        found = self.at(delay, stiffness)
        if abs(self._factor - 1.0) < SAME:
            self._simulated, self._factor = None, 1.0
        return found

    def at(self, delay: float, stiffness: float) -> Bounce:
        """The simulated bounce, or the computed one if none is simulated or the bodies do not
        separate. A negative delay (a lead) is simulated as zero delay, times the ratio of the
        computed bounces.
        """
        through = self._computed(delay, stiffness)
        found = (
            self._simulated.bounce(max(delay, 0.0), stiffness / self._way.stiffness, self.lag)
            if self._simulated
            else None
        )
        if found is None:
            return through
        beside = through if delay >= 0.0 else self._computed(0.0, stiffness)
        if not (found.rebound > 0.0 and beside.rebound > 0.0):
            return found
        self._factor = found.rebound / beside.rebound
        return Bounce(through.rebound * self._factor, through.energy + found.energy - beside.energy)

    def slower(self, delay: float, stiffness: float) -> bool:
        """Whether a bounce ends slower than it began: computed, times the last one's factor."""
        return self._computed(delay, stiffness).rebound * self._factor < 1.0

    def settled(
        self, seek: Callable[[], float | None], case: Callable[[float], tuple[float, float]]
    ) -> float | None:
        """The converged limit that ``seek`` finds with :meth:`slower`; ``case`` gives (delay,
        stiffness) of the bounce at a limit.
        """
        limit = seek()
        for _ in range(ROUNDS):
            if limit is None or self._simulated is None:
                break
            before, factor = limit, self._factor
            self.at(*case(limit))
            limit = seek() if self._factor != factor else limit
            if limit is None or abs(limit - before) <= SAME * abs(limit):
                break
        return limit

    def _computed(self, delay: float, stiffness: float) -> Bounce:
        return bounce(self._response, self._way.mass, stiffness, self._way.damping, delay)


@dataclass(frozen=True)
class Bounce:
    """rebound: speed after over before. energy: made by the rig, over the kinetic energy before."""

    rebound: float
    energy: float


def bounce(
    response: RigResponse, mass: float, stiffness: float, damping: float, delay: float
) -> Bounce:
    """A bounce of ``mass`` [kg] on [N/m], [N s/m] through a rig; the force ``delay`` [s] late."""
    lag = lag_of(response)
    span = HALF_PERIODS * math.pi * math.sqrt(mass / stiffness) + LAGS * max(delay + lag, 0.0)
    t = np.linspace(0.0, span, STEPS + 1)
    dt = float(t[1])
    yields = _summed(response, response.yields[1:], t) if response.yields.any() else 0.0
    g = dt * (_carried(response, lag, t - delay) / mass + yields)
    force = np.zeros(len(t))
    work = _met(t, g, dt, stiffness, damping, force)
    after = 1.0 - dt * (float(force.sum()) - 0.5 * force[0]) / mass
    return Bounce(float(-after), float(2.0 * work / mass - (1.0 - after * after)))


def _met(t: Array, g: Array, dt: float, stiffness: float, damping: float, force: Array) -> float:
    """Write the ``force`` (N,) after an approach at 1 m/s; returns the work that is done on it."""
    place, work = 0.0, 0.0
    force[0] = damping
    for j in range(1, len(t)):
        free = t[j] - force[1:j] @ g[j - 1 : 0 : -1] - 0.5 * force[0] * g[j]
        if free <= 0.0:
            break
        pushed = stiffness * free + damping * (free - place) / dt
        force[j] = pushed if pushed > 0.0 else 0.0
        work += 0.5 * (force[j] + force[j - 1]) * (free - place)
        place = free
    return work


def lag_of(response: RigResponse) -> float:
    """Lag of the rig at low frequency [s]; negative: lead."""
    return float(-np.angle(response.follows[1]) / (2.0 * math.pi * response.frequency[1]))


def _carried(response: RigResponse, lag: float, t: Array) -> Array:
    """The inverse transform of G/s^2 at ``t`` [s]."""
    after = np.maximum(t, 0.0)
    if not np.any(response.follows != 1.0):
        return after
    half = 0.5 * abs(lag)  # 1/(1 + s half)^2
    ramp = (
        after - 2.0 * half + (after + 2.0 * half) * np.exp(-after / half) if half > 0.0 else after
    )
    w = 2.0 * math.pi * response.frequency[1:]
    second = 1.0 / (1.0 + 1j * w * half) ** 2
    if lag < 0.0:  # a lead: the mirror image
        ramp, second = 2.0 * after - ramp, 2.0 - second
    rest = (response.follows[1:] - second) / -(w**2)
    return np.where(t > 0.0, ramp + _summed(response, rest, t), 0.0)


def _summed(response: RigResponse, lines: NDArray[np.complex128], t: Array) -> Array:
    """The inverse transform at even ``t`` (N,) of values at the lines above 0 Hz, of a response
    that decays within half a period of the line spacing; its N sums are products of about sqrt(N)
    coarse and sqrt(N) fine rotations of each line.
    """
    spacing = float(response.frequency[1] - response.frequency[0])
    turns = 2j * math.pi * response.frequency[1:]
    block = math.isqrt(len(t) - 1) + 1
    fine = np.exp(np.outer(turns, (t[1] - t[0]) * np.arange(block)))
    swing = (np.exp(np.outer(t[::block], turns)) * lines) @ fine
    total = spacing * (2.0 * swing.real.ravel()[: len(t)] + lines[0].real)
    return np.where(t < 0.5 / spacing, total, 0.0)
