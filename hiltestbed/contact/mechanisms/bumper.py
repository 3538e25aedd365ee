"""A ball that touches a plate."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from hiltestbed.config.models import models_folder
from hiltestbed.contact.settings import Mechanism
from hiltestbed.plugins import register


@register
class Bumper(Mechanism):
    """A flat bumper: a ball on the active side touches a plate on the passive side."""

    kind: Literal["bumper"] = "bumper"
    flat: ClassVar[bool] = True

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / "bumper"
        return folder / "active.xml", folder / "passive.xml"


@register
class Latched(Mechanism):
    """A mechanism captured from the start: springs and dampers on all six axes hold A at P, in
    tension as well as compression.
    """

    kind: Literal["latched"] = "latched"
    captured: ClassVar[bool] = True

    def files(self) -> tuple[Path, Path]:
        folder = models_folder() / "bumper"
        return folder / "active.xml", folder / "passive.xml"
