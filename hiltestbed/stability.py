"""Whether the loop is stable in a contact, before a run: net damping, largest delay and stiffness, from the rig's measured response.

Along the insertion, with the reduced mass m, a contact of stiffness k and damping c, the platform's response G from command to pose, its
compliance Y to the contact force, and a force that is used tau late,

    m s^2 + D(s) = 0,   D(s) = (k + c s) G(s) e^(-s tau)/(1 + (k + c s) Y(s))

The contact swings at the w of m w^2 = Re D(jw), and Im D(jw)/w is the damping that is left of it: below zero a contact gains energy. The
loop is at its limit where D(jw) = m w^2: |D| gives the w and the phase of D without tau the largest tau. For a second order with a delay
this is the critical damping of M. Zebenay, T. Boge, D. Choukroun, "Modeling, stability analysis, and testing of a hybrid docking
simulator", IEEE Trans. Industrial Electronics 62(10), 2015.

G and Y are measured on the rig itself, effects and friction of its drives included: one run follows a sum of sines, one holds its place
under a force that is one.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array
from hiltestbed.ledger import force_path_delay
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario, load_scenario, resolved, scenario_from

Complex = NDArray[np.complex128]
LINES = 100  # [Hz] sines at 1, 2, ... Hz
PERIOD = 1.0  # [s] of their sum, measured after as long a lead-in
SWING, PULL = 1e-3, 0.3  # [m], [m/s^2] a sine's amplitude and acceleration, at most
PUSH = 20.0  # [N] of a sine of the force
FINE = 50  # points between two lines
WIDEST = 1e3  # times the stiffness, up to and down to which its limit is looked for


@dataclass(frozen=True)
class RigResponse:
    """Measured along the insertion, all (L,): frequency [Hz] from 0 on; follows, pose over command; yields, to the contact force [m/N]."""

    frequency: Array
    follows: Complex
    yields: Complex

    def finer(self) -> RigResponse:
        """Interpolated to :data:`FINE` points a line."""
        f = np.linspace(self.frequency[0], self.frequency[-1], FINE * (len(self.frequency) - 1) + 1)
        parts = [np.interp(f, self.frequency, x.real) + 1j * np.interp(f, self.frequency, x.imag) for x in (self.follows, self.yields)]
        return RigResponse(f, parts[0], parts[1])


EXACT = RigResponse(np.arange(0.0, 2001.0), np.ones(2001, dtype=complex), np.zeros(2001, dtype=complex))


@dataclass(frozen=True)
class Stability:
    """What the loop leaves of a contact's damping.

    Attributes:
        stable: the contact loses energy. frequency: at which it swings [Hz]. damping: of the contact [N s/m]; net_damping: what is left
        [N s/m]. delay: of the force that is used, compensation taken off [s]; largest_delay: at which no damping is left [s], below 0
        where the platform alone takes more than there is; delay_margin: what is left [s]. stiffness: of the contact, largest_stiffness:
        at which no damping is left [N/m], None beyond a thousand times it.
        compensated: the compensation of the scenario counts as its ledger has it.
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

    def sentence(self) -> str:
        """The verdict, with what to act on."""
        head = "stable" if self.stable else "unstable"
        parts = [f"{head}: net damping {self.net_damping:+.4g} N s/m of {self.damping:g}"]
        if self.largest_delay is not None:
            parts.append(f"largest delay {1e3 * self.largest_delay:.3g} ms (now {1e3 * round(self.delay, 9):.3g} ms)")
        if self.largest_stiffness is not None:
            parts.append(f"largest stiffness {self.largest_stiffness:.3g} N/m (now {self.stiffness:.3g} N/m)")
        return "; ".join(parts)


def stability(scenario: Scenario) -> dict[str, Any] | None:
    """``summary["stability"]`` of a scenario: with its compensation, and under `uncompensated` without; None where there is no loop,
    or the contact swings faster than the rig was measured."""
    if scenario.rig.platform.physical:
        return None
    response = measured_response(scenario)
    bare = judge(scenario, response, force_path_delay(scenario, compensated=False), compensated=False)
    if bare is None:
        return None
    without = asdict(bare) | {"verdict": bare.sentence()}
    force = scenario.compensation.force
    if force.adds_force:
        said = f"not judged with {force.kind}, which adds a force of its own; without it {bare.sentence()}"
        return dict.fromkeys(asdict(bare)) | {"compensated": True, "verdict": said, "uncompensated": without}
    corrects = scenario.compensation.force.corrects_platform or scenario.compensation.motion.corrects_force
    used = EXACT if corrects else response
    found = judge(scenario, used, force_path_delay(scenario, compensated=True), compensated=True)
    return asdict(found) | {"verdict": found.sentence(), "uncompensated": without} if found is not None else None


def stability_of_file(path: str | Path) -> dict[str, Any] | None:
    """The same of a scenario's file, which holds."""
    return stability(load_scenario(path))


