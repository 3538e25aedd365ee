"""A ball that meets a plate."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from hiltestbed.contact.settings import Mechanism
from hiltestbed.models import load
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from mujoco import MjSpec


@register
class Bumper(Mechanism):
    """A flat bumper: a ball on the active side meets a plate on the passive one."""

    kind: Literal["bumper"] = "bumper"
    flat: ClassVar[bool] = True

    def sides(self) -> tuple[MjSpec, MjSpec]:
        return load("bumper/active"), load("bumper/passive")


@register
class Latched(Mechanism):
    """A pair that is captured from the start: six springs and dampers hold A in P, they pull as well as push."""

    kind: Literal["latched"] = "latched"
    captured: ClassVar[bool] = True

    def sides(self) -> tuple[MjSpec, MjSpec]:
        return load("bumper/active"), load("bumper/passive")
