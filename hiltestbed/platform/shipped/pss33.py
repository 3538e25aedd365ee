"""Settings of the 3-3 PSS platform: six sliders on guides, each with a link to the platform."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, model_validator

from hiltestbed.config.validation import NotNegative, Positive, Problem, Strictly, refuse
from hiltestbed.platform.kinds import CommandPath, Driven
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario


# [m/s] highest approach speed at which the upper platform is clamped before the first touch
UPPER_SPEED = 0.3


class Actuator(Strictly):
    """The drive of each slider of the platform, and the friction of each of its motors.

    The defaults are those of a preloaded screw with its guide: sliding friction 0.5 % of a drive's
    40 kN, break-away 1.5 times that, the Stribeck speed of oiled steel, and a viscous part that
    equals the sliding friction at 0.5 m/s.
    """

    kind: Literal["ideal", "single", "dual"] = Field(
        default="ideal",
        description="Motors of a drive. ideal: without friction; single: one; dual: two, added by "
        "a differential screw, that always turn",
    )
    coulomb: NotNegative = Field(default=200.0, description="Sliding friction of a motor [N]")
    stiction: NotNegative = Field(
        default=300.0, description="Break-away friction of a motor [N], at least coulomb"
    )
    stribeck_speed: Positive = Field(
        default=0.005,
        description="Speed at which the excess of the break-away friction has fallen to 1/e [m/s]",
    )
    viscous: NotNegative = Field(default=400.0, description="Viscous friction of a motor [N s/m]")
    bias_speed: Positive = Field(
        default=0.3,
        description="Speed of both motors of a dual drive while the slider is at rest, as slider "
        "speed [m/s]",
    )

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        if self.kind == "ideal":
            why = "the actuator's kind is ideal, a drive without friction; take kind single or dual"
            names = ("coulomb", "stiction", "stribeck_speed", "viscous", "bias_speed")
            yield from (((name,), why) for name in names)
        elif self.kind == "single":
            why = "the actuator's kind is single, whose motor has no bias speed; take kind dual"
            yield ("bias_speed",), why

    def law(self) -> tuple[float, ...]:
        """Coulomb, stiction, Stribeck speed, viscous and bias speed of
        :class:`hiltestbed.platform.friction.DriveFriction`; an ideal
        drive has none.
        """
        if self.kind == "ideal":
            return 0.0, 0.0, self.stribeck_speed, 0.0, 0.0
        bias = self.bias_speed if self.kind == "dual" else 0.0
        return self.coulomb, self.stiction, self.stribeck_speed, self.viscous, bias

    @model_validator(mode="after")
    def _breaks_away(self) -> Actuator:
        if self.stiction < self.coulomb:
            given, least = f"{self.stiction:g} N", f"{self.coulomb:g} N"
            message = f"is less than coulomb (got {given}); allowed is {least} and more"
            refuse([(("stiction",), message)])
        return self


class Limits(Strictly):
    """Limits of a drive of the platform; they bound workspace measurements, while runs are bounded
    by the section ``safety``.
    """

    stroke: Positive = Field(
        default=0.72,
        description="Largest travel of a slider from home [m]; that of the guides in models/pss33",
    )
    speed: Positive = Field(
        default=2.0,
        description="Highest speed of a slider [m/s]; a screw of 40 mm lead at 3000 rpm",
    )
    acceleration: Positive = Field(
        default=20.0, description="Highest acceleration of a slider [m/s^2]; 40 kN on 2 t"
    )
    force: Positive = Field(
        default=4.0e4,
        description="Largest force of a drive [N]; four times the sum of static load, docking "
        "load and 1 m/s^2",
    )


class Workspace(Strictly):
    """Largest distance of a start from home; home is at the nominal first touch."""

    translation: Positive = Field(default=0.25, description="Reach from home along each axis [m]")
    rotation_deg: Positive = Field(
        default=10.0, description="Reach from home about each axis [deg]"
    )


@register
class Pss33(Driven):
    """Platform of the 3-3 PSS kind: six sliders, each with a link to the platform; drives with
    computed-torque control.
    """

    states_limits: ClassVar[bool] = False
    carries_upper: ClassVar[bool] = True
    start_needs_model: ClassVar[bool] = False
    drives = ("bandwidth", "damping_ratio", "encoder_resolution", "command", "actuator")
    distorts: ClassVar[str] = (
        "Computed torque with feed-forward removes the drives' lag in free motion; in contact the "
        "position loops yield like springs, so "
        "that A deviates from its command by force over stiffness. What remains is the delay of "
        "the force sensor, which a phase lead "
        "of the force removes, as at Shanghai Jiao Tong University."
    )

    kind: Literal["pss33"] = Field(
        default="pss33", description="Motion platform. pss33: 3-3 PSS, six sliders"
    )
    bandwidth: Positive = Field(
        default=40.0,
        description="Bandwidth of the drives' position loop [Hz]; the default is a quarter of the "
        "first mode of a large rig's limbs",
    )
    damping_ratio: Positive = Field(
        default=1.0, description="Damping ratio of the drives' position loop [-]"
    )
    encoder_resolution: NotNegative = Field(
        default=0.0,
        description="Resolution of a slider's encoder [m]; 0: not quantised; linear scales have "
        "1e-8 to 1e-6",
    )
    command: CommandPath = Field(
        default=CommandPath(),
        description="Controller of the drives: its rate, and its delay in cycles",
    )
    limits: Limits = Field(default=Limits(), description="Limits of a drive")
    workspace: Workspace = Field(
        default=Workspace(), description="Largest distance of a start from home"
    )
    actuator: Actuator = Field(
        default=Actuator(),
        description="Motors and friction of the drives; only with tracking servo",
    )

    def problems(self, scenario: Scenario) -> Iterator[Problem]:
        yield from super().problems(scenario)
        if scenario.rig.upper.kind == "prs3":
            return
        approach, reach = scenario.approach, self.workspace.translation
        yield from self._gap_outside(scenario, reach)
        for name, widest, unit in (
            ("offset", reach, "m"),
            ("attitude_deg", self.workspace.rotation_deg, "deg"),
        ):
            for k, value in enumerate(getattr(approach, name)):
                yield from _outside((name, k), value, -widest, widest, unit)

    def start_problems(self, scenario: Scenario) -> Iterator[Problem]:
        """With nine axes the gap may be the upper platform's heave; the lower one must reach its
        share.
        """
        if scenario.rig.upper.kind != "prs3":
            return
        import numpy as np

        from hiltestbed.frames import quat_from_attitude_deg, rotation_vectors
        from hiltestbed.platform.facilities.prs3 import LONGEST, lower_pose

        approach = scenario.approach
        reach, widest = self.workspace.translation, self.workspace.rotation_deg
        if outside := list(self._gap_outside(scenario, LONGEST)):
            yield from outside
            return
        if not abs(approach.velocity[2]) <= UPPER_SPEED:
            yield (
                ("approach", "velocity", 2),
                "is too fast for the upper platform to come to rest before the touch (got "
                f"{approach.velocity[2]:g} m/s); allowed is -{UPPER_SPEED:g} to {UPPER_SPEED:g} "
                "m/s",
            )
        pose = np.array(
            [[*approach.offset, -approach.gap, *quat_from_attitude_deg(approach.attitude_deg)]]
        )
        lower = lower_pose(pose)
        place, turn = np.abs(lower[0, :3]), np.degrees(np.abs(rotation_vectors(lower[:, 3:])[0]))
        if not (place.max() <= reach and turn.max() <= widest):
            where = ", ".join(f"{value:.3g}" for value in lower[0, :3])
            yield (
                ("approach",),
                f"starts outside the workspace (the lower platform would be at {where} m, rotated "
                f"by up to {turn.max():.3g} deg); allowed are {reach:g} m and {widest:g} deg on "
                "each axis: take a smaller offset or attitude_deg",
            )

    def _gap_outside(self, scenario: Scenario, most: float) -> Iterator[Problem]:
        least = -self.workspace.translation if scenario.mechanism.captured else 0.0
        return _outside(("gap",), scenario.approach.gap, least, most, "m")


def _outside(
    path: tuple[str | int, ...], value: float, low: float, high: float, unit: str
) -> Iterator[Problem]:
    if not low <= value <= high:
        yield (
            ("approach", *path),
            f"starts outside the workspace (got {value:g} {unit}); allowed is {low:g} to "
            f"{high:g} {unit}",
        )
