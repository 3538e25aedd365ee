"""Effects of the numerical model: errors in its vehicles, forces that the nominal one lacks (of a
guide, a screw, a bearing, or gravity), errors in its time stepping.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field, Strict

from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.numerical_model.bodies import inertia_matrix, rest_inertia
from hiltestbed.numerical_model.parameters import BODIES, RESISTED
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.parameters import DynamicsParameters
    from hiltestbed.scenario.like import ScenarioLike

Body = Literal["chaser", "target"]
Offset = Annotated[
    tuple[Annotated[float, Field(ge=-10.0, le=10.0)], ...],
    Strict(False),
    Field(min_length=3, max_length=3),
]
# of the loop's rate: highest appendage frequency that the numerical model resolves at that rate
FASTEST = 0.1


class DynamicsEffect(Effect):
    """Base of the effects of the numerical model."""

    link = "dynamics"


@register
class DynamicsMass(DynamicsEffect):
    """The mass in the numerical model differs from the nominal mass."""

    kind: Literal["dynamics.mass"] = "dynamics.mass"
    factor: float = quantity(
        "-", "Mass in the numerical model over nominal mass", gt=0.0, search=(0.3, 3.0), ratio=True
    )
    body: Body = Field(default="chaser", description="Body that the departure concerns")
    equation = "m -> factor m in the numerical model"
    reference = "Newton"
    resembles = ("dynamics.appendage",)
    repeats = True

    def apply(self, p: DynamicsParameters) -> None:
        p.mass[BODIES.index(self.body)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (candidate(cls, {"factor": [0.6, 0.9, 1.1, 1.6]}, body=body) for body in BODIES)


@register
class DynamicsInertia(DynamicsEffect):
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
    equation = "I -> factor I in the numerical model"
    reference = "Euler"
    resembles = ("dynamics.port_offset",)
    repeats = True

    def apply(self, p: DynamicsParameters) -> None:
        p.inertia[BODIES.index(self.body)] *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (candidate(cls, {"factor": [0.7, 1.3]}, body=body) for body in BODIES)


@register
class DynamicsPortOffset(DynamicsEffect):
    """The port is displaced in the numerical model: the contact force has a wrong lever arm."""

    kind: Literal["dynamics.port_offset"] = "dynamics.port_offset"
    offset: Offset = quantity(
        "m", "Displacement of the port in the numerical model, body axes", search=(-0.5, 0.5)
    )
    body: Body = Field(default="chaser", description="Body that the departure concerns")
    equation = "port position += offset (body axes) in the numerical model"
    reference = "lever arm of the contact force"
    resembles = ("dynamics.inertia",)
    repeats = True

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
class DynamicsAppendage(DynamicsEffect):
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
    equation = (
        "m_a q'' = -k_a q - d_a q' - m_a a_place, m_a = mass_ratio m, k_a = m_a (2 pi f)^2, d_a = "
        "2 m_a damping_ratio (2 pi f); undeflected, the body has its nominal mass and inertia"
    )
    reference = "slosh or flexible panel, pendulum model"
    resembles = ("dynamics.mass",)
    repeats = True

    def apply(self, p: DynamicsParameters) -> None:
        w = 2.0 * math.pi * self.frequency
        p.appendages[BODIES.index(self.body)].append(
            (self.mass_ratio, w * w, 2.0 * self.damping_ratio * w, *self.place)
        )

    def unfit(self, scenario: ScenarioLike) -> str | None:
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


Resisted = Literal["chaser", "target", "both"]
# [m/s] unless given: measurements on greased guides range from some tenths of a mm/s to a few mm/s
STRIBECK_SPEED = 1e-3


@register
class DynamicsForce(DynamicsEffect):
    """A force that resists the motion along an axis: viscous and dry friction, and a constant
    offset.
    """

    kind: Literal["dynamics.force"] = "dynamics.force"
    viscous: float = quantity(
        "N s/m", "Coefficient of viscous friction", default=0.0, ge=0.0, search=(0.0, 1e5)
    )
    coulomb: float = quantity("N", "Dry friction in motion", default=0.0, ge=0.0, search=(0.0, 1e5))
    offset: float = quantity(
        "N", "Constant force against the positive direction", default=0.0, search=(-1e5, 1e5)
    )
    viscous_asymmetry: float = quantity(
        "-",
        "Fraction by which viscous friction is lower in the positive and higher in the negative "
        "direction",
        default=0.0,
        ge=-1.0,
        le=1.0,
        search=(-1.0, 1.0),
    )
    coulomb_back: float | None = quantity(
        "N",
        "Dry friction in motion in the negative direction; omitted: equal to coulomb",
        default=None,
        ge=0.0,
    )
    static: float | None = quantity(
        "N",
        "Static friction in the positive direction; its excess over coulomb is equal in the "
        "negative direction; omitted: no excess",
        default=None,
        ge=0.0,
    )
    stribeck_speed: float | None = quantity(
        "m/s",
        "Stribeck velocity, over which dry friction falls from static to coulomb; omitted: 0.001",
        default=None,
        gt=0.0,
    )
    axis: Literal["x", "y", "z"] = Field(
        default="z",
        description="Axis along which it acts: of P for the motion of A relative to P, inertial "
        "for one body",
    )
    body: Resisted = Field(
        default="both",
        description="Motion that it resists: of A relative to P (both, equal and opposite), or of "
        "one body",
    )
    equation = (
        "R = offset + viscous (1 - viscous_asymmetry sgn v) v + (coulomb + (static - coulomb) "
        "exp(-(v/stribeck_speed)^2)) sgn(v), sgn(0) what holds it, from -1 to 1; the mean over a "
        "tick of a motion that the other forces, held, drive"
    )
    reference = (
        "C. Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995; with an "
        "offset A. Janot, M. Gautier, M. Brunot, 2019"
    )
    resembles = ("dynamics.mass", "dynamics.appendage")
    repeats = True
    leading = "coulomb"

    def apply(self, p: DynamicsParameters) -> None:
        rise = 0.0 if self.static is None else self.static - self.coulomb
        back = self.coulomb if self.coulomb_back is None else self.coulomb_back
        viscous = [self.viscous * (1.0 + way * self.viscous_asymmetry) for way in (-1.0, 1.0)]
        force = (self.offset, *viscous, self.coulomb, back, rise)
        if any(force):
            on = RESISTED.index(self.body), "xyz".index(self.axis)
            p.forces.append((*on, *force, self.stribeck_speed or STRIBECK_SPEED))

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: on free-flying vehicles only the contact force acts."""
        return iter(())


