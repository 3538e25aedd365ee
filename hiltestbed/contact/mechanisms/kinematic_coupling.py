"""Three balls and three grooves, which locate two bodies in six axes with six points of contact."""

from __future__ import annotations

from typing import ClassVar, Literal

from hiltestbed.contact.described import Described
from hiltestbed.plugins import register


@register
class KinematicCoupling(Described):
    """Three balls that seat in three radial V-grooves: six contacts for six axes; latches draw them
    together, then hold.
    """

    kind: Literal["kinematic_coupling"] = "kinematic_coupling"
    folder: ClassVar[str] = "kinematic_coupling"
