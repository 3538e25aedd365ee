"""The user's own rig, from an MJCF file."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.platform.facilities.settings import CommandPath, Driven
from hiltestbed.plugins import register
from hiltestbed.run_folder.folders import is_file

if TYPE_CHECKING:
    from hiltestbed.platform.facilities.mjcf import Mjcf


@register
class MjcfSettings(Driven):
    """The user's own rig."""

    distorts: ClassVar[str] = (
        "Depends on the file. Plain position servos track with velocity feed-forward and yield "
        "under load; coupled axes ring at "
        "frequencies that no single axis shows."
    )

    drives: ClassVar[tuple[str, ...]] = ("command",)
    kind: Literal["mjcf"]
    model: str = Field(
        description="MJCF file of the rig, with a site `mount` and position actuators"
    )
    speed: Positive = Field(
        default=1.0, description="Highest speed of a sliding joint [m/s]; MJCF has no such number"
    )
    spin: Positive = Field(
        default=2.0,
        description="Highest speed of a rotating joint [rad/s]; MJCF has no such number",
    )
    acceleration: Positive = Field(
        default=20.0,
        description="Highest acceleration of a joint [m/s^2, rad/s^2]; MJCF has no such number",
    )
    command: CommandPath = Field(default=CommandPath(), description="How commands reach the drives")

    def file(self) -> Path:
        """The MJCF file: the given path, or else one of the shipped models."""
        from hiltestbed.config.models import models_folder

        given, shipped = Path(self.model), models_folder() / self.model
        return shipped if not is_file(given) and is_file(shipped) else given

    def stamp(self) -> Hashable:
        """Path and modification time of the file; None without a file."""
        path = self.file()
        return (str(path.resolve()), path.stat().st_mtime_ns) if is_file(path) else None

    @classmethod
    def contest(cls) -> Mapping[str, Mapping[str, Any]]:
        own = cls is MjcfSettings  # its model has no default
        return (
            {"mjcf": {"kind": "mjcf", "model": "xyz_table/xyz_table.xml"}}
            if own
            else super().contest()
        )

    def build(self) -> Mjcf:
        from hiltestbed.platform.facilities.mjcf import Mjcf

        return Mjcf(self)
