"""What resists the motion of a drive: friction, and forces that depend on its position."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from hiltestbed.axis import law
from hiltestbed.axis.effects.base import DriveEffect, RecordScale, Sought
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import register

# of a force or friction that repeats along the axis: its pitch, and its phase by quarters of a turn
WAVE_PITCH = Sought((0.05, 0.1, 0.2, 0.35, 0.6, 0.9), (0.02, 1.0), lambda reach: reach.travel)
WAVE_PHASE = Sought((0.0, 1.57, 3.14, 4.71))  # [rad]


@register
class AxisForce(DriveEffect):
    """A force that resists the motion: viscous and dry friction, and a constant offset."""

    kind: Literal["dynamics.force"] = "dynamics.force"
    viscous: float = quantity("N s/m", "Coefficient of viscous friction", default=0.0, ge=0.0)
    coulomb: float = quantity("N", "Dry friction in motion", default=0.0, ge=0.0)
    offset: float = quantity("N", "Constant force against the positive direction", default=0.0)
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
        "N", "Static friction; omitted: no excess over coulomb", default=None, ge=0.0
    )
    stribeck_speed: float | None = quantity(
        "m/s",
        "Speed over which dry friction falls from static to coulomb",
        default=None,
        gt=0.0,
        ratio=True,
    )
    equation = (
        "R = offset + viscous (1 - viscous_asymmetry sgn v) v + (coulomb + (static - coulomb) "
        "exp(-(v/stribeck_speed)^2)) sgn(v)"
    )
    reference = (
        "C. Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995; with an offset A. Janot, "
        "M. Gautier, M. Brunot, 2019"
    )

    def apply(self, p: law.AxisLaw) -> None:
        n = p.numbers
        n[law.VISCOUS] += self.viscous * (1.0 - self.viscous_asymmetry)
        n[law.VISCOUS_BACK] += self.viscous * (1.0 + self.viscous_asymmetry)
        n[law.COULOMB] += self.coulomb
        n[law.COULOMB_BACK] += self.coulomb if self.coulomb_back is None else self.coulomb_back
        n[law.OFFSET] += self.offset
        if self.static is not None and self.stribeck_speed is not None:
            n[law.RISE], n[law.STRIBECK] = max(self.static - self.coulomb, 0.0), self.stribeck_speed

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        f, v = reach.force, max(reach.speed, 1e-12)
        yield candidate(cls, {"viscous": [0.05 * f / v]}, bounds={"viscous": (0.0, 10.0 * f / v)})
        yield candidate(cls, {"coulomb": [0.05 * f]}, bounds={"coulomb": (0.0, f)})
        yield candidate(cls, {"offset": [0.0]}, bounds={"offset": (-f, f)})
        yield candidate(cls, {"viscous_asymmetry": [0.0]}, needs=("dynamics.force:viscous",))
        yield candidate(
            cls,
            {"coulomb_back": [0.05 * f]},
            bounds={"coulomb_back": (0.0, f)},
            # with an offset instead, both directions are as well described
            choices=2,
            needs=("dynamics.force:coulomb",),
        )
        slow = [q * v for q in (0.02, 0.1, 0.3)]
        yield candidate(
            cls,
            {"static": [0.2 * f], "stribeck_speed": slow},
            bounds={"static": (0.0, f), "stribeck_speed": (1e-3 * v, v)},
            needs=("dynamics.force:coulomb",),
        )


@register
class AxisLoadFriction(DriveEffect):
    """Dry friction grows with the force that the axis transmits, as in a gear."""

    kind: Literal["dynamics.load_friction"] = "dynamics.load_friction"
    coefficient: float = quantity(
        "-", "Friction per newton of transmitted force", ge=0.0, search=(0.0, 1.0)
    )
    equation = "R += coefficient |transmitted force| sgn(v)"
    reference = "M. Duclusaud and others, Extended Friction Models for Servo Actuators, 2024"
    resembles = ("dynamics.gain", "dynamics.mass")
    adds = {"coefficient": law.LOAD}
    sought = {"coefficient": Sought((0.05,))}


@register
class AxisFrictionWave(DriveEffect):
    """Dry friction varies with the position, as in a screw or a gear that is out of true."""

    kind: Literal["dynamics.friction_wave"] = "dynamics.friction_wave"
    share: float = quantity("-", "Share of the dry friction that varies", ge=0.0, search=(0.0, 1.0))
    pitch: float = quantity("m", "Distance after which it repeats", gt=0.0, ratio=True)
    phase: float = quantity("rad", "Phase at the origin", search=(-7.0, 7.0))
    equation = "coulomb -> coulomb (1 + share sin(2 pi x/pitch + phase))"
    reference = "first harmonic of a friction that depends on the position"
    sought = {"share": Sought((0.2,)), "pitch": WAVE_PITCH, "phase": WAVE_PHASE}
    needs = ("dynamics.force:coulomb",)

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[[law.WAVE, law.WAVE_PITCH, law.WAVE_PHASE]] = self.share, self.pitch, self.phase


@register
class AxisFade(DriveEffect):
    """Friction and damping change slowly over a run, as a machine warms up."""

    kind: Literal["dynamics.fade"] = "dynamics.fade"
    rate: float = quantity("1/s", "Relative change per second")
    axes = ("drive", "damper", "arm")
    equation = "dissipative forces -> (1 + rate t) times themselves"
    reference = "first order in time"
    adds = {"rate": law.FADE}
    sought = {"rate": Sought((0.0,), (-0.5, 0.5), lambda reach: 1.0 / reach.duration)}


@register
class AxisGravity(DriveEffect):
    """Gravity on a joint: the weight of what it carries, about its axis."""

    kind: Literal["dynamics.gravity"] = "dynamics.gravity"
    sine: float = quantity("N m", "Moment that follows the sine of the angle", default=0.0)
    cosine: float = quantity("N m", "Moment that follows the cosine of the angle", default=0.0)
    equation = "R += sine sin x + cosine cos x"
    reference = "m g l of a rigid load"
    resembles = ("dynamics.spring",)
    axes = ("drive",)  # of an arm, gravity follows from its bodies
    adds = {"sine": law.GRAVITY_SIN, "cosine": law.GRAVITY_COS}
    sought = dict.fromkeys(
        ("sine", "cosine"), Sought((0.0,), (-2.0, 2.0), lambda reach: reach.force)
    )

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        if reach.rotates:
            yield from super().parts(reach)


@register
class AxisSpring(DriveEffect):
    """A spring pulls the axis back, as a cable or a hose does."""

    kind: Literal["dynamics.spring"] = "dynamics.spring"
    stiffness: float = quantity("N/m", "Stiffness")
    rest: float = quantity("m", "Position at which it is relaxed", default=0.0)
    equation = "R += stiffness (x - rest)"
    reference = "Hooke"
    resembles = ("dynamics.gravity",)

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.SPRING] += self.stiffness
        p.numbers[law.REST] = self.rest

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        most = 10.0 * reach.force / reach.travel
        yield candidate(cls, {"stiffness": [0.0]}, bounds={"stiffness": (-most, most)}, rest=0.0)


@register
class AxisCogging(DriveEffect):
    """A force that repeats along the axis: of a motor's poles, or of a screw."""

    kind: Literal["dynamics.cogging"] = "dynamics.cogging"
    amplitude: float = quantity("N", "Amplitude", ge=0.0)
    pitch: float = quantity("m", "Distance after which it repeats", gt=0.0, ratio=True)
    phase: float = quantity("rad", "Phase at the origin", search=(-7.0, 7.0))
    equation = "R += amplitude sin(2 pi x/pitch + phase)"
    reference = "first harmonic of a cogging force"
    sought = {
        "amplitude": Sought((0.05,), (0.0, 1.0), lambda reach: reach.force),
        "pitch": WAVE_PITCH,
        "phase": WAVE_PHASE,
    }

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[[law.COG, law.COG_PITCH, law.COG_PHASE]] = self.amplitude, self.pitch, self.phase
