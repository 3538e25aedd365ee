"""The safety limits of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydantic import Field

from hiltestbed.config.validation import Positive, Problem, Strictly

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike


class SafetyLimits(Strictly):
    """Safety limits: a run that exceeds one is stopped; null: no limit."""

    stroke: Positive | None = Field(
        default=0.72,
        description="Largest travel of a slider from home [m]; the default is that of the 3-3 PSS "
        "platform; null: no limit",
    )
    speed: Positive | None = Field(
        default=2.0, description="Highest speed of a slider [m/s]; null: no limit"
    )
    acceleration: Positive | None = Field(
        default=None, description="Highest acceleration of a slider [m/s^2]; null: no limit"
    )
    limb_angle_deg: Positive | None = Field(
        default=50.0,
        description="Largest angle between a link and its slider [deg], above which the drives "
        "lose their leverage; null: no limit",
    )
    tracking_error: Positive | None = Field(
        default=None,
        description="Largest distance between the commanded and the reached position [m]; null: "
        "no limit",
    )
    force: Positive | None = Field(
        default=5.0e4, description="Largest force on the sensor [N]; null: no limit"
    )
    torque: Positive | None = Field(
        default=5.0e4,
        description="Largest torque on the sensor, at P's origin [N m]; null: no limit",
    )
    energy: Positive | None = Field(
        default=None,
        description="Largest energy that the rig may generate in a run [J]; null: no limit",
    )

    def idle(self, scenario: ScenarioLike) -> Iterator[Problem]:
        platform = scenario.rig.platform
        if not platform.states_limits:
            return
        kind = f"a platform of kind {platform.kind}"
        yield ("limb_angle_deg",), f"{kind} has no 3-3 PSS limbs; leave it out"
        why = f"the joints of {kind} have their own limits, which this number does not change"
        for name in ("stroke", "speed", "acceleration"):
            if getattr(self, name) is not None:
                yield (name,), f"{why}; null switches them off; otherwise leave it out"
