"""Errors in the numerical model of the vehicles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, Strict

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.numerical_model.bodies import inertia_matrix, rest_inertia
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.parameters import DynamicsParameters
    from hiltestbed.scenario import Scenario

BODIES = ("chaser", "target")
Body = Literal["chaser", "target"]
Offset = Annotated[
    tuple[Annotated[float, Field(ge=-10.0, le=10.0)], ...],
    Strict(False),
    Field(min_length=3, max_length=3),
]
# factor to either side of the regression's estimate within which the mass of a driven axis is
# searched
OFF = 10.0
# of the loop's rate: highest appendage frequency that the numerical model resolves at that rate
FASTEST = 0.1


@register
class DynamicsMass(Effect):
    """The mass in the numerical model differs from the nominal mass."""

    kind: Literal["dynamics.mass"] = "dynamics.mass"
    factor: float = quantity(
        "-", "Mass in the numerical model over nominal mass", gt=0.0, search=(0.3, 3.0), ratio=True
    )
    body: Body = Field(default="chaser", description="Body that the departure concerns")
    link = "dynamics"
    equation = "m -> factor m in the numerical model"
    reference = "Newton"
    resembles = ("dynamics.appendage",)
    repeats = True
    leading = "factor"

    def apply(self, p: DynamicsParameters) -> None:
        p.mass[BODIES.index(self.body)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        if scales.driven is not None:  # the regression gives the mass, whatever the nominal one
            f = scales.driven.factor
            return iter(
                [
                    candidate(
                        cls, {"factor": [f]}, bounds={"factor": (f / OFF, f * OFF)}, body="chaser"
                    )
                ]
            )
        return (candidate(cls, {"factor": [0.6, 0.9, 1.1, 1.6]}, body=body) for body in BODIES)


@register
class DynamicsInertia(Effect):
    """The inertia in the numerical model differs from the nominal inertia."""

    kind: Literal["dynamics.inertia"] = "dynamics.inertia"
    factor: float = quantity(
        "-",
        "Inertia in the numerical model over nominal inertia",
        gt=0.0,
        search=(0.3, 3.0),
        ratio=True,
    )
    body: Body = Field(default="chaser", description="Body that the departure concerns")
    link = "dynamics"
    equation = "I -> factor I in the numerical model"
    reference = "Euler"
    resembles = ("dynamics.port_offset",)
    repeats = True
    leading = "factor"

    def apply(self, p: DynamicsParameters) -> None:
        p.inertia[BODIES.index(self.body)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (candidate(cls, {"factor": [0.7, 1.3]}, body=body) for body in BODIES)


@register
class DynamicsPortOffset(Effect):
    """The port is displaced in the numerical model: the contact force has a wrong lever arm."""

    kind: Literal["dynamics.port_offset"] = "dynamics.port_offset"
    offset: Offset = quantity(
        "m", "Displacement of the port in the numerical model, body axes", search=(-0.5, 0.5)
    )
    body: Body = Field(default="chaser", description="Body that the departure concerns")
    link = "dynamics"
    equation = "port position += offset (body axes) in the numerical model"
    reference = "lever arm of the contact force"
    resembles = ("dynamics.inertia",)
    repeats = True
    leading = "offset"

    def apply(self, p: DynamicsParameters) -> None:
        p.port[BODIES.index(self.body)] += self.offset

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        names = {f"offset.{j}": [0.0] for j in range(3)}
        return (
            candidate(cls, names, starts=[(0.0, 0.0, 0.0), (0.05, 0.05, 0.05)], body=body)
            for body in BODIES
        )


@register
class DynamicsAppendage(Effect):
    """A fraction of the body's mass is attached by a spring and damper; away from the centre of
    mass it also exerts a torque.
    """

    kind: Literal["dynamics.appendage"] = "dynamics.appendage"
    mass_ratio: float = quantity(
        "-",
        "Fraction of the body's mass that oscillates",
        gt=0.0,
        le=1.0,
        search=(0.005, 0.6),
        ratio=True,
    )
    frequency: float = quantity(
        "Hz", "Natural frequency with the body fixed", gt=0.0, search=(0.05, 20.0), ratio=True
    )
    damping_ratio: float = quantity(
        "-", "Damping ratio with the body fixed", ge=0.0, le=1.0, search=(0.001, 0.5), ratio=True
    )
    body: Body = Field(default="chaser", description="Body that the departure concerns")
    place: Offset = quantity(
        "m",
        "Point of attachment from the body's centre of mass, body axes; 0: it exerts no torque",
        default=(0.0, 0.0, 0.0),
    )
    link = "dynamics"
    equation = (
        "m_a q'' = -k_a q - d_a q' - m_a a_place, m_a = mass_ratio m, k_a = m_a (2 pi f)^2, d_a = "
        "2 m_a damping_ratio (2 pi f); undeflected, the body has its nominal mass and inertia"
    )
    reference = "slosh or flexible panel, pendulum model"
    resembles = ("dynamics.mass",)
    repeats = True
    leading = "mass_ratio"

    def apply(self, p: DynamicsParameters) -> None:
        w = 2.0 * math.pi * self.frequency
        p.appendages[BODIES.index(self.body)].append(
            (self.mass_ratio, w * w, 2.0 * self.damping_ratio * w, *self.place)
        )

    def unfit(self, scenario: Scenario) -> str | None:
        if not any(self.place):
            return None
        body = scenario.spacecraft.chaser if self.body == "chaser" else scenario.spacecraft.target
        if self.mass_ratio == 1.0:
            return (
                f"its mass is that of the whole {self.body}; away from the centre of "
                f"mass mass_ratio must be below 1"
            )
        left = np.linalg.eigvalsh(
            rest_inertia(
                body.mass, inertia_matrix(body.inertia), [self.mass_ratio], np.array([self.place])
            )
        ).min()
        if left > 0.0:
            return None
        return (
            f"it takes more inertia than the {self.body} has: {self.mass_ratio * body.mass:g} kg "
            f"at {list(self.place)} m leave "
            f"{left:g} kg m^2; place it nearer to the centre of mass, or lower mass_ratio"
        )

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        swing = {
            "mass_ratio": [0.05, 0.2],
            "frequency": [0.15, 0.4, 0.8, 1.5, 3.0, 6.0, 12.0, 24.0],
            "damping_ratio": [0.02, 0.15],
        }
        bounds = {"frequency": (0.05, FASTEST / scales.tick)}
        return (candidate(cls, swing, bounds=bounds, body=body) for body in BODIES)
