"""What a scenario says of a facility: every number of a drive as a key with unit, default and source. It needs pydantic alone.

A source in brackets, [recalled], is an order of magnitude from memory, not a figure that was looked up.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, Strict

from hiltestbed.folders import is_file
from hiltestbed.platform.kinds import Platform
from hiltestbed.plugins import register
from hiltestbed.validation import NotNegative, Positive, Problem, Strictly, Vector2

if TYPE_CHECKING:
    from hiltestbed.platform.facilities.facility import Facility
    from hiltestbed.scenario import Scenario

Ratio = Annotated[float, Field(gt=0, le=10)]
SixPositive = Annotated[tuple[Positive, ...], Strict(False), Field(min_length=6, max_length=6)]


class CommandPath(Strictly):
    """How commands reach a facility's drives."""

    controller_rate: Positive | None = Field(
        default=None, description="Rate of the facility's own controller [Hz], which interpolates in between; null: that of the loop"
    )
    delay_cycles: Annotated[int, Field(ge=0, le=200)] = Field(
        default=0, description="Whole cycles for which the controller holds a command back [-]"
    )

    def cycle(self, rate: float) -> int:
        """Ticks of a controller's cycle, at the loop's rate [Hz]."""
        return 1 if self.controller_rate is None else max(1, round(rate / self.controller_rate))

    def lag(self, rate: float) -> float:
        """How late the controller is [s]: a pose meant for the end of its tick arrives at the end of a cycle that begins later."""
        return (self.cycle(rate) * (self.delay_cycles + 1) - 1) / rate

    def problems(self, rate: float) -> Iterator[tuple[tuple[str | int, ...], str]]:
        """A controller's cycle is a whole number of ticks."""
        if self.controller_rate is None:
            return
        ratio = rate / self.controller_rate
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            near = rate / max(1, round(ratio))
            yield (
                ("controller_rate",),
                f"does not divide the loop's rate (got {self.controller_rate:g} Hz in a loop of {rate:g} Hz = {ratio:g} passes a cycle); "
                f"allowed is the rate over a whole number, such as {near:g}",
            )


class Friction(Strictly):
    """Dry friction of a drive; all zero: none."""

    coulomb: NotNegative = Field(description="Sliding friction [N, N m]")
    stiction: NotNegative = Field(description="Break-away friction [N, N m], at least coulomb")
    stribeck_speed: Positive = Field(description="Speed at which the break-away excess has fallen to 1/e [m/s, rad/s]")
    viscous: NotNegative = Field(description="Viscous friction [N s/m, N m s/rad]")


class Valve(Strictly):
    """Servo valve of a leg: a second order between command and spool."""

    bandwidth: Positive = Field(
        default=120.0,
        description="Natural frequency of the spool [Hz]; a two-stage flow-control valve at small opening, makers' curves [recalled]",
    )
    damping_ratio: Ratio = Field(default=0.7, description="Damping ratio of the spool [-]; makers' curves [recalled]")
    flow: Positive = Field(
        default=5.0e-3,
        description="Flow at full opening without load [m^3/s]; 300 l/min: 0.8 m/s of the piston, a size that is made [recalled]",
    )


class HydraulicDrive(Strictly):
    """Cylinder, oil and controller of a leg."""

    kind: Literal["hydraulic"] = Field(default="hydraulic", description="Hydraulic cylinders as legs")
    supply: Positive = Field(default=2.1e7, description="Supply pressure [Pa]; 210 bar, the usual one of test rigs")
    area: Positive = Field(default=6.26e-3, description="Area of the piston [m^2]; bore 100 mm, rod 45 mm on both sides")
    dead_volume: Positive = Field(
        default=6.5e-4, description="Dead volume of hose, manifold and end of each side [m^3]; a tenth of the stroke's"
    )
    bulk_modulus: Positive = Field(
        default=8.0e8, description="Bulk modulus of oil with hoses and dissolved air [Pa]; 0.7 to 1.0e9 (Merritt 1967)"
    )
    leakage: NotNegative = Field(default=2.0e-12, description="Leakage past the piston [m^3/s/Pa]; 2.5 l/min at 210 bar")
    valve: Valve = Field(default=Valve(), description="Servo valve of a leg")
    gain: Positive = Field(
        default=69.0, description="Gain of the position loop [1/s]; set so that 10 Hz passes within 2 dB and 70 deg, as Harbin reports"
    )
    pressure_feedback: NotNegative = Field(
        default=3.3e-10, description="Dynamic pressure feedback, flow per load pressure [m^3/s/Pa]; damps the oil's spring by 0.2 to 0.6"
    )
    feedback_corner: Positive = Field(default=0.5, description="Frequency below which the pressure feedback lets go [Hz]")
    encoder_resolution: NotNegative = Field(default=1.0e-6, description="Resolution of a leg's transducer [m]; magnetostrictive, 1 um")
    friction: Friction = Field(
        default=Friction(coulomb=120.0, stiction=180.0, stribeck_speed=0.005, viscous=600.0),
        description="Friction of the seals; low-friction seals of test cylinders, 0.1 % of 131 kN, break-away 1.5 times that",
    )
    speed: Positive = Field(default=0.8, description="Highest speed of a leg [m/s]: what the valve lets through")
    acceleration: Positive = Field(default=15.0, description="Highest acceleration of a leg [m/s^2]")


