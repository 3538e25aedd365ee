"""The elastic force differs from the nominal one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters

# of the nominal stiffness: lower bound in a captured mechanism, where friction may have been
# identified as stiffness
LITTLE = 0.01


@register
class ContactStiffness(Effect):
    """The contact stiffness differs from the nominal stiffness."""

    kind: Literal["contact.stiffness"] = "contact.stiffness"
    factor: float = quantity(
        "-", "True stiffness over nominal stiffness", gt=0.0, search=(0.3, 3.0), ratio=True
    )
    link = "contact"
    equation = "k -> factor k"
    reference = "Hooke"
    resembles = ("frame.compliance", "sensor.gain")
    repeats = True
    leading = "factor"

    def apply(self, p: ContactParameters) -> None:
        p.stiffness *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        bounds = {"factor": (LITTLE, 3.0)} if scales.captured else None
        yield candidate(cls, {"factor": [0.5, 0.75, 0.92, 1.08, 1.3, 1.8]}, bounds=bounds)


@register
class ContactPowerLaw(Effect):
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
    link = "contact"
    equation = "F = stiffness x^exponent + c v"
    reference = "Hertz for exponent 1.5"
    resembles = ("contact.stiffness", "sensor.saturation")
    leading = "exponent"

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
class ContactHardStop(Effect):
    """A second spring acts beyond a given penetration."""

    kind: Literal["contact.hard_stop"] = "contact.hard_stop"
    position: float = quantity(
        "m", "Penetration at which the stop engages", ge=0.0, search=(0.0, 0.05)
    )
    stiffness: float = quantity(
        "N/m", "Stiffness of the stop", gt=0.0, search=(1e3, 1e8), ratio=True
    )
    link = "contact"
    equation = "F += stiffness (x - position) while x > position"
    reference = "bilinear buffer"
    resembles = ("contact.power_law",)
    leading = "position"
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
        yield candidate(
            cls, starts, bounds={"position": (0.0, x), "stiffness": (0.01 * k, 100.0 * k)}
        )


@register
class ContactPreload(Effect):
    """A force step at touch, independent of the speed."""

    kind: Literal["contact.preload"] = "contact.preload"
    force: float = quantity("N", "Force of the preload", ge=0.0, search=(0.0, 300.0))
    link = "contact"
    equation = "F += force while x > 0"
    reference = "preloaded buffer spring"
    resembles = ("contact.dry_friction", "contact.touch_offset")
    repeats = True
    leading = "force"

    def apply(self, p: ContactParameters) -> None:
        p.preload += self.force

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        f = scales.force
        yield candidate(
            cls, {"force": [0.01 * f, 0.04 * f, 0.15 * f]}, bounds={"force": (0.0, 0.8 * f)}
        )
