"""The user's own rig, from an MJCF file."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.models import models_folder, stamp
from hiltestbed.config.validation import ModelOrShipped, Positive
from hiltestbed.platform.facilities.settings import CommandPath, Driven
from hiltestbed.plugins import register


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
    model: ModelOrShipped = Field(
        description="MJCF file of the rig, with a site `mount` and position actuators; relative to "
        "the scenario file, or one of the shipped models"
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
        """The MJCF file: the user's own, or one of the shipped models."""
        return models_folder() / self.model  # an absolute path stays as it is

    def stamp(self) -> Hashable:
        """What changes with the content of the file and of the files that it names."""
        return stamp(self.file())

    @classmethod
    def contest(cls) -> Mapping[str, Mapping[str, Any]]:
        own = cls is MjcfSettings  # its model has no default
        return (
            {"mjcf": {"kind": "mjcf", "model": "xyz_table/xyz_table.xml"}}
            if own
            else super().contest()
        )
