"""A contact law learned from data, for departures that no named effect explains."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.config.piecewise import Curve, packed
from hiltestbed.effects.base import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters


@register
class ContactMap(Effect):
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
    link = "contact"
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
    leading = "penetration"

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
