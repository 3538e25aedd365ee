"""Industrial arms of six axes: one, and two that face each other."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive, Strictly
from hiltestbed.platform.kinds import CommandPath, Driven, Friction, Ratio
from hiltestbed.plugins import register


class ArmController(Strictly):
    """Controller and motors of an arm."""

    bandwidth: Positive = Field(
        default=12.0,
        description="Bandwidth of the motors' position loop [Hz]; not published for this arm, 10 "
        "to 15 Hz are usual [recalled]",
    )
    damping_ratio: Ratio = Field(
        default=0.9,
        description="Damping ratio of the motors' position loop [-]; no overshoot, as path "
        "controllers are tuned",
    )
    encoder_resolution: NotNegative = Field(
        default=4.0e-7,
        description="Resolution of a motor's encoder, at the joint [rad]; resolver of 16 bits at "
        "a ratio of 240",
    )
    friction: Friction = Field(
        default=Friction(coulomb=120.0, stiction=180.0, stribeck_speed=0.003, viscous=900.0),
        description="Friction of the first axis' gear, at the joint; 1 % of its torque, the usual "
        "rest after a controller's own friction "
        "compensation; the other axes in the ratio of their torques",
    )


class Arms(Driven):
    """Industrial arms with controllers of their own."""

    drives: ClassVar[tuple[str, ...]] = ("controller", "command")

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        force = {"kind": "virtual_contact", "damping": lost}
        hybrid = {"force": force, "motion": {"kind": "feedforward"}}
        return "hybrid: a virtual damper in parallel with the real contact (EPOS)", hybrid


@register
class SerialArmSettings(Arms):
    """A six-axis industrial arm of the 200-kg class."""

    distorts: ClassVar[str] = (
        "The controller takes a command every 4 ms and acts on it whole cycles later: a dead time "
        "that feed-forward cannot remove, and the main reason why a stiff contact becomes active. "
        "Elastic gears ring at 5 to 8 Hz and yield to the force. A soft contact with a virtual "
        "damper in parallel restores the damping, as at EPOS."
    )

    kind: Literal["serial_arm"]
    controller: ArmController = Field(
        default=ArmController(), description="Controller and motors of the arm"
    )
    command: CommandPath = Field(
        default=CommandPath(controller_rate=250.0, delay_cycles=2),
        description="Path of commands to the arm; 250 Hz: the 4 ms of KUKA's RSI, and the rate at "
        "EPOS; a delay of two cycles [recalled]",
    )


@register
class TwoArmsSettings(Arms):
    """Two industrial arms of the 200-kg class, the passive one on a rail."""

    distorts: ClassVar[str] = (
        "As one arm, but twice: the gears of both sides yield, and the dead times of both "
        "controllers are in the loop. The passive side moves, so that weight and inertia of its "
        "mechanism act on the sensor and are subtracted from the reading."
    )

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
