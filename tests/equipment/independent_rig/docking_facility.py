"""Random docking facilities: probe and cone with friction, tilt and spin, captured or not, rigid or
on a mount; or held.

The forces of a docking have no closed form: its scales (peak, depth, duration) are taken from
healthy runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from tests.equipment.independent_rig.closed_loop import simulate
from tests.equipment.independent_rig.cone import Surfaces, clearance
from tests.equipment.independent_rig.facility import (
    KNOWN,
    Facility,
    draw_body,
    known_contact,
    log_uniform,
    rounded,
    scenario_of,
)
from tests.equipment.independent_rig.links import Records, silence
from tests.equipment.independent_rig.rig import docking_rig, overridden
from tests.equipment.independent_rig.rotation import from_attitude, matrix, product, turn

SIX = "six axes"  # in a facility's design: the rig has six axes
DESCRIPTION = "A probe meets its cone off the axis, with the facility's nominal rig."
SPEEDS = (0.4, 0.55, 0.75, 1.0, 0.6, 0.6)  # of each run, relative to the fastest
LONGEST, SHORTEST = 4.0, 1.2  # s, limits of the duration
AFTER = 0.5  # s from the last capture to the end of the runs
SCREENED = 4.5  # s, duration of the healthy runs from which the final duration is determined
LOWEST, HIGHEST = 10.0, 3000.0  # N, limits of a run's peak
FEWEST = 40  # smallest number of rows in contact
COARSE = 4  # sub-steps of the healthy runs
# effective mass at a wall off the axis over the reduced mass: the vehicles rotate as well
CONE_SHARE = 0.4
BODY = 120.0  # kg on the mount


@dataclass(frozen=True)
class DockingFacility(Facility):
    """A facility whose rig has six axes; its scales come from healthy runs.

    Attributes:
        peaks: largest force on an axis, of each run [N]. spans: duration of contact, of each run
            [s].
    """

    peaks: tuple[float, ...] = ()
    spans: tuple[float, ...] = ()

    @property
    def peak(self) -> float:
        return float(np.median(self.peaks))

    @property
    def top_peak(self) -> float:
        return max(p for i, p in enumerate(self.peaks) if i not in KNOWN)

    @property
    def depth(self) -> float:
        return self.peak / self.stiffness

    @property
    def frequency(self) -> float:
        return math.sqrt(self.stiffness / (CONE_SHARE * self.reduced_mass)) / (2.0 * math.pi)

    @property
    def span(self) -> float:
        return float(np.median(self.spans))

    @property
    def side(self) -> float:
        return max(max(math.hypot(*r["approach.offset"]) for r in self.runs), 1e-4)

    def expected_peak(self, run: int) -> float:
        return self.peaks[run]


def draw_docking_facility(rng: Generator, design: str = "docking") -> DockingFacility:
    """A random docking facility: docking | mounted (on a compliant mount) | held (latched)."""
    for _ in range(100):
        scenario = _scenario(rng, design)
        touch_time = rng.uniform(0.12, 0.25)
        fast = log_uniform(rng, 0.05, 0.1) if design != "held" else log_uniform(rng, 0.01, 0.04)
        speeds = [rounded(fast * part, 3) for part in SPEEDS]
        runs = [_run(rng, i, v, touch_time, design, scenario) for i, v in enumerate(speeds)]
        healthy = _all_healthy(scenario, runs)
        if len(healthy) < len(runs):
            continue
        scenario["duration"] = _duration(healthy, scenario["rate"], design)
        ticks = round(scenario["duration"] * scenario["rate"])
        inside = [r.touching[:ticks] for r in healthy]
        peaks = [float(np.abs(r.physical[:ticks, :3]).max()) for r in healthy]
        if min(t.sum() for t in inside) < FEWEST or min(peaks) < LOWEST:
            continue
        spans = tuple(float(t.sum() / scenario["rate"]) for t in inside)
        middle = float(np.median(peaks))
        noise = rounded(min(max(log_uniform(rng, 8e-4, 2.5e-3) * middle, 0.03), 1.0), 2)
        torque_noise = rounded(noise * rng.uniform(0.04, 0.1), 2)
        scenario["sensor"] |= {"noise": noise, "torque_noise": torque_noise}
        pose = rng.uniform(1e-6, 2.5e-6)
        return DockingFacility(
            scenario,
            runs,
            speeds,
            torque_noise,
            pose,
            0.5 * pose,
            touch_time,
            frozenset({SIX, design}),
            tuple(peaks),
            spans,
        )
    raise RuntimeError(f"no {design} facility in 100 draws")


def _scenario(rng: Generator, design: str) -> dict:
    while True:
        ranges = (300.0, 2000.0), (1000.0, 8000.0), (2e4, 1e5)
        chaser, target, stiffness = (rounded(log_uniform(rng, *ends), 3) for ends in ranges)
        delay = float(rng.integers(1, 6)) / 1000.0
        rate = int(rng.choice([1000, 2000]))
        reduced = 1.0 / (1.0 / chaser + 1.0 / target)
        fastest = math.sqrt(2.0 * stiffness / (CONE_SHARE * reduced))
        if fastest * delay < 0.2 and math.pi / fastest * rate >= 40.0:
            break
    share = 0.7 if design == "held" else 1.0
    damping = rounded(2.0 * share * rng.uniform(0.1, 0.25) * math.sqrt(stiffness * reduced), 3)
    mechanism: dict[str, Any] = {
        "kind": "latched" if design == "held" else "probe_cone",
        "contact": {
            "stiffness": stiffness,
            "damping": damping,
            "friction": 0.0 if design == "held" else rounded(rng.uniform(0.05, 0.2), 2),
        },
    }
    if design != "held" and rng.random() < 0.6:
        mechanism["latch"] = {"depth": 0.004, "angle_deg": 5.0, "speed": 0.02}
    if design == "mounted":
        mechanism["mount"] = _mount(rng, stiffness)
    of_body = (0.3, 0.8), 0.08, (0.8, 1.5)
    return scenario_of(
        DESCRIPTION,
        (SCREENED, rate, 4 * rate),
        (draw_body(rng, chaser, 1.0, *of_body), draw_body(rng, target, -1.0, *of_body)),
        (0.05, 0.05),
        mechanism=mechanism,
        platform={"tracking": "ideal"},
        sensor={
            "delay": delay,
            "lowpass": None,
            "time_constant": None,
            "noise": 0.1,
            "torque_noise": 0.01,
        },
        compensation={"kind": "phase_lead"},
    )


def _mount(rng: Generator, stiffness: float) -> dict:
    """Springs 5 to 20 times as stiff as the contact, rotational ones as if on a ring of 0.3 m
    radius.

    Damping ratio 8 to 20 %: with less, the loop's delay makes most of them unstable once the latch
    has closed.
    """
    springs = [rounded(stiffness * rng.uniform(5.0, 20.0), 3) for _ in range(3)]
    springs += [rounded(springs[i] * 0.3**2 * rng.uniform(0.7, 1.4), 3) for i in range(3)]
    ratio = rng.uniform(0.08, 0.2)
    inertias = [BODY] * 3 + [20.0, 20.0, 10.0]  # about P
    pairs = zip(springs, inertias, strict=True)
    dampers = [rounded(2.0 * ratio * math.sqrt(k * m), 3) for k, m in pairs]
    return {"stiffness": springs, "damping": dampers}


def _run(
    rng: Generator, number: int, speed: float, touch_time: float, design: str, scenario: dict
) -> dict:
    """Changed keys of a run: place, tilt and rate; the last two have other known springs."""
    azimuth = rng.uniform(-math.pi, math.pi)
    held = design == "held"
    far = rng.uniform(5e-4, 2e-3) if held else rng.uniform(0.015, 0.07)
    tilt, spin = (0.15, 0.3) if held else (1.5, 1.0)
    sideways = rng.uniform(-0.15, 0.15, 2) * speed
    turned = rng.uniform(-tilt, tilt, 3)
    rates = rng.uniform(-spin, spin, 3) * np.array([0.3, 0.3, 1.0])
    changes: dict[str, Any] = {
        "approach.velocity": [rounded(sideways[0], 2), rounded(sideways[1], 2), speed],
        "approach.offset": [rounded(far * f(azimuth), 3) for f in (math.cos, math.sin)],
        "approach.attitude_deg": [rounded(v, 2) for v in turned],
        "approach.rate_deg": [rounded(v, 2) for v in rates],
    }
    changes |= known_contact(number, scenario)
    # The first touch is between two ticks: exactly on a tick, noise would decide in which tick the
    # force begins.
    ticks = math.floor(touch_time * scenario["rate"]) + rng.uniform(0.3, 0.7)
    changes["approach.gap"] = 0.0 if held else rounded(_gap(changes, ticks / scenario["rate"]), 6)
    return changes


def _gap(changes: dict, time: float) -> float:
    """The gap [m] for which the tip touches at `time` [s] of a uniform approach, by bisection."""
    surfaces, normal = Surfaces(), np.zeros(3)
    velocity = np.array(changes["approach.velocity"], dtype=float)
    rate = np.radians(np.array(changes["approach.rate_deg"], dtype=float))
    axis = matrix(product(turn(time * rate), from_attitude(changes["approach.attitude_deg"])))[:, 2]
    place = np.array([*changes["approach.offset"], 0.0]) + time * velocity - surfaces.tip * axis
    low, high = 0.0, 0.4  # below and above the gap of touch
    for _ in range(60):
        middle = 0.5 * (low + high)
        free = clearance(surfaces, place - np.array([0.0, 0.0, middle]), normal) > surfaces.tip
        low, high = (low, middle) if free else (middle, high)
    return 0.5 * (low + high)


def _all_healthy(scenario: dict, runs: list[dict]) -> list[Records]:
    """The healthy runs, up to the first that is unstable or has no contact."""
    found = []
    for changes in runs:
        rig = docking_rig(overridden(scenario, changes | {"duration": SCREENED}))
        rig = rig._replace(timing=rig.timing._replace(substeps=COARSE))
        records = simulate(rig, silence(rig.ticks))
        force = np.abs(records.physical[:, :3]).max()
        if not force < HIGHEST or not records.touching.any():
            break
        found.append(records)
    return found


def _duration(healthy: list[Records], rate: float, design: str) -> float:
    """Duration of the docking, within limits [s]."""
    if design == "held":
        return 1.5
    closed = [r.captured / rate for r in healthy if 0 <= r.captured < len(r.pose_cmd)]
    wanted = max(closed) + AFTER if closed else LONGEST
    return math.ceil(10.0 * min(max(wanted, SHORTEST), LONGEST)) / 10.0
