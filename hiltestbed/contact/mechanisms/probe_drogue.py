"""A probe with a latching head on a sprung rod, and the drogue that receives it."""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.contact.described import Described
from hiltestbed.plugins import register


@register
class ProbeDrogue(Described):
    """A probe whose head is on a compliant rod, and a drogue in whose socket the head's latches
    catch; the rod is then retracted.
    """

    kind: Literal["probe_drogue"] = "probe_drogue"
    folder: ClassVar[str] = "probe_drogue"