def judge(scenario: Scenario, response: RigResponse, delay: float, compensated: bool = True) -> Stability | None:
    """The stability of a scenario's contact on a rig of that response with a force that is ``delay`` [s] late; None where its frequency
    was not measured."""
    contact, mass = scenario.mechanism.contact, effective_mass(scenario)
    fine = response.finer()
    found = net_damping(fine, mass, contact.stiffness, contact.damping, delay)
    if found is None:
        return None
    frequency, left = found
    largest = largest_delay(fine, mass, contact.stiffness, contact.damping)
    stiffest = _largest_stiffness(fine, mass, contact.stiffness, contact.damping, delay, left > 0.0)
    return Stability(
        stable=bool(left > 0.0),
        frequency=frequency,
        damping=contact.damping,
        net_damping=left,
        delay=delay,
        largest_delay=largest,
        delay_margin=None if largest is None else largest - delay,
        stiffness=contact.stiffness,
        largest_stiffness=stiffest,
        compensated=compensated,
    )


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


def _largest_stiffness(fine: RigResponse, mass: float, stiffness: float, damping: float, delay: float, stable: bool) -> float | None:
    """Stiffness [N/m] at which no damping is left, above the contact's own where it is stable, else below it."""

    def left(factor: float) -> bool | None:
        found = net_damping(fine, mass, stiffness * factor, damping, delay)
        return None if found is None else found[1] > 0.0

    factor = 1.0
    step = 1.25 if stable else 0.8
    while 1.0 / WIDEST < factor < WIDEST:
        following = factor * step
        state = left(following)
        if state is None:
            return None
        if state != stable:
            inside, outside = (factor, following) if stable else (following, factor)
            for _ in range(40):
                middle = math.sqrt(inside * outside)
                inside, outside = (middle, outside) if left(middle) else (inside, middle)
            return stiffness * inside
        factor = following
    return None


def measured_response(scenario: Scenario) -> RigResponse:
    """The response of a scenario's rig along the insertion; the same rig is measured once a process."""
    platform_effects = [e for e in scenario.effects if e.link == "platform"]
    if scenario.rig.platform.tracking == "ideal" and not platform_effects:
        return EXACT
    data = resolved(scenario)
    quiet = {
        "name": "response", "description": "", "seed": 0, "duration": 1.0, "sensor": {}, "identification": {"kind": "none"},
        "safety": dict.fromkeys(data["safety"]), "effects": [e for e in data["effects"] if e["kind"].startswith("platform.")],
        "approach": {"gap": 0.0, "velocity": [0.0, 0.0, 0.0]},
    }  # fmt: skip
    quiet["compensation"] = {"force": {"kind": "none"}, "motion": {"kind": "feedforward" if scenario.compensation.motion.feeds else "none"}}
    quiet["rig"] = data["rig"] | {"upper": {"kind": "fixed"}}
    quiet["mechanism"] = {k: v for k, v in data["mechanism"].items() if k != "latch"}
    return _measured(json.dumps(data | quiet, sort_keys=True))


@lru_cache(maxsize=64)
def _measured(scenario: str) -> RigResponse:
    return _measure(scenario_from(json.loads(scenario)))


class _Pushes:
    """No force on the run that follows, a sum of sines along z on the one that holds its place."""

    def __init__(self, wave: Array) -> None:
        self._wave, self._at, self._wrench = wave, 0, np.zeros((2, 6))

    def next(self) -> Array:
        self._wrench[1, 2] = self._wave[self._at % len(self._wave)]
        self._at += 1
        return self._wrench


def _measure(scenario: Scenario) -> RigResponse:
    tick, m = scenario.tick, scenario.substeps
    lines = np.arange(1, int(min(LINES, 0.1 * scenario.rate)) + 1)
    phase = -math.pi * lines * (lines - 1) / len(lines)  # Schroeder's: the sum has no peak
    w = 2.0 * math.pi * lines / PERIOD
    size = np.minimum(SWING, PULL / w**2)
    period = round(PERIOD / tick)

    def wave(t: Array, order: int) -> Array:
        """The sum of sines, or its first or second derivative."""
        return (size * w**order * np.sin(w * t[:, None] + phase + 0.5 * math.pi * order)).sum(axis=1)

    ends = np.arange(1, 2 * period + 1) * tick
    place = wave(ends, 0)
    # The velocity of a tick belongs to its middle, its acceleration to its start.
    speed, bend = wave(ends - 0.5 * tick, 1), wave(ends - tick, 2)
    instants = np.arange(period * m) * tick / m
    push = PUSH * np.sin(w * instants[:, None] + phase).sum(axis=1)
    plant = Plant([scenario, scenario], force=_Pushes(push))
    pose, twist, accel = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (2, 1)), np.zeros((2, 6)), np.zeros((2, 6))
    pose[0, 2], twist[0, 2] = wave(np.zeros(1), 0)[0], wave(np.zeros(1), 1)[0]
    plant.reset(pose, twist)
    reached = np.empty((2 * period, 2))
    for k in range(2 * period):
        pose[0, 2], twist[0, 2], accel[0, 2] = place[k], speed[k], bend[k]
        plant.advance(pose, twist, accel)
        reached[k] = plant.pose_act[:, 2]
    answer = np.fft.rfft(reached[period:], axis=0)[lines]
    follows = answer[:, 0] / np.fft.rfft(place[period:])[lines]
    # The force of the instants t_k, the first of which is the start: one row later than the pose that is reached at the end of a tick.
    force = np.fft.rfft(np.roll(push[::m], -1))[lines]
    yields = -answer[:, 1] / force
    return RigResponse(
        np.concatenate([[0.0], lines / PERIOD]), np.concatenate([[1.0], follows]), np.concatenate([[yields[0].real], yields])
    )