class ElectricDrive(Strictly):
    """Screw drive of a leg under a model-based position loop."""

    kind: Literal["electric"] = Field(description="Electric screw drives as legs")
    bandwidth: Positive = Field(
        default=25.0, description="Bandwidth of a leg's position loop [Hz]; half the first mode of large electric legs"
    )
    damping_ratio: Ratio = Field(default=0.9, description="Damping ratio of a leg's position loop [-]")
    encoder_resolution: NotNegative = Field(
        default=1.0e-7, description="Resolution of a leg's encoder [m]; 20 bits a turn, 31 mm lead: 0.03 um, times the screw's own error"
    )
    friction: Friction = Field(
        default=Friction(coulomb=0.0, stiction=0.0, stribeck_speed=0.005, viscous=0.0),
        description="Friction of screw and guide; none: compensated",
    )
    force: Positive = Field(default=4.0e4, description="Largest force of a drive [N]")
    speed: Positive = Field(default=1.0, description="Highest speed of a leg [m/s]")
    acceleration: Positive = Field(default=15.0, description="Highest acceleration of a leg [m/s^2]")


class ResponseSettings(Strictly):
    """A response of each axis in place of simulated drives."""

    order: Literal[2, 3] = Field(default=2, description="Order of each axis [-]")
    bandwidth: Positive | SixPositive = Field(default=20.0, description="Natural frequency [Hz] of all axes or x, y, z, rx, ry, rz")
    damping_ratio: Positive | SixPositive = Field(default=0.7, description="Damping ratio [-] of all axes or of each")
    gain: Positive | SixPositive = Field(default=60.0, description="Gain of order 3 [1/s] of all axes or of each")
    delay: NotNegative = Field(default=0.0, description="Pure delay [s], any length")

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        if self.order == 2:
            yield ("gain",), "the response's order is 2, which has none; take order 3"


class Driven(Platform):
    """A platform of this package that is told where to go."""

    tracking: Literal["servo", "response", "ideal"] = Field(
        default="servo",
        description="How it follows. servo: its dynamics under its drives; response: a second or third order with a delay in their place; "
        "ideal: the pose reaches the command exactly, one tick later",
    )
    response: ResponseSettings = Field(
        default=ResponseSettings(), description="What it answers to its command; with tracking response alone"
    )

    def facility(self) -> Facility:
        return _built(self, self.stamp())  # type: ignore[arg-type]  # frozen, thus hashable

    def stamp(self) -> Hashable:
        """What of a model may change while its settings stay: nothing of a shipped one."""
        return None


@lru_cache(maxsize=32)
def _built(settings: Driven, stamp: Hashable) -> Facility:
    from hiltestbed.platform.facilities import build_facility

    return build_facility(settings)


class Physical(Platform):
    """A hall in which bodies move by themselves."""

    physical: ClassVar[bool] = True
    tracking: ClassVar[str] = "free"

    def facility(self) -> Facility:
        from hiltestbed.platform.facilities import build_facility

        return build_facility(self)

    def alike(self, scenario: Scenario) -> Hashable:
        return (super().alike(scenario), scenario.spacecraft.model_dump_json())

    def reference(self) -> dict[str, Any]:
        return {"kind": "pss33", "tracking": "ideal"}


