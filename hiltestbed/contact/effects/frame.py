"""The frame that carries the sensor is compliant, or vibrates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.contact.law import MODE_STEP
from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters
    from hiltestbed.scenario.like import ScenarioLike as Scenario

# [s^2] mass over the contact's stiffness of a frame ten times as stiff whose natural frequency is 3
# Hz
HEAVY = 10.0 / (6.0 * math.pi) ** 2
# of the contact's stiffness: lower bound of the frame stiffness searched for a captured mechanism
LITTLE = 0.01
# chosen: [Hz] of a mode, from which a search starts
FREQUENCIES = (3.3, 4.0, 4.8, 5.8, 7.0, 8.4, 10.5, 13.5, 17.5, 22.0, 28.0, 36.0, 60.0)
# chosen: of the frame to the contact, from which a search starts
STIFFNESS_RATIOS = (1.5, 5.0, 40.0)
# integration steps of the frame's mode per physics step: about 50 us of computing time
MOST_STEPS = 1000


@register
class FrameCompliance(Effect):
    """The sensor's frame is compliant: it deflects quasi-statically under the contact force."""

    kind: Literal["frame.compliance"] = "frame.compliance"
    stiffness: float = quantity(
        "N/m", "Stiffness of the frame", gt=0.0, search=(1e5, 1e9), ratio=True
    )
    link = "contact"
    equation = "x = pz - F/stiffness"
    reference = "springs in series"
    resembles = ("contact.stiffness",)
    leading = "stiffness"
    vanishes = True

    def apply(self, p: ContactParameters) -> None:
        share = self.stiffness / (self.stiffness + p.stiffness)
        match self.variant.get("damper"):
            case "in series":  # the damper acts on the contact's own deflection
                p.stiffness *= share
                p.damping *= share * share
                p.side_stiffness /= share  # the frame is compliant along the insertion only
                p.side_damping /= share * share
            case "whole rate":  # only the spring is in series, the damper acts on the whole rate
                p.stiffness *= share
                p.side_stiffness /= share
            case _:
                p.frame = self.stiffness

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        k = scales.stiffness
        bounds = {"stiffness": ((LITTLE if scales.captured else 0.3) * k, 3000.0 * k)}
        for variant in ({}, {"damper": "in series"}, {"damper": "whole rate"}):
            yield candidate(
                cls, {"stiffness": [2.0 * k, 8.0 * k, 40.0 * k]}, bounds=bounds, variant=variant
            )


@register
class FrameMode(Effect):
    """A vibration mode of the sensor's frame: the contact force excites it, and the sensor reads
    the force in the frame.
    """

    kind: Literal["frame.mode"] = "frame.mode"
    frequency: float = quantity(
        "Hz", "Natural frequency of the frame", gt=0.0, search=(3.0, 200.0), ratio=True
    )
    damping_ratio: float = quantity(
        "-", "Damping ratio of the frame", gt=0.0, le=1.0, search=(0.002, 0.3), ratio=True
    )
    mass: float = quantity(
        "kg", "Modal mass of the frame", gt=0.0, search=(1.0, 2000.0), ratio=True
    )
    link = "contact"
    equation = "m q'' + 2 zeta w m q' + w^2 m q = F, x = pz - q, measured: w^2 m q + 2 zeta w m q'"
    reference = "single structural mode"
    resembles = ("frame.compliance", "sensor.hum")
    leading = "mass"
    vanishes = True

    def apply(self, p: ContactParameters) -> None:
        p.mode = 2.0 * math.pi * self.frequency
        p.mode_damping = self.damping_ratio
        p.mode_mass = self.mass
        p.reaction = float(self.variant.get("reads") == "reaction")

    def unfit(self, scenario: Scenario) -> str | None:
        fastest = math.hypot(
            2.0 * math.pi * self.frequency,
            math.sqrt(scenario.mechanism.contact.stiffness / self.mass),
        )
        steps = fastest * scenario.tick / scenario.substeps / MODE_STEP
        if steps > MOST_STEPS:
            return (
                f"rings so fast that each step of the physics takes {steps:.3g} steps of the frame "
                f"(allowed: {MOST_STEPS}); give a lower frequency, a larger mass or a higher "
                "physics_rate, or use frame.compliance, its quasi-static limit"
            )
        return None

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        k = scales.stiffness
        lightest, heaviest = 1.0, max(2000.0, HEAVY * k)
        stiff = [
            (f, ratio * k / (2.0 * math.pi * f) ** 2)
            for f in FREQUENCIES
            for ratio in STIFFNESS_RATIOS
        ]
        starts = list(
            dict.fromkeys((f, 0.03, min(max(mass, lightest), heaviest)) for f, mass in stiff)
        )
        names = {"frequency": [], "damping_ratio": [], "mass": []}
        for variant in ({}, {"reads": "reaction"}):
            yield candidate(
                cls, names, starts=starts, bounds={"mass": (lightest, heaviest)}, variant=variant
            )
