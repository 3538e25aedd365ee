"""Random facilities: a nominal scenario and the six runs of its test campaign."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

DESCRIPTION = "Axial contact through a flat bumper, with the facility's nominal rig."


def rounded(value: float, digits: int = 4) -> float:
    """`value` rounded to `digits` significant digits, as numbers in a hand-written file."""
    return float(f"{value:.{digits}g}")


def sign(rng: Generator) -> float:
    """1 or -1."""
    return 1.0 if rng.random() < 0.5 else -1.0


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


@dataclass(frozen=True)
class Facility:
    """The nominal rig and the test runs of a facility.

    Attributes:
        scenario: the nominal scenario, as in its file. runs: changed keys of each run.
        speeds: axial, of each run [m/s]. torque_noise [N m], pose_noise [m], turn_noise [-]: 1
            sigma, not in the scenario.
        design: what the runs excite in addition to the axial contact: any of "slide", "offset",
            "latched", "friction".
        stiffness [N/m], damping [N s/m], noise [N] (of a force axis): nominal.
        frequency [Hz], contact_time [s], half a period: of the contact with the nominal spring.
        depth [m], peak [N]: of a run at the middle speed; top_peak [N]: of the fastest run.
    """

    scenario: dict
    runs: list[dict]
    speeds: list[float]
    torque_noise: float
    pose_noise: float
    turn_noise: float
    touch_time: float
    design: frozenset[str]

    @property
    def contact(self) -> dict[str, float]:
        """Of the nominal scenario."""
        return self.scenario["mechanism"]["contact"]

    @property
    def stiffness(self) -> float:
        return self.contact["stiffness"]

    @property
    def damping(self) -> float:
        return self.contact["damping"]

    @property
    def noise(self) -> float:
        return self.scenario["sensor"]["noise"]

    @property
    def reduced_mass(self) -> float:
        chaser, target = (self.scenario["spacecraft"][b]["mass"] for b in ("chaser", "target"))
        return 1.0 / (1.0 / chaser + 1.0 / target)

    @property
    def frequency(self) -> float:
        return math.sqrt(self.stiffness / self.reduced_mass) / (2.0 * math.pi)

    @property
    def contact_time(self) -> float:
        return 0.5 / self.frequency

    @property
    def tick(self) -> float:
        return 1.0 / self.scenario["rate"]

    @property
    def top_speed(self) -> float:
        return max(self.speeds)

    @property
    def middle_speed(self) -> float:
        return float(np.median(self.speeds))

    @property
    def depth(self) -> float:
        return self.middle_speed / (2.0 * math.pi * self.frequency)

    @property
    def peak(self) -> float:
        return self.depth * self.stiffness

    @property
    def top_peak(self) -> float:
        return self.peak * self.top_speed / self.middle_speed

    @property
    def side(self) -> float:
        """Largest distance from the axis in runs that slide or are offset [m]."""
        far = [math.hypot(*r.get("approach.offset", [0.0, 0.0])) for r in self.runs]
        fastest = max(abs(r["approach.velocity"][0]) for r in self.runs)
        return max(*far, fastest * (self.touch_time + self.contact_time), 1e-4)

    def expected_peak(self, run: int) -> float:
        """Largest force [N] of a run of the healthy rig."""
        own = self.runs[run].get("mechanism.contact.stiffness", self.stiffness)
        factor = math.sqrt(own / self.stiffness)
        return factor * self.peak * self.speeds[run] / self.middle_speed


def draw_facility(rng: Generator, design: frozenset[str]) -> Facility:
    """A random facility, whose contact is neither too short for its rate nor too fast for its
    delay.
    """
    while True:
        chaser, target = log_uniform(rng, 200.0, 1500.0), log_uniform(rng, 500.0, 10000.0)
        stiffness, delay = log_uniform(rng, 2e4, 5e5), float(rng.integers(1, 11)) / 1000.0
        rate = int(rng.choice([1000, 2000]))
        reduced = 1.0 / (1.0 / chaser + 1.0 / target)
        # rad/s, with the stiffer of the known springs
        fastest = math.sqrt(2.0 * stiffness / reduced)
        if fastest * delay < 0.4 and math.pi / fastest * rate >= 40.0 and fastest > 12.0:
            break
    chaser, target, stiffness = (rounded(v, 3) for v in (chaser, target, stiffness))
    ratio = log_uniform(rng, 0.02, 0.15)
    damping = rounded(2.0 * ratio * math.sqrt(stiffness * reduced), 3)
    fast = log_uniform(rng, 0.06, 0.1)
    speeds = [rounded(fast * part, 2) for part in (0.25, 0.375, 0.625, 1.0, 0.5, 0.5)]
    touch_time = 0.1 + 0.1 * rng.random()
    longest = math.pi / (fastest / 2.0)
    peak = fast * math.sqrt(stiffness * reduced)
    noise = rounded(min(max(log_uniform(rng, 2e-4, 7e-4) * peak, 0.05), 1.5), 2)
    friction = rounded(rng.uniform(0.05, 0.2), 2) if "friction" in design else 0.0
    latched = "latched" in design
    duration = touch_time + (2.0 if latched else 1.3) * longest + 0.3
    fine = 4 * rate if rng.random() < 0.5 else 2 * rate
    timing = round(math.ceil(duration * 10.0) / 10.0, 1), rate, fine
    of_body = (0.25, 0.6), 0.12, (0.7, 1.4), "offset" not in design
    scenario = scenario_of(
        DESCRIPTION,
        timing,
        (draw_body(rng, chaser, 1.0, *of_body), draw_body(rng, target, -1.0, *of_body)),
        (rounded(speeds[1] * touch_time, 2), speeds[1]),
        mechanism={
            "kind": "latched" if latched else "bumper",
            "contact": {"stiffness": stiffness, "damping": damping, "friction": friction},
        },
        platform={"tracking": "ideal"},
        sensor={"delay": delay, "lowpass": None, "time_constant": None, "noise": noise},
        compensation={"kind": "phase_lead"},
    )
    runs = [_run(rng, i, v, touch_time, design, scenario) for i, v in enumerate(speeds)]
    pose = rng.uniform(1e-6, 2.5e-6)
    return Facility(
        scenario, runs, speeds, rng.uniform(0.01, 0.04), pose, 0.5 * pose, touch_time, design
    )


def draw_body(
    rng: Generator,
    mass: float,
    side: float,
    sizes: tuple[float, float],
    across: float,
    reach: tuple[float, float],
    centred: bool = False,
) -> dict:
    """A body of a scenario: mass [kg], and a port on its `side` of it.

    ``sizes`` [m^2]: range of inertia over mass. ``across`` [m]: largest distance of the port from
    the axis, so that the contact rotates this body as well; `centred`: none. ``reach`` [m]: range
    of its distance along the axis.
    """
    size = log_uniform(rng, *sizes)
    inertia = [rounded(mass * size * rng.uniform(0.8, 1.1), 2) for _ in range(3)]
    place = [0.0 if centred else rounded(v, 2) for v in rng.uniform(-across, across, 2)]
    port = {
        "position": [*place, side * rounded(rng.uniform(*reach), 2)],
        "attitude_deg": [0, 0, 0],
    }
    return {"mass": mass, "inertia": inertia, "port": port}


def scenario_of(description: str, timing: tuple, bodies: tuple, start: tuple, **more: Any) -> dict:
    """A scenario. ``timing``: duration, rate and physics rate. ``bodies``: chaser and target.
    ``start``: gap and speed. ``more``: mechanism, platform, sensor, compensation.
    """
    (duration, rate, physics_rate), (chaser, target), (gap, speed) = timing, bodies, start
    return {
        "name": "facility",
        "description": description,
        "seed": 1,
        "duration": duration,
        "rate": rate,
        "physics_rate": physics_rate,
        "spacecraft": {"chaser": chaser, "target": target},
        "approach": {
            "gap": gap,
            "velocity": [0.0, 0.0, speed],
            "offset": [0.0, 0.0],
            "attitude_deg": [0, 0, 0],
            "rate_deg": [0, 0, 0],
        },
        "mechanism": more["mechanism"],
        "rig": {"platform": {"kind": "pss33", **more["platform"]}},
        "sensor": more["sensor"],
        "compensation": {"force": more["compensation"], "motion": {"kind": "none"}},
        "identification": {"kind": "rls"},
        "effects": [],
    }


def _run(
    rng: Generator,
    number: int,
    speed: float,
    touch_time: float,
    design: frozenset[str],
    scenario: dict,
) -> dict:
    """Changed keys of run `number`: two of the first four runs slide, the last two have other known
    springs.
    """
    slides = number in (1, 3) and "slide" in design
    sideways = [
        rounded(rng.uniform(0.1, 0.25) * speed, 1) * sign(rng) if slides else 0.0 for _ in range(2)
    ]
    if rng.random() < 0.5:
        sideways[1] = 0.0
    # The touch is between two ticks: exactly on a tick, noise would decide in which tick the force
    # begins.
    ticks = math.floor(touch_time * scenario["rate"]) + rng.uniform(0.25, 0.75)
    gap = 0.0 if "latched" in design else rounded(speed * ticks / scenario["rate"], 5)
    changes: dict = {"approach.velocity": [*sideways, speed], "approach.gap": gap}
    if "offset" in design and number in (1, 2, 3, 4):
        far = rng.uniform(0.04, 0.12, 2) * rng.choice([-1.0, 1.0], 2)
        changes["approach.offset"] = [rounded(v, 2) for v in far]
    return changes | known_contact(number, scenario)


# runs with other known springs, and their stiffness relative to the nominal one
KNOWN = {4: 0.5, 5: 2.0}


def known_contact(number: int, scenario: dict) -> dict[str, float]:
    """The changed keys of the contact of run `number`."""
    if number not in KNOWN:
        return {}
    factor, contact = KNOWN[number], scenario["mechanism"]["contact"]
    return {
        "mechanism.contact.stiffness": factor * contact["stiffness"],
        "mechanism.contact.damping": math.sqrt(factor) * contact["damping"],
    }
