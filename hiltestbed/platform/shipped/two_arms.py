"""Two industrial arms facing each other."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.platform.facilities.settings import CommandPath, Driven
from hiltestbed.platform.shipped.serial_arm import ArmController
from hiltestbed.plugins import register


@register
class TwoArmsSettings(Driven):
    """Two industrial arms of the 200-kg class, the passive one on a rail."""

    distorts: ClassVar[str] = (
        "As one arm, but twice: the gears of both sides yield, and the dead times of both "
        "controllers are in the loop. The passive side moves, so that weight and inertia of its "
        "mechanism act on the sensor and are subtracted from the reading."
    )

    drives: ClassVar[tuple[str, ...]] = ("controller", "command")
    kind: Literal["two_arms"]
    passive_share: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.5,
        description="Share of the relative motion that the passive arm performs near the touch "
        "[-]; 0: it stands still",
    )
    controller: ArmController = Field(
        default=ArmController(), description="Controller and motors of both arms and of the rail"
    )
    command: CommandPath = Field(
        default=CommandPath(controller_rate=250.0, delay_cycles=2),
        description="Path of commands to both arms; EPOS is commanded at 250 Hz",
    )

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        force = {"kind": "virtual_contact", "damping": lost}
        return "hybrid: a virtual damper in parallel with the real contact (EPOS)", {
            "force": force,
            "motion": {"kind": "feedforward"},
        }
