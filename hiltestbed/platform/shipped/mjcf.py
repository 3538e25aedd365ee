"""The user's own rig, from an MJCF file, and a shipped one of the same kind: a bridge crane over a
hall, with a wrist below its ram.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.models import models_folder, stamp
from hiltestbed.config.validation import ModelOrShipped, Positive
from hiltestbed.platform.kinds import CommandPath, Driven
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
        if cls is not MjcfSettings:
            return super().contest()
        # its model has no default
        return {"mjcf": {"kind": "mjcf", "model": "xyz_table/xyz_table.xml"}}


@register
class OverheadGantrySettings(MjcfSettings):
    """An overhead gantry: bridge, trolley, ram and a wrist of three axes; travel in metres, drives
    of a few hertz.
    """

    distorts: ClassVar[str] = (
        "Tonnes of bridge with position loops of 4 to 8 Hz: without feed-forward the lag of the "
        "slides is the main reason why a contact becomes active, and the ram yields to the force. "
        "Its reach is metres; most other rigs have less than one."
    )

    kind: Literal["overhead_gantry"]
    model: str = Field(
        default="overhead_gantry/overhead_gantry.xml",
        description="MJCF file of the gantry, with a site `mount` and position actuators",
    )
    speed: Positive = Field(
        default=0.6,
        description="Highest speed of bridge, trolley and ram [m/s]; fast bridge cranes",
    )
    spin: Positive = Field(
        default=0.8,
        description="Highest speed of a wrist joint [rad/s]; 45 deg/s, as motorised wrists have",
    )
    acceleration: Positive = Field(
        default=5.0, description="Highest acceleration of a joint [m/s^2, rad/s^2]; 20 kN on 4 t"
    )
    command: CommandPath = Field(
        default=CommandPath(controller_rate=500.0),
        description="Path of commands to the drives; every 2 ms, as usual for fieldbus drives",
    )

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        return "feed-forward of the drives, lead of the force", super().cure(lost)[1]