MOST_TICKS = 12  # longest delay that is searched


@register
class DynamicsStepDelay(DynamicsEffect):
    """The pose of the numerical model is late by extra whole ticks."""

    kind: Literal["dynamics.step_delay"] = "dynamics.step_delay"
    ticks: Annotated[int, Field(ge=0, le=100)] = Field(
        description="Whole ticks of delay", json_schema_extra={"unit": "-"}
    )
    equation = "pose_cmd is `ticks` rows late"
    reference = "transport within the loop"
    resembles = ("dynamics.integrator",)
    repeats = True

    def apply(self, p: DynamicsParameters) -> None:
        p.late += self.ticks

    def worth(self, tick: float, frequency: float) -> float:
        return self.ticks * tick

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        return (
            candidate(cls, {}, choices=MOST_TICKS, ticks=ticks)
            for ticks in range(1, MOST_TICKS + 1)
        )


@register
class DynamicsIntegrator(DynamicsEffect):
    """The integrator of the numerical model adds energy: it acts as a delay of one step."""

    kind: Literal["dynamics.integrator"] = "dynamics.integrator"
    scheme: Literal["explicit_euler"] = Field(
        default="explicit_euler",
        description="Integration scheme used instead of semi-implicit Euler",
    )
    equation = "pose integrated with the old twist, then the twist"
    reference = "explicit Euler"
    resembles = ("dynamics.step_delay",)

    def apply(self, p: DynamicsParameters) -> None:
        p.explicit = True

    def worth(self, tick: float, frequency: float) -> float:
        return tick

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {})
