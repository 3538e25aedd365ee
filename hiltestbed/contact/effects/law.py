"""Effects of the force law: damping, the frame behind the sensor, a learned law, the spring."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Literal

from hiltestbed.config.piecewise import Curve, packed
from hiltestbed.contact.law import MODE_STEP
from hiltestbed.effects.base import Effect
from hiltestbed.effects.departure import quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters
    from hiltestbed.scenario.like import ScenarioLike


class ContactEffect(Effect):
    """Base of the effects that change the parameters of a contact."""

    link = "contact"

    @classmethod
    def by_force(cls, scales: Scales, **fixed: Any) -> Candidate:
        """A candidate whose ``force`` is a part of the largest."""
        f = scales.force
        parts = {"force": [0.01 * f, 0.04 * f, 0.15 * f]}
        return candidate(cls, parts, bounds={"force": (0.0, 0.8 * f)}, **fixed)


# starting values of alpha times the speed at touch in the search for Hunt-Crossley damping
LOSSES = (0.01, 0.05, 0.2, 0.6)
# its upper bound: y - ln(1 + y) is equal at y = 6 and y = -6 e for e of about 1/6, the share of the
# speed that remains
MOST_LOSS = 6.0
# times the secant stiffness: upper bound of the spring in series with a friction slider
STIFFEST = 1e3


@register
class ContactDamping(ContactEffect):
    """The contact damping differs from the nominal damping."""

    kind: Literal["contact.damping"] = "contact.damping"
    factor: float = quantity("-", "True damping over nominal damping", ge=0.0, search=(0.0, 6.0))
    equation = "c -> factor c"
    reference = "viscous damper"
    resembles = ("sensor.delay", "log.skew", "contact.hunt_crossley")
    repeats = True

    def apply(self, p: ContactParameters) -> None:
        p.damping *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {"factor": [0.2, 0.6, 1.5, 2.5, 4.0]}, linear="factor")


@register
class ContactHuntCrossley(ContactEffect):
    """Hunt-Crossley damping: it grows with the penetration, so that the force has no step at
    touch.
    """

    kind: Literal["contact.hunt_crossley"] = "contact.hunt_crossley"
    alpha: float = quantity("s/m", "Hunt-Crossley damping coefficient", ge=0.0, search=(0.0, 30.0))
    equation = "F = k x (1 + alpha v)"
    reference = "K. H. Hunt, F. R. E. Crossley, ASME J. Appl. Mech. 42, 1975"
    resembles = ("contact.damping",)

    def apply(self, p: ContactParameters) -> None:
        p.alpha = self.alpha

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        # alpha times the speed is the loss in the rebound, up to a factor
        speed = math.sqrt(scales.slow * scales.fast)
        yield candidate(
            cls, {"alpha": [a / speed for a in LOSSES]}, bounds={"alpha": (0.0, MOST_LOSS / speed)}
        )


@register
class ContactDryFriction(ContactEffect):
    """Dry friction in the buffer: a hysteresis loop whose width depends on neither speed nor
    stroke.
    """

    kind: Literal["contact.dry_friction"] = "contact.dry_friction"
    force: float = quantity("N", "Friction force while sliding", ge=0.0, search=(0.0, 300.0))
    stiffness: float = quantity(
        "N/m",
        "Stiffness of the spring in series with the friction slider; 0: rigid",
        default=0.0,
        ge=0.0,
        search=(1e2, 1e9),
        ratio=True,
    )
    equation = (
        "F += force tanh(v/2e-4); with a stiffness F += f, f' = stiffness v while |f| < force"
    )
    reference = "Coulomb; with a stiffness G. M. Jenkins, J. Br. Nucl. Energy Soc. 1, 1962"
    resembles = ("contact.damping", "contact.preload")

    def apply(self, p: ContactParameters) -> None:
        p.dry += self.force
        p.drag = self.stiffness

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        f, x = scales.force, scales.depth
        yield cls.by_force(scales, linear="force", stiffness=0.0)
        if scales.captured:
            drag = {"force": [0.3 * f, 0.8 * f], "stiffness": [q * f / x for q in (2.0, 8.0, 30.0)]}
            yield candidate(
                cls, drag, bounds={"force": (0.0, f), "stiffness": (0.1 * f / x, STIFFEST * f / x)}
            )


@register
class ContactRelaxation(ContactEffect):
    """The contact is stiffer under fast loading and relaxes under constant penetration."""

    kind: Literal["contact.relaxation"] = "contact.relaxation"
    stiffness: float = quantity(
        "N/m", "Stiffness of the Maxwell branch", gt=0.0, search=(1e2, 1e7), ratio=True
    )
    time_constant: float = quantity(
        "s", "Relaxation time of the Maxwell branch", gt=0.0, search=(1e-3, 10.0), ratio=True
    )
    equation = "F += z, z' = stiffness v - z/time_constant"
    reference = "Maxwell branch of the standard linear solid"
    resembles = ("sensor.highpass", "contact.damping")

    def apply(self, p: ContactParameters) -> None:
        p.branch_stiffness, p.branch_time = self.stiffness, self.time_constant

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        k = scales.stiffness
        starts = {"stiffness": [0.1 * k, 0.4 * k], "time_constant": [0.004, 0.02, 0.08, 0.4]}
        bounds = {"stiffness": (0.005 * k, 10.0 * k), "time_constant": (1e-3, 5.0)}
        yield candidate(cls, starts, bounds=bounds, linear="stiffness")


# [s^2] mass over the contact's stiffness of a frame ten times as stiff whose natural frequency is 3
# Hz
HEAVY = 10.0 / (6.0 * math.pi) ** 2
# of the nominal stiffness: lower bound of a search, also for the frame's, in a captured mechanism,
# where friction may have been identified as stiffness
LITTLE = 0.01
# chosen: [Hz] of a mode, from which a search starts
FREQUENCIES = (3.3, 4.0, 4.8, 5.8, 7.0, 8.4, 10.5, 13.5, 17.5, 22.0, 28.0, 36.0, 60.0)
# chosen: of the frame to the contact, from which a search starts
STIFFNESS_RATIOS = (1.5, 5.0, 40.0)
# integration steps of the frame's mode per physics step: about 50 us of computing time
MOST_STEPS = 1000


@register
class FrameCompliance(ContactEffect):
    """The sensor's frame is compliant: it deflects quasi-statically under the contact force."""

    kind: Literal["frame.compliance"] = "frame.compliance"
    stiffness: float = quantity(
        "N/m", "Stiffness of the frame", gt=0.0, search=(1e5, 1e9), ratio=True
    )
    equation = "x = pz - F/stiffness"
    reference = "springs in series"
    resembles = ("contact.stiffness",)
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
            starts = {"stiffness": [2.0 * k, 8.0 * k, 40.0 * k]}
            yield candidate(cls, starts, bounds=bounds, variant=variant, linear="stiffness")


