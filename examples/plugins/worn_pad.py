"""A user-defined effect with one parameter: a worn rubber pad loses stiffness and gains damping.

hiltestbed run 02-bumper --plugin examples/plugins/worn_pad.py --set 'effects=[{kind:
contact.worn_pad, wear: 0.2}]'
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from hiltestbed.effects import Effect, quantity
from hiltestbed.effects.search import Candidate, Scales, candidate
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.contact.parameters import ContactParameters

SOFTER, LOSSIER = 1.0, 4.0  # relative change of stiffness and damping for each unit of wear


@register
class WornPad(Effect):
    """The rubber of the contact is worn: softer and with more damping."""

    kind: Literal["contact.worn_pad"] = "contact.worn_pad"
    wear: float = quantity("-", "Share of the pad that is worn", ge=0.0, lt=0.8, search=(0.0, 0.7))
    link = "contact"
    equation = "k -> k (1 - wear), c -> c (1 + 4 wear)"
    reference = "made up for this example"
    resembles = ("contact.stiffness", "contact.damping")
    leading = "wear"

    def apply(self, p: ContactParameters) -> None:
        """Change the parameters of one run's contact, in place."""
        p.stiffness *= 1.0 - SOFTER * self.wear
        p.damping *= 1.0 + LOSSIER * self.wear

    @classmethod
    def candidates(cls, scales: Scales) -> Iterator[Candidate]:
        """The starting points of a diagnosis; the bounds are those of the field above."""
        yield candidate(cls, {"wear": [0.05, 0.2, 0.5]})
