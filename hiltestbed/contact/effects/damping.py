"""The contact dissipates more or less energy than the nominal one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters

# starting values of alpha times the speed at touch in the search for Hunt-Crossley damping
LOSSES = (0.01, 0.05, 0.2, 0.6)
# its upper bound: y - ln(1 + y) is equal at y = 6 and y = -6 e for e of about 1/6, the share of the
# speed that remains
MOST_LOSS = 6.0
# times the secant stiffness: upper bound of the spring in series with a friction slider
STIFFEST = 1e3


@register
class ContactDamping(Effect):
    """The contact damping differs from the nominal damping."""

    kind: Literal["contact.damping"] = "contact.damping"
    factor: float = quantity("-", "True damping over nominal damping", ge=0.0, search=(0.0, 6.0))
    link = "contact"
    equation = "c -> factor c"
    reference = "viscous damper"
    resembles = ("sensor.delay", "log.skew", "contact.hunt_crossley")
    repeats = True
    leading = "factor"

    def apply(self, p: ContactParameters) -> None:
        p.damping *= self.factor

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        yield candidate(cls, {"factor": [0.2, 0.6, 1.5, 2.5, 4.0]})


@register
class ContactHuntCrossley(Effect):
    """Hunt-Crossley damping: it grows with the penetration, so that the force has no step at
    touch.
    """

    kind: Literal["contact.hunt_crossley"] = "contact.hunt_crossley"
    alpha: float = quantity("s/m", "Hunt-Crossley damping coefficient", ge=0.0, search=(0.0, 30.0))
    link = "contact"
    equation = "F = k x (1 + alpha v)"
    reference = "K. H. Hunt, F. R. E. Crossley, ASME J. Appl. Mech. 42, 1975"
    resembles = ("contact.damping",)
    leading = "alpha"

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
class ContactDryFriction(Effect):
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
    link = "contact"
    equation = (
        "F += force tanh(v/2e-4); with a stiffness F += f, f' = stiffness v while |f| < force"
    )
    reference = "Coulomb; with a stiffness G. M. Jenkins, J. Br. Nucl. Energy Soc. 1, 1962"
    resembles = ("contact.damping", "contact.preload")
    leading = "force"

    def apply(self, p: ContactParameters) -> None:
        p.dry += self.force
        p.drag = self.stiffness

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        f, x = scales.force, scales.depth
        yield candidate(
            cls,
            {"force": [0.01 * f, 0.04 * f, 0.15 * f]},
            bounds={"force": (0.0, 0.8 * f)},
            stiffness=0.0,
        )
        if scales.captured:
            drag = {"force": [0.3 * f, 0.8 * f], "stiffness": [q * f / x for q in (2.0, 8.0, 30.0)]}
            yield candidate(
                cls, drag, bounds={"force": (0.0, f), "stiffness": (0.1 * f / x, STIFFEST * f / x)}
            )


@register
class ContactRelaxation(Effect):
    """The contact is stiffer under fast loading and relaxes under constant penetration."""

    kind: Literal["contact.relaxation"] = "contact.relaxation"
    stiffness: float = quantity(
        "N/m", "Stiffness of the Maxwell branch", gt=0.0, search=(1e2, 1e7), ratio=True
    )
    time_constant: float = quantity(
        "s", "Relaxation time of the Maxwell branch", gt=0.0, search=(1e-3, 10.0), ratio=True
    )
    link = "contact"
    equation = "F += z, z' = stiffness v - z/time_constant"
    reference = "Maxwell branch of the standard linear solid"
    resembles = ("sensor.highpass", "contact.damping")
    leading = "stiffness"

    def apply(self, p: ContactParameters) -> None:
        p.branch_stiffness, p.branch_time = self.stiffness, self.time_constant

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        k = scales.stiffness
        starts = {"stiffness": [0.1 * k, 0.4 * k], "time_constant": [0.004, 0.02, 0.08, 0.4]}
        yield candidate(
            cls, starts, bounds={"stiffness": (0.005 * k, 10.0 * k), "time_constant": (1e-3, 5.0)}
        )