@register
class FrameMode(ContactEffect):
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

    def unfit(self, scenario: ScenarioLike) -> str | None:
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
        more: dict[str, Any] = {"starts": starts, "bounds": {"mass": (lightest, heaviest)}}
        yield candidate(cls, names, linear="mass", **more)
        yield candidate(cls, names, variant={"reads": "reaction"}, **more)


@register
class ContactMap(ContactEffect):
    """A force added to the nominal spring and damper, given as curves over penetration, rate and
    the stretch of a friction slider.
    """

    kind: Literal["contact.map"] = "contact.map"
    penetration: Curve = quantity(
        "m, N",
        "Knots of the force over the penetration; linearly extrapolated beyond the ends",
        default=(),
    )
    rate: Curve = quantity(
        "m/s, N",
        "Knots of the force over the penetration rate; linearly extrapolated beyond the ends",
        default=(),
    )
    stretch: Curve = quantity(
        "m, N",
        "Knots of the force over the stretch of a friction slider; at the ends the slider slips",
        default=(),
    )
    spring: Curve = quantity(
        "m, -",
        "Knots of a fraction of the elastic force that is added, over the penetration; constant "
        "beyond the ends",
        default=(),
    )
    spring_rate: Curve = quantity(
        "m/s, -",
        "Knots of a fraction of the elastic force that is added, over the penetration rate; "
        "constant beyond the ends",
        default=(),
    )
    equation = (
        "F += f(x) + g(v) + h(s) + (p(x) + q(v)) k x, s' = v while s is within the "
        "knots of h, each curve piecewise linear"
    )
    reference = (
        "stop operator: M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis, 1989"
    )
    resembles = (
        "contact.power_law",
        "contact.hard_stop",
        "contact.damping",
        "contact.dry_friction",
    )

    def apply(self, p: ContactParameters) -> None:
        p.over_penetration = packed(self.penetration)
        p.over_rate = packed(self.rate)
        p.over_stretch = packed(self.stretch)
        p.spring_over_penetration = packed(self.spring)
        p.spring_over_rate = packed(self.spring_rate)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: it is learned where the named effects leave a residual above the noise floor, see
        :mod:`hiltestbed.diagnosis.learned`.
        """
        return iter(())


@register
class ContactStiffness(ContactEffect):
    """The contact stiffness differs from the nominal stiffness."""

    kind: Literal["contact.stiffness"] = "contact.stiffness"
    factor: float = quantity(
        "-", "True stiffness over nominal stiffness", gt=0.0, search=(0.3, 3.0), ratio=True
    )
    equation = "k -> factor k"
    reference = "Hooke"
    resembles = ("frame.compliance", "sensor.gain")
    repeats = True

    def apply(self, p: ContactParameters) -> None:
        p.stiffness *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        bounds = {"factor": (LITTLE, 3.0)} if scales.captured else None
        starts = {"factor": [0.5, 0.75, 0.92, 1.08, 1.3, 1.8]}
        yield candidate(cls, starts, bounds=bounds, linear="factor")


@register
class ContactPowerLaw(ContactEffect):
    """The elastic force is a power of the penetration, in place of the linear spring."""

    kind: Literal["contact.power_law"] = "contact.power_law"
    exponent: float = quantity(
        "-", "Exponent n of the penetration", gt=0.0, le=5.0, search=(1.02, 2.5)
    )
    stiffness: float = quantity(
        "N/m^n",
        "Coefficient of the law, the force at a penetration of 1 m",
        gt=0.0,
        search=(1e3, 1e10),
        ratio=True,
    )
    equation = "F = stiffness x^exponent + c v"
    reference = "Hertz for exponent 1.5"
    resembles = ("contact.stiffness", "sensor.saturation")

    def apply(self, p: ContactParameters) -> None:
        p.exponent, p.power_stiffness = self.exponent, self.stiffness
        if self.variant.get("damper") == "none":
            p.damping = 0.0

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        k, x = scales.stiffness, scales.depth
        starts = [
            (n, k * x ** (1.0 - n) * g) for n in (1.1, 1.25, 1.5, 1.8) for g in (0.6, 1.0, 1.6)
        ]
        low, high, _ = cls.searched("stiffness")
        bounds = {"stiffness": (low, max(high, 2.0 * max(stiffness for _, stiffness in starts)))}
        for variant in ({}, {"damper": "none"}):
            yield candidate(
                cls,
                {"exponent": [], "stiffness": []},
                starts=starts,
                bounds=bounds,
                variant=variant,
            )


@register
class ContactHardStop(ContactEffect):
    """A second spring acts beyond a given penetration."""

    kind: Literal["contact.hard_stop"] = "contact.hard_stop"
    position: float = quantity(
        "m", "Penetration at which the stop engages", ge=0.0, search=(0.0, 0.05)
    )
    stiffness: float = quantity(
        "N/m", "Stiffness of the stop", gt=0.0, search=(1e3, 1e8), ratio=True
    )
    equation = "F += stiffness (x - position) while x > position"
    reference = "bilinear buffer"
    resembles = ("contact.power_law",)
    vanishes = True
    jumps = "position"

    def apply(self, p: ContactParameters) -> None:
        p.stop, p.stop_stiffness = self.position, self.stiffness

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        k, x = scales.stiffness, scales.depth
        starts = {
            "position": [x * q for q in (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)],
            "stiffness": [0.3 * k, k, 4.0 * k],
        }
        bounds = {"position": (0.0, x), "stiffness": (0.01 * k, 100.0 * k)}
        yield candidate(cls, starts, bounds=bounds, linear="stiffness")


@register
class ContactPreload(ContactEffect):
    """A force step at touch, independent of the speed."""

    kind: Literal["contact.preload"] = "contact.preload"
    force: float = quantity("N", "Force of the preload", ge=0.0, search=(0.0, 300.0))
    equation = "F += force while x > 0"
    reference = "preloaded buffer spring"
    resembles = ("contact.dry_friction", "contact.touch_offset")
    repeats = True

    def apply(self, p: ContactParameters) -> None:
        p.preload += self.force

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield cls.by_force(scales, linear="force")
