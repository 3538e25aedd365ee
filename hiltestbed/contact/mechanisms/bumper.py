"""A ball that meets a plate."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from hiltestbed.contact.settings import Mechanism
from hiltestbed.models import models_folder
from hiltestbed.plugins import register


@register
class Bumper(Mechanism):
    """A flat bumper: a ball on the active side meets a plate on the passive one."""

    kind: Literal["bumper"] = "bumper"
    flat: ClassVar[bool] = True

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / "bumper"
        return folder / "active.xml", folder / "passive.xml"


@register
class Latched(Mechanism):
    """A pair that is captured from the start: six springs and dampers hold A in P, they pull as well as push."""

    kind: Literal["latched"] = "latched"
    captured: ClassVar[bool] = True

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / "bumper"
        return folder / "active.xml", folder / "passive.xml"
