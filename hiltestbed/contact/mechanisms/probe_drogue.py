"""A latching head on a sprung rod, and the drogue that it slides into."""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.contact.described import Described
from hiltestbed.plugins import register


@register
class ProbeDrogue(Described):
    """A head on a rod that gives way, and a drogue in whose socket its latches catch; the rod is then drawn in."""

    kind: Literal["probe_drogue"] = "probe_drogue"
    folder: ClassVar[str] = "probe_drogue"
