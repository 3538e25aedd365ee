"""The force of a damper over its motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from hiltestbed.axis import law
from hiltestbed.axis.effects.base import DamperEffect, RecordScale, Sought
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, candidate
from hiltestbed.plugins import register

SLOWEST_KNEE = 0.02  # of the largest speed; a slower one is dry friction
STRETCHES = (0.01, 0.05, 0.2)  # of the travel, over which a slider is elastic: starts of a search


@register
class DamperStiffness(DamperEffect):
    """The stiffness differs from the nominal one."""

    kind: Literal["contact.stiffness"] = "contact.stiffness"
    factor: float = quantity("-", "True stiffness over nominal stiffness", search=(0.0, 5.0))
    equation = "k -> factor k"
    reference = "Hooke"
    multiplies = {"factor": (law.SPRING,)}

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        if reach.stiffness:
            yield candidate(cls, {"factor": [0.0, 1.0]})


@register
class DamperDamping(DamperEffect):
    """The viscous damping differs from the nominal one."""

    kind: Literal["contact.damping"] = "contact.damping"
    factor: float = quantity("-", "True damping over nominal damping", ge=0.0, search=(0.0, 50.0))
    equation = "c -> factor c"
    reference = "viscous damper"
    multiplies = {"factor": (law.VISCOUS, law.VISCOUS_BACK, law.BEYOND, law.BEYOND_BACK)}

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        if reach.damping:
            yield candidate(cls, {"factor": [0.1, 1.0]})


@register
class DamperFriction(DamperEffect):
    """Dry friction: a slider behind a spring; several of them give way one after the other."""

    kind: Literal["contact.dry_friction"] = "contact.dry_friction"
    force: float = quantity("N", "Friction force while sliding", ge=0.0)
    stiffness: float = quantity(
        "N/m", "Stiffness of the spring in series with the slider", gt=0.0, ratio=True
    )
    equation = "F += f, f' = stiffness v while |f| < force"
    reference = (
        "G. M. Jenkins, J. Br. Nucl. Energy Soc. 1, 1962; several: W. D. Iwan, J. Appl. Mech. 33, "
        "1966"
    )
    resembles = ("contact.damping", "contact.bouc_wen")
    repeats = True
    parallel = True

    def apply(self, p: law.AxisLaw) -> None:
        p.add(p.sliders, (self.force, self.stiffness, 0.0))

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        f, x = reach.force, reach.travel
        yield candidate(
            cls,
            {"force": [0.1 * f, 0.6 * f], "stiffness": []},
            starts=[(q * f, q * f / (s * x)) for q in (0.1, 0.6) for s in STRETCHES],
            bounds={"force": (0.0, 2.0 * f), "stiffness": (0.1 * f / x, 1e4 * f / x)},
        )


@register
class DamperBoucWen(DamperEffect):
    """Hysteresis with round corners, as of a magnetorheological fluid."""

    kind: Literal["contact.bouc_wen"] = "contact.bouc_wen"
    force: float = quantity("N", "Force that it does not exceed", ge=0.0)
    stiffness: float = quantity("N/m", "Stiffness at a reversal", gt=0.0, ratio=True)
    exponent: float = quantity(
        "-", "Sharpness of the corner", gt=0.0, search=(0.2, 20.0), ratio=True
    )
    equation = "F += z, z' = stiffness v (1 - |z/force|^exponent where z v > 0)"
    reference = "R. Bouc, 1967; Y.-K. Wen, J. Eng. Mech. 102, 1976"
    resembles = ("contact.dry_friction",)
    repeats = True
    parallel = True

    def apply(self, p: law.AxisLaw) -> None:
        p.add(p.sliders, (self.force, self.stiffness, self.exponent))

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        f, x = reach.force, reach.travel
        yield candidate(
            cls,
            {"force": [], "stiffness": [], "exponent": []},
            starts=[(q * f, q * f / (s * x), 1.0) for q in (0.1, 0.6) for s in STRETCHES],
            bounds={"force": (0.0, 2.0 * f), "stiffness": (0.1 * f / x, 1e4 * f / x)},
        )


@register
class DamperPlay(DamperEffect):
    """Play in series with the friction: no force over this distance after each reversal."""

    kind: Literal["contact.backlash"] = "contact.backlash"
    width: float = quantity("m", "Total play", ge=0.0)
    equation = "the spring of a slider is bent by what exceeds width/2 to either side"
    reference = "backlash of a joint"
    adds = {"width": law.PLAY}
    sought = {"width": Sought((0.02, 0.1, 0.3), (0.0, 1.0), lambda reach: reach.travel)}
    needs = ("contact.dry_friction:force",)


@register
class DamperRelaxation(DamperEffect):
    """It is stiffer under fast loading, and relaxes when held: a spring behind a damper."""

    kind: Literal["contact.relaxation"] = "contact.relaxation"
    stiffness: float = quantity("N/m", "Stiffness of the Maxwell branch", gt=0.0, ratio=True)
    time_constant: float = quantity(
        "s", "Relaxation time of the Maxwell branch", gt=0.0, ratio=True
    )
    equation = "F += z, z' = stiffness v - z/time_constant"
    reference = "Maxwell branch of the standard linear solid"
    resembles = ("contact.damping",)
    repeats = True
    parallel = True

    def apply(self, p: law.AxisLaw) -> None:
        p.add(p.branches, (self.stiffness, self.time_constant))

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        k = reach.force / reach.travel
        slow = reach.travel / max(reach.speed, 1e-12)
        yield candidate(
            cls,
            {
                "stiffness": [0.3 * k, 3.0 * k],
                "time_constant": [q * slow for q in (0.03, 0.3, 3.0)],
            },
            bounds={
                "stiffness": (1e-4 * k, 1e4 * k),
                "time_constant": (2.0 * reach.tick, 100.0 * slow),
            },
        )


@register
class DamperViscous(DamperEffect):
    """Viscous damping of a device for which none is nominal."""

    kind: Literal["contact.viscous"] = "contact.viscous"
    damping: float = quantity("N s/m", "Damping", ge=0.0)
    exponent: float | None = quantity(
        "-", "Exponent of the speed; omitted: 1", default=None, gt=0.0, search=(0.2, 3.0)
    )
    equation = "F += damping |v|^exponent sgn(v)"
    reference = "viscous damper"
    resembles = ("contact.damping", "contact.dry_friction")

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[[law.VISCOUS, law.VISCOUS_BACK]] += self.damping
        if self.exponent is not None:
            p.numbers[law.POWER] = self.exponent

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        if not reach.damping:
            c = reach.force / max(reach.speed, 1e-12)
            yield candidate(cls, {"damping": [0.0]}, bounds={"damping": (0.0, 50.0 * c)})
            yield candidate(cls, {"exponent": [1.0]}, needs=("contact.viscous:damping",))


@register
class DamperRebound(DamperEffect):
    """The damping differs between compression and rebound."""

    kind: Literal["contact.rebound"] = "contact.rebound"
    factor: float = quantity(
        "-", "Damping at negative speeds over that at positive ones", search=(0.0, 20.0)
    )
    equation = "c -> factor c where v < 0"
    reference = "J. C. Dixon, The Shock Absorber Handbook, 2007"
    multiplies = {"factor": (law.VISCOUS_BACK, law.BEYOND_BACK)}
    sought = {"factor": Sought((1.0,))}


@register
class DamperKnee(DamperEffect):
    """A valve opens: beyond a speed, the force rises with another slope."""

    kind: Literal["contact.knee"] = "contact.knee"
    speed: float = quantity("m/s", "Speed at which the valve opens", gt=0.0, ratio=True)
    slope: float = quantity("-", "Slope beyond it over that below it", search=(0.0, 5.0))
    rebound_speed: float | None = quantity(
        "m/s", "The same at negative speeds; omitted: equal", default=None, gt=0.0, ratio=True
    )
    rebound_slope: float | None = quantity(
        "-", "The same at negative speeds; omitted: equal", default=None, search=(0.0, 5.0)
    )
    equation = "F = c v up to the speed, slope c after it"
    reference = "J. C. Dixon, The Shock Absorber Handbook, 2007"

    def apply(self, p: law.AxisLaw) -> None:
        n = p.numbers
        n[law.KNEE], n[law.BEYOND] = self.speed, self.slope * n[law.VISCOUS]
        n[law.KNEE_BACK] = self.speed if self.rebound_speed is None else self.rebound_speed
        slope = self.slope if self.rebound_slope is None else self.rebound_slope
        n[law.BEYOND_BACK] = slope * n[law.VISCOUS_BACK]

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        v = reach.speed
        speeds, ends = [q * v for q in (0.05, 0.15, 0.3, 0.6)], (SLOWEST_KNEE * v, v)
        yield candidate(cls, {"speed": speeds, "slope": [0.3]}, bounds={"speed": ends})
        yield candidate(
            cls,
            {"rebound_speed": speeds, "rebound_slope": [0.3]},
            bounds={"rebound_speed": ends},
            needs=("contact.knee:speed",),
        )


@register
class DamperPreload(DamperEffect):
    """A constant force: of the gas in a damper, or of a sensor that was not tared."""

    kind: Literal["contact.preload"] = "contact.preload"
    force: float = quantity("N", "Constant force")
    equation = "F += force"
    reference = "gas pressure times the rod's cross-section"
    resembles = ("sensor.bias",)
    adds = {"force": law.OFFSET}
    sought = {"force": Sought((0.0,), (-2.0, 2.0), lambda reach: reach.force)}


@register
class DamperSpring(DamperEffect):
    """A spring beside the nominal one, such as the gas that the rod compresses."""

    kind: Literal["contact.spring"] = "contact.spring"
    stiffness: float = quantity("N/m", "Stiffness")
    equation = "F += stiffness x"
    reference = "Hooke"
    resembles = ("contact.stiffness",)
    excludes = ("contact.stiffness",)

    def apply(self, p: law.AxisLaw) -> None:
        p.numbers[law.SPRING] += self.stiffness
        p.numbers[law.REST] = 0.0

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        if not reach.stiffness:
            k = 10.0 * reach.force / reach.travel
            yield candidate(cls, {"stiffness": [0.0]}, bounds={"stiffness": (-k, k)})


@register
class DamperOilLag(DamperEffect):
    """The column of oil gives way: the dissipative force lags behind the motion."""

    kind: Literal["contact.oil_lag"] = "contact.oil_lag"
    time_constant: float = quantity("s", "Time constant of the lag", gt=0.0, ratio=True)
    equation = "time_constant F_d' = f_d(motion) - F_d"
    reference = "bulk modulus of the oil column in series with the valve"
    resembles = ("contact.relaxation",)
    adds = {"time_constant": law.LAG}

    @classmethod
    def parts(cls, reach: RecordScale) -> Iterator[Candidate]:
        slow = reach.travel / max(reach.speed, 1e-12)
        yield candidate(
            cls,
            {"time_constant": [0.01 * slow, 0.1 * slow]},
            bounds={"time_constant": (0.05 * reach.tick, slow)},
        )


@register
class DamperDrift(DamperEffect):
    """The reading of the force drifts."""

    kind: Literal["sensor.drift"] = "sensor.drift"
    rate: float = quantity("N/s", "Rate of the drift")
    link = "sensor"
    equation = "F += rate t"
    reference = "charge-amplifier leakage current, or a gas that warms up"
    adds = {"rate": law.RAMP}
    sought = {"rate": Sought((0.0,), (-0.5, 0.5), lambda reach: reach.force / reach.duration)}