@register
class StewartSettings(Driven):
    """A Stewart platform: six legs under the active side."""

    distorts: ClassVar[str] = (
        "A hydraulic leg is a third order: its position loop lags by 1/K, and the oil's spring rings under the platform's mass. "
        "Without feed-forward that lag takes k/K out of the damping; with it, as model-based control at Harbin does, the valves and the "
        "oil's modes are left. Seals stick at reversal."
    )

    drives: ClassVar[tuple[str, ...]] = ("drive", "command")
    kind: Literal["stewart"]
    drive: Annotated[HydraulicDrive | ElectricDrive, Field(discriminator="kind")] = Field(
        default=HydraulicDrive(), description="Drives of the legs, hydraulic or electric"
    )
    command: CommandPath = Field(default=CommandPath(), description="How commands reach the drives")

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        return "feed-forward on the rig's model, lead of the force (Harbin)", super().cure(lost)[1]


class ArmController(Strictly):
    """Controller and motors of an arm."""

    bandwidth: Positive = Field(
        default=12.0,
        description="Bandwidth of the motors' position loop [Hz]; its own bandwidth is not published, 10 to 15 Hz are usual [recalled]",
    )
    damping_ratio: Ratio = Field(
        default=0.9, description="Damping ratio of the motors' position loop [-]; no overshoot, as path controllers are set"
    )
    encoder_resolution: NotNegative = Field(
        default=4.0e-7, description="Resolution of a motor's encoder, at the joint [rad]; resolver of 16 bits at a ratio of 240"
    )
    friction: Friction = Field(
        default=Friction(coulomb=120.0, stiction=180.0, stribeck_speed=0.003, viscous=900.0),
        description="Friction of the first axis' gear, at the joint; 1 % of its torque, what a controller's own compensation leaves of "
        "it; the others in the ratio of their torques",
    )


@register
class SerialArmSettings(Driven):
    """A six-axis industrial arm of the 200-kg class."""

    distorts: ClassVar[str] = (
        "The controller takes a command every 4 ms and acts on it whole cycles later: a dead time that no feed-forward reaches, and most "
        "of what makes an arm active in a stiff contact. Elastic gears ring at 5 to 8 Hz and yield to the force. A soft contact with a "
        "virtual damper beside it gives the damping back, as at EPOS."
    )

    drives: ClassVar[tuple[str, ...]] = ("controller", "command")
    kind: Literal["serial_arm"]
    controller: ArmController = Field(default=ArmController(), description="Controller and motors of the arm")
    command: CommandPath = Field(
        default=CommandPath(controller_rate=250.0, delay_cycles=2),
        description="How commands reach the arm; 250 Hz: the 4 ms of KUKA's RSI, and the rate at EPOS; two cycles held back [recalled]",
    )

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        force = {"kind": "virtual_contact", "damping": lost}
        return "hybrid: a virtual damper beside the real contact (EPOS)", {"force": force, "motion": {"kind": "feedforward"}}


@register
class TwoArmsSettings(Driven):
    """Two industrial arms of the 200-kg class, the passive one on a rail."""

    distorts: ClassVar[str] = (
        "As one arm, and twice: both sides' gears yield, and both controllers' dead time stands in the loop. The passive side moves, so "
        "that the sensor carries weight and inertia of its mechanism, which are taken out of the reading."
    )

    drives: ClassVar[tuple[str, ...]] = ("controller", "command")
    kind: Literal["two_arms"]
    passive_share: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.5, description="Share of the relative motion near the touch that the passive arm makes [-]; 0: it stands still"
    )
    controller: ArmController = Field(default=ArmController(), description="Controller and motors of both arms and of the rail")
    command: CommandPath = Field(
        default=CommandPath(controller_rate=250.0, delay_cycles=2), description="How commands reach both arms; EPOS is commanded at 250 Hz"
    )

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        force = {"kind": "virtual_contact", "damping": lost}
        return "hybrid: a virtual damper beside the real contact (EPOS)", {"force": force, "motion": {"kind": "feedforward"}}


