"""Two spacecraft suspended on cables."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.platform.facilities.settings import Physical
from hiltestbed.plugins import register


@register
class SuspensionSettings(Physical):
    """Two articles on cables: full physical simulation, weight supported by winches."""

    distorts: ClassVar[str] = (
        "No loop and no delay, but a pendulum: the weight pulls back with m g/L per metre of "
        "travel, cables and winches add mass and friction, and a gimbal off the centre of mass "
        "tilts the article. Short contacts are reproduced correctly, long ones are not."
    )

    kind: Literal["suspension"]
    target: Literal["free", "fixed"] = Field(
        default="free", description="Target. free: it hangs as well; fixed: it is bolted down"
    )
    length: Positive = Field(
        default=10.0,
        description="Length of a cable, from its pivot to the gimbal [m]; a hall of 12 m",
    )
    cable_mass: NotNegative = Field(
        default=2.5, description="Mass of a cable [kg]; steel rope of 8 mm: 0.25 kg/m"
    )
    swing_damping: NotNegative = Field(
        default=0.0, description="Damping of a cable's pivot [N m s/rad]"
    )
    winch_mass: NotNegative = Field(
        default=15.0, description="Inertia of a winch, reflected to the cable [kg]; an estimate"
    )
    winch_friction: NotNegative = Field(
        default=4.0, description="Dry friction of a winch [N]; 0.1 % of the weight of 400 kg"
    )
    tension_bandwidth: Positive = Field(
        default=5.0, description="Bandwidth of the tension servo [Hz]; first order; an estimate"
    )
    tension_error: float = Field(
        default=0.001,
        description="Error of the tension, as a fraction of the weight [-]; the load cell's class",
    )
    gimbal_offset: float = Field(
        default=0.001,
        description="Height of the gimbal above the centre of mass [m]; balanced to 1 mm",
    )
