"""Two spacecraft that move freely: on a flat floor, and on cables."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive, Vector2
from hiltestbed.platform.kinds import Physical
from hiltestbed.plugins import register


@register
class AirBearingSettings(Physical):
    """Two articles on a flat floor: full physical simulation in the plane."""

    distorts: ClassVar[str] = (
        "No loop and no delay, but only three of six degrees of freedom, a floor that is not "
        "level, hoses that pull, and the mass of the air-bearing carriage under each article: the "
        "reduced mass of the contact is not that in orbit."
    )

    still: ClassVar[tuple[str, ...]] = ("py",)  # of the floor's plane, in which A turns about y

    kind: Literal["air_bearing"]
    target: Literal["free", "fixed"] = Field(
        default="free", description="Target. free: it floats as well; fixed: it is bolted down"
    )
    float_mass: NotNegative = Field(
        default=60.0,
        description="Mass of an article's carriage: pads, bottles, frame [kg]; an estimate",
    )
    tilt: Vector2 = Field(
        default=(0.0, 4.2e-5),
        description="Tilt of the floor along x and z [rad]; 0.005 inch in 10 feet, as the Air "
        "Bearing Floor at NASA Johnson",
    )
    film_damping: NotNegative = Field(
        default=0.2,
        description="Viscous damping of an article's pads [N s/m]; air of 1.8e-5 Pa s, 0.15 m^2 "
        "of pads, a film of 15 um: 0.18",
    )
    pad_radius: Positive = Field(
        default=0.6, description="Radius of the pads about the article's centre [m]"
    )
    friction: Annotated[float, Field(ge=0, le=0.01)] = Field(
        default=1e-5,
        description="Friction coefficient of the pads [-]; 1e-5 according to makers [recalled]",
    )
    hose_stiffness: NotNegative = Field(
        default=0.5,
        description="Stiffness of an air line, along x and z [N/m]; 0: bottles on board",
    )
    hose_damping: NotNegative = Field(default=0.5, description="Damping of an air line [N s/m]")


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