@register
class MjcfSettings(Driven):
    """The user's own rig."""

    distorts: ClassVar[str] = (
        "Whatever the file holds. Plain position servos follow a feed-forward of the velocity and bend under load; coupled axes ring at "
        "frequencies that no single axis shows."
    )

    drives: ClassVar[tuple[str, ...]] = ("command",)
    kind: Literal["mjcf"]
    model: str = Field(description="MJCF file of the rig, with a site `mount` and position actuators")
    speed: Positive = Field(default=1.0, description="Highest speed of a sliding joint [m/s]; MJCF has no such number")
    spin: Positive = Field(default=2.0, description="Highest speed of a turning joint [rad/s]; MJCF has no such number")
    acceleration: Positive = Field(default=20.0, description="Highest acceleration of a joint [m/s^2, rad/s^2]; MJCF has no such number")
    command: CommandPath = Field(default=CommandPath(), description="How commands reach the drives")

    def file(self) -> Path:
        """The MJCF: as it is named, or among the shipped models."""
        from hiltestbed.models import models_folder

        given, shipped = Path(self.model), models_folder() / self.model
        return shipped if not is_file(given) and is_file(shipped) else given

    def stamp(self) -> Hashable:
        """The file as it stands."""
        path = self.file()
        return (str(path.resolve()), path.stat().st_mtime_ns) if is_file(path) else None


@register
class AirBearingSettings(Physical):
    """Two articles on a flat floor: full physical simulation in the plane."""

    distorts: ClassVar[str] = (
        "No loop and no delay, but three degrees of freedom of six, a floor that is not level, hoses that pull, and the mass of what "
        "floats under each article: the reduced mass of the contact is not that in orbit."
    )

    kind: Literal["air_bearing"]
    target: Literal["free", "fixed"] = Field(default="free", description="Whether the target floats, too, or is bolted down")
    float_mass: NotNegative = Field(default=60.0, description="Mass of what carries an article, pads, bottles, frame [kg]; an estimate")
    tilt: Vector2 = Field(
        default=(0.0, 4.2e-5),
        description="Tilt of the floor along x and z [rad]; 0.005 inch in 10 feet, as the Air Bearing Floor at NASA Johnson",
    )
    film_damping: NotNegative = Field(
        default=0.2, description="Viscous damping of an article's pads [N s/m]; air of 1.8e-5 Pa s, 0.15 m^2 of pads, a film of 15 um: 0.18"
    )
    pad_radius: Positive = Field(default=0.6, description="Radius of the pads about the article's centre [m]")
    friction: Annotated[float, Field(ge=0, le=0.01)] = Field(
        default=1e-5, description="Friction coefficient of the pads [-]; 1e-5 is what makers state [recalled]"
    )
    hose_stiffness: NotNegative = Field(default=0.5, description="Stiffness of an air line, along x and z [N/m]; 0: bottles on board")
    hose_damping: NotNegative = Field(default=0.5, description="Damping of an air line [N s/m]")


@register
class SuspensionSettings(Physical):
    """Two articles on cables: full physical simulation, weight held by winches."""

    distorts: ClassVar[str] = (
        "No loop and no delay, but a pendulum: weight pulls back with m g/L for each metre of travel, cables and winches add mass and "
        "friction, and a gimbal that misses the centre of mass tilts the article. Short contacts are right, long ones are not."
    )

    kind: Literal["suspension"]
    target: Literal["free", "fixed"] = Field(default="free", description="Whether the target hangs, too, or is bolted down")
    length: Positive = Field(default=10.0, description="Length of a cable, from its pivot to the gimbal [m]; a hall of 12 m")
    cable_mass: NotNegative = Field(default=2.5, description="Mass of a cable [kg]; steel rope of 8 mm: 0.25 kg/m")
    swing_damping: NotNegative = Field(default=0.0, description="Damping of a cable's pivot [N m s/rad]")
    winch_mass: NotNegative = Field(default=15.0, description="Inertia of a winch as the article feels it [kg]; an estimate")
    winch_friction: NotNegative = Field(default=4.0, description="Dry friction of a winch [N]; 0.1 % of the weight of 400 kg")
    tension_bandwidth: Positive = Field(default=5.0, description="Bandwidth of the tension servo [Hz]; first order; an estimate")
    tension_error: float = Field(default=0.001, description="Error of the tension, as a part of the weight [-]; the load cell's class")
    gimbal_offset: float = Field(default=0.001, description="Height of the gimbal above the centre of mass [m]; balanced to 1 mm")


FacilitySettings = Annotated[
    StewartSettings | SerialArmSettings | TwoArmsSettings | MjcfSettings | AirBearingSettings | SuspensionSettings,
    Field(discriminator="kind"),
]
