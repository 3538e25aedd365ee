"""A bridge crane over a hall, with a wrist below its ram."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.platform.facilities.settings import CommandPath
from hiltestbed.platform.shipped.mjcf import MjcfSettings
from hiltestbed.plugins import register


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
