"""The numbers of a dataset with which an experiment is laid out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hiltestbed.diagnosis.result import Cause
from hiltestbed.measured import MeasuredDataset

MAX_SWEEP = 2e-3  # [m] amplitude of a sweep
LOGGED = ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp")


@dataclass(frozen=True)
class Facts:
    """Of a dataset and of what was named in it.

    Attributes:
        springs: nominal stiffnesses of the runs [N/m], in order. stiffness: the scenario's [N/m].
            damping: [N s/m].
        mass: reduced mass [kg]. target: mass of the target [kg]. slow, fast: approach speeds [m/s].
            peak: force [N].
        depth: penetration [m]. noise: of the force [N]. tick: [s]. delay: nominal, of the sensor
            [s]. lateral: a run slides sideways.
        lacking: channels of the loop that some run did not record. estimates: effect to its
            parameters.
    """

    springs: tuple[float, ...]
    stiffness: float
    damping: float
    mass: float
    target: float
    slow: float
    fast: float
    peak: float
    depth: float
    noise: float
    tick: float
    delay: float
    lateral: bool
    captured: bool = False
    axis: str = "z"
    stroke: float = 2e-3
    lacking: frozenset[str] = frozenset()
    estimates: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def estimate(self, *names: str, other: float) -> float:
        """Magnitude of the first parameter, by `effect parameter`, whose estimate is there and not
        zero; `other` where there is none.
        """
        return next((v for v in map(self._size, names) if v), other)

    def largest(self, *names: str, least: float) -> float:
        """The largest magnitude of some parameters' estimates, not below `least`."""
        return max(*map(self._size, names), least)

    def _size(self, name: str) -> float:
        effect, parameter = name.split()
        value = self.estimates.get(effect, {}).get(parameter)
        return abs(float(value)) if isinstance(value, (int, float)) else 0.0

    def log(self, channel: str) -> str:
        """Words that ask for a channel, where it was not recorded."""
        return f" (log {channel} too)" if channel in self.lacking else ""

    @property
    def frequency(self) -> float:
        """Angular frequency of the contact [rad/s]."""
        return math.sqrt(self.stiffness / self.mass)

    def new_springs(self, ratio: float = 4.0) -> tuple[float, float]:
        """A softer and a stiffer spring than any of the dataset [N/m], `ratio` beyond the
        scenario's at least.
        """
        return rounded(min(self.springs[0] / 2, self.stiffness / ratio)), rounded(
            max(self.springs[-1] * 2, self.stiffness * ratio)
        )

    def with_spring(self, stiffness: float) -> dict[str, float]:
        """Keys of a run with another spring of the same damping ratio."""
        return {
            "mechanism.contact.stiffness": stiffness,
            "mechanism.contact.damping": rounded(
                self.damping * math.sqrt(stiffness / self.stiffness)
            ),
        }

    def at_speed(self, speed: float) -> dict[str, float]:
        """Keys of a run with another approach speed."""
        return {"approach.velocity.2": speed}


def facts_of(dataset: MeasuredDataset, causes: Sequence[Cause]) -> Facts:
    """From the scenarios, the survey of the contacts and the estimates."""
    runs, nominal = dataset.runs, dataset.nominal
    contact, bodies = nominal.mechanism.contact, nominal.spacecraft
    contacts = [c for r in runs for c in r.survey.contacts]
    speeds = sorted(
        abs(r.scenario.approach.velocity[2]) for r in runs if r.scenario.approach.velocity[2]
    ) or [0.03]
    mass = bodies.chaser.mass * bodies.target.mass / (bodies.chaser.mass + bodies.target.mass)
    depth = max((c.penetration or 0.0 for c in contacts), default=0.0) or speeds[-1] * math.sqrt(
        mass / contact.stiffness
    )
    noise = [
        r.survey.noise["wrench_meas.fz"].white for r in runs if "wrench_meas.fz" in r.survey.noise
    ]
    axis, stroke = _travel(dataset)
    return Facts(
        springs=tuple(sorted({r.scenario.mechanism.contact.stiffness for r in runs}))
        or (contact.stiffness,),
        stiffness=contact.stiffness,
        damping=contact.damping,
        mass=mass,
        target=bodies.target.mass,
        slow=speeds[0],
        fast=speeds[-1],
        peak=max((abs(c.peak_force or 0.0) for c in contacts), default=0.0)
        or contact.stiffness * depth,
        depth=depth,
        noise=max(noise, default=0.0),
        tick=nominal.tick,
        delay=nominal.sensor.delay,
        lateral=any(any(r.scenario.approach.velocity[:2]) for r in runs),
        captured=nominal.mechanism.captured,
        axis=axis,
        stroke=stroke,
        lacking=frozenset(g for g in LOGGED if not all(r.record.has(g) for r in runs)),
        estimates={
            e["kind"]: e for c in causes for told in (*c.alternatives, (c.entry(),)) for e in told
        },
    )


def _travel(dataset: MeasuredDataset) -> tuple[str, float]:
    """The axis of translation with the most travel, and half of that travel, at most MAX_SWEEP
    [m].
    """
    travel = {axis: 0.0 for axis in "zxy"}
    for run in dataset.runs:
        for axis in travel:
            for column in (f"pose_cmd.p{axis}", f"pose_act.p{axis}"):
                if run.record.has(column):
                    travel[axis] = max(
                        travel[axis],
                        float(np.ptp(run.record.column(column)[run.record.measured(column)])),
                    )
    axis = max(travel, key=lambda a: travel[a])
    return axis, rounded(min(0.5 * travel[axis], MAX_SWEEP)) or MAX_SWEEP


def rounded(value: float, digits: int = 2) -> float:
    """Rounded to significant digits, so that it can be set on a rig."""
    return float(f"{value:.{digits - 1}e}") if value else 0.0
