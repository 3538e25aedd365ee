"""An androgynous ring with three guide petals per side, after the International Docking System
Standard.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.contact.described import Described
from hiltestbed.plugins import register


@register
class IdssRing(Described):
    """An androgynous ring with three guide petals per side: soft capture by latches, attenuation,
    hard capture.
    """

    kind: Literal["idss_ring"] = "idss_ring"
    folder: ClassVar[str] = "idss_ring"
