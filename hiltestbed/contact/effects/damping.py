"""The contact loses another energy than believed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters

LOSSES = (0.01, 0.05, 0.2, 0.6)  # alpha times the speed of the touch, from which Hunt and Crossley's damping is sought
MOST_LOSS = 6.0  # up to which it is sought: a sixth is left of the speed, where y - ln(1 + y) is the same for y = 6 and y = -6 e
STIFFEST = 1e3  # of the secant stiffness: the stiffest spring that drags a slider


@register
class ContactDamping(Effect):
    """The contact damper is stronger or weaker than believed."""

    kind: Literal["contact.damping"] = "contact.damping"
    factor: float = quantity("-", "True damping over the one believed", ge=0.0, search=(0.0, 6.0))
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
    """The damping grows with the penetration: no force step at touch."""

    kind: Literal["contact.hunt_crossley"] = "contact.hunt_crossley"
    alpha: float = quantity("s/m", "Growth of the force with the rate of penetration", ge=0.0, search=(0.0, 30.0))
    link = "contact"
    equation = "F = k x (1 + alpha v)"
    reference = "K. H. Hunt, F. R. E. Crossley, ASME J. Appl. Mech. 42, 1975"
    resembles = ("contact.damping",)
    leading = "alpha"

    def apply(self, p: ContactParameters) -> None:
        p.alpha = self.alpha

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        speed = math.sqrt(scales.slow * scales.fast)  # what counts is alpha times it: it is the rebound's loss, to a factor
        yield candidate(cls, {"alpha": [a / speed for a in LOSSES]}, bounds={"alpha": (0.0, MOST_LOSS / speed)})


@register
class ContactDryFriction(Effect):
    """Dry friction in the buffer: a loop whose width depends on neither speed nor stroke."""

    kind: Literal["contact.dry_friction"] = "contact.dry_friction"
    force: float = quantity("N", "Friction while it slides", ge=0.0, search=(0.0, 300.0))
    stiffness: float = quantity(
        "N/m", "Stiffness of the spring that drags the slider before it slips; 0: rigid", default=0.0, ge=0.0, search=(1e2, 1e9), ratio=True
    )
    link = "contact"
    equation = "F += force tanh(v/2e-4); with a stiffness F += f, f' = stiffness v while |f| < force"
    reference = "Coulomb; with a stiffness G. M. Jenkins, J. Br. Nucl. Energy Soc. 1, 1962"
    resembles = ("contact.damping", "contact.preload")
    leading = "force"

    def apply(self, p: ContactParameters) -> None:
        p.dry += self.force
        p.drag = self.stiffness

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        f, x = scales.force, scales.depth
        yield candidate(cls, {"force": [0.01 * f, 0.04 * f, 0.15 * f]}, bounds={"force": (0.0, 0.8 * f)}, stiffness=0.0)
        if scales.captured:
            drag = {"force": [0.3 * f, 0.8 * f], "stiffness": [q * f / x for q in (2.0, 8.0, 30.0)]}
            yield candidate(cls, drag, bounds={"force": (0.0, f), "stiffness": (0.1 * f / x, STIFFEST * f / x)})


@register
class ContactRelaxation(Effect):
    """The contact is stiffer when fast and relaxes when held."""

    kind: Literal["contact.relaxation"] = "contact.relaxation"
    stiffness: float = quantity("N/m", "Stiffness of the branch", gt=0.0, search=(1e2, 1e7), ratio=True)
    time_constant: float = quantity("s", "Time constant with which the branch relaxes", gt=0.0, search=(1e-3, 10.0), ratio=True)
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
        yield candidate(cls, starts, bounds={"stiffness": (0.005 * k, 10.0 * k), "time_constant": (1e-3, 5.0)})
