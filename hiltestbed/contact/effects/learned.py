"""A law of the contact that was learned from data, where no effect with a name does it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.piecewise import Curve, packed
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters


@register
class ContactMap(Effect):
    """A force that is added to the believed spring and damper, as curves over penetration, rate and a slider's stretch."""

    kind: Literal["contact.map"] = "contact.map"
    penetration: Curve = quantity("m, N", "Knots of the force over the penetration; past the ends the last slopes go on", default=())
    rate: Curve = quantity("m/s, N", "Knots of the force over the rate; past the ends the last slopes go on", default=())
    stretch: Curve = quantity("m, N", "Knots of the force over the stretch of a slider; it follows at the ends", default=())
    spring: Curve = quantity(
        "m, -", "Knots of a part of the elastic force that is added, over the penetration; constant past the ends", default=()
    )
    spring_rate: Curve = quantity("m/s, -", "Knots of such a part over the rate of the penetration; constant past the ends", default=())
    link = "contact"
    equation = "F += f(x) + g(v) + h(s) + (p(x) + q(v)) k x, s' = v while s is within the knots of h, each curve piecewise linear"
    reference = "stop operator: M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis, 1989"
    resembles = ("contact.power_law", "contact.hard_stop", "contact.damping", "contact.dry_friction")
    leading = "penetration"

    def apply(self, p: ContactParameters) -> None:
        p.over_penetration, p.over_rate, p.over_stretch = packed(self.penetration), packed(self.rate), packed(self.stretch)
        p.spring_over_penetration, p.spring_over_rate = packed(self.spring), packed(self.spring_rate)

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """None: it is learned where the effects with a name leave more than noise, see :mod:`hiltestbed.diagnosis.learned`."""
        return iter(())
