"""Contacts of the benchmarks: frequency, delay and damping ratio of a bounce; random rigs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hiltestbed.analysis.metrics import ContactFigures
from hiltestbed.bench.contenders import Briefing
from hiltestbed.build import runnable_from
from hiltestbed.frames import Array
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.scenario import Scenario
from hiltestbed.signals import AXES, Trace

FREQUENCIES = (1.0, 2.0, 4.0, 8.0)  # [Hz]
DELAYS = (0.002, 0.005, 0.010, 0.020)  # [s]
DAMPING_RATIOS = (0.02, 0.05, 0.2)
RATE = 2000.0
AXIAL = AXES.index("z")
# until the touch; with a touch on a tick, round-off would decide whether the force starts at that
# tick
APPROACH_TICKS = 60.37
MASSES = (500.0, 2000.0)  # [kg] chaser, target
ARM = 0.05  # [m] ratio of torque noise to force noise


@dataclass(frozen=True)
class BenchContact:
    """One contact and the knowledge of the delay.

    Attributes:
        frequency: sqrt(k/mu)/2 pi [Hz]. delay: true delay of the force [s]. noise: 1 sigma over the
            peak force.
        delay_knowledge: exact; off: the nominal delay is 1/1.2 of the true one; jitter: with a
            sigma of a tenth of the delay.
    """

    frequency: float
    delay: float
    damping_ratio: float
    delay_knowledge: str = "exact"
    tracking: str = "ideal"
    noise: float = 0.002
    seed: int = 1
    masses: tuple[float, float] = MASSES
    speed: float = 0.03  # [m/s]
    changes: dict[str, Any] = field(default_factory=dict)  # of the scenario: a random rig

    @property
    def mass(self) -> float:
        """Reduced mass [kg] of a centred hit."""
        return self.masses[0] * self.masses[1] / sum(self.masses)

    @property
    def w(self) -> float:
        return 2.0 * math.pi * self.frequency

    @property
    def duration(self) -> float:
        """Duration of a run [s]: approach, bounce, and the delayed end of the force."""
        return (APPROACH_TICKS + 80.0) / RATE + 1.25 * math.pi / self.w + 3.0 * self.delay

    @property
    def stiffness(self) -> float:
        return self.mass * self.w**2

    @property
    def damping(self) -> float:
        return 2.0 * self.damping_ratio * self.mass * self.w

    @property
    def peak(self) -> float:
        """Peak force [N] without damping."""
        return self.speed * math.sqrt(self.stiffness * self.mass)

    @property
    def believed_delay(self) -> float:
        return self.delay / 1.2 if self.delay_knowledge == "off" else self.delay

    @property
    def briefing(self) -> Briefing:
        return Briefing(self.stiffness, self.damping, self.peak, self.believed_delay)

    def scenario(
        self,
        force: dict[str, Any],
        identification: dict[str, Any] | None = None,
        motion: str = "feedforward",
    ) -> Scenario:
        """The contact with a force compensation."""
        effects = {
            "exact": [],
            "off": [{"kind": "sensor.delay", "delay": self.delay - self.believed_delay}],
            "jitter": [{"kind": "sensor.jitter", "sigma": 0.1 * self.delay}],
        }
        data = {
            "name": f"bounce-{self.frequency:g}Hz-{1e3 * self.delay:g}ms"
            f"-zeta{self.damping_ratio:g}",
            "seed": self.seed,
            "rate": RATE,
            "physics_rate": 2.0 * RATE,
            "duration": self.duration,
            "spacecraft": {
                "chaser": _body(self.masses[0], [0.0, 0.0, 1.0]),
                "target": _body(self.masses[1], [0.0, 0.0, -1.0]),
            },
            "approach": {
                "gap": APPROACH_TICKS * self.speed / RATE,
                "velocity": [0.0, 0.0, self.speed],
            },
            "mechanism": {
                "kind": "bumper",
                "contact": {"stiffness": self.stiffness, "damping": self.damping},
            },
            "rig": {"platform": {"tracking": self.tracking}},
            "sensor": {
                "delay": self.believed_delay,
                "noise": self.noise * self.peak,
                "torque_noise": ARM * self.noise * self.peak,
            },
            "compensation": {"force": force, "motion": {"kind": motion}},
            "identification": identification or {"kind": "rls"},
            "effects": effects[self.delay_knowledge],
        }
        return runnable_from(data, self.changes)


def _body(mass: float, port: list[float]) -> dict[str, Any]:
    inertia = 0.36 * mass  # a homogeneous ball of 0.95 m
    return {"mass": mass, "inertia": [inertia, inertia, inertia], "port": {"position": port}}


def grid(
    frequencies: tuple[float, ...] = FREQUENCIES, delays: tuple[float, ...] = DELAYS, **same: Any
) -> list[BenchContact]:
    """Every combination of frequency, delay and damping ratio."""
    ratios = same.pop("damping_ratios", DAMPING_RATIOS)
    return [BenchContact(f, d, z, **same) for z in ratios for f in frequencies for d in delays]


def random_rigs(count: int, seed: int) -> list[BenchContact]:
    """Random rigs: masses, contact, delay, speed, off-axis hits with tilt, sliding and friction."""
    rng = np.random.default_rng(seed)

    def scaled(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(*np.log([low, high]))))

    rigs = []
    for i in range(count):
        masses = scaled(300.0, 8000.0), scaled(500.0, 1e5)
        changes = {
            "approach.offset": rng.uniform(-0.1, 0.1, 2).tolist(),
            "approach.attitude_deg": rng.uniform(-3.0, 3.0, 3).tolist(),
            "approach.rate_deg": rng.uniform(-0.3, 0.3, 3).tolist(),
            "mechanism.contact.friction": float(rng.uniform(0.02, 0.3)),
        }
        contact = scaled(1.0, 6.0), scaled(0.002, 0.02), scaled(0.02, 0.2)
        own: dict[str, Any] = {"seed": seed + i, "masses": masses, "speed": scaled(0.01, 0.06)}
        rigs.append(BenchContact(*contact, tracking="servo", changes=changes, **own))
    return rigs


def effort(contacts: Sequence[BenchContact], ticks: float | None = None) -> float:
    """Estimated time of a batch of bounces, roughly in seconds of one core; ``ticks``: number of
    ticks, by default from their duration.

    The estimate includes start, checks of each scenario, and the cost of a tick of the loop and of
    each run in it, doubled with servo
    tracking. Only ratios matter: they serve the progress display.
    """
    n, servo = len(contacts), contacts[0].tracking == "servo"
    each = RATE * max(c.duration for c in contacts) if ticks is None else ticks
    return 0.1 + 0.01 * n + each * (2e-4 + 5e-5 * n) * (2.0 if servo else 1.0)


@dataclass
class BenchRuns:
    """Result of a batch of bounces.

    Attributes:
        figures: one per run.
        velocity: ``(n, 2, 6)`` of both bodies when the rebound speed was determined, NaN without a
            rebound. start: ``(n, 2, 6)`` at t = 0.
        loop: the loop that was run, with its estimator.
        trace: rows, if requested.
    """

    figures: list[ContactFigures]
    velocity: Array
    start: Array
    loop: Loop
    trace: Trace | None = None


def bounce(scenarios: list[Scenario], trace: bool = False, nthread: int = 2) -> BenchRuns:
    """Run a batch until every run has rebounded or reached its duration."""
    loop = Loop(scenarios, nthread)
    ticks = max(s.ticks for s in scenarios)
    rows = Trace(ticks, len(scenarios), RATE, loop.plant.units) if trace else None
    craft = loop.model
    start, velocity = craft.v.copy(), np.full_like(craft.v, np.nan)
    seen = np.zeros(len(scenarios), dtype=bool)
    while loop.k < ticks and loop.alive.any():
        loop.step(rows)
        new = loop.tally.rebounded & ~seen
        if new.any():
            velocity[new] = craft.v[new]
            seen |= new
            if seen.all():
                break
    if rows is not None:
        rows.length[:] = loop.k
    figures = [loop.tally.figures(i) for i in range(len(scenarios))]
    at_the_end = ~seen & np.array([f.rebound_speed is not None for f in figures])
    velocity[at_the_end] = craft.v[at_the_end]
    return BenchRuns(figures, velocity, start, loop, rows)


def effective_contact(contact: BenchContact) -> float:
    """w tau of a contact, including the lever arms of an off-axis hit."""
    scenario = contact.scenario({"kind": "none"})
    return (
        math.sqrt(scenario.mechanism.contact.stiffness / effective_mass(scenario.spacecraft))
        * contact.delay
    )
