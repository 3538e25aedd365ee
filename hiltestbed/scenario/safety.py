"""The limits of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pydantic import Field

from hiltestbed.validation import Positive, Problem, Strictly

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


class Safety(Strictly):
    """Limits past which the run stops; null: not watched."""

    stroke: Positive | None = Field(
        default=0.72, description="Largest travel of a slider from home [m]; the default is that of the 3-3 PSS platform; null: not watched"
    )
    speed: Positive | None = Field(default=2.0, description="Highest speed of a slider [m/s]; null: not watched")
    acceleration: Positive | None = Field(default=None, description="Highest acceleration of a slider [m/s^2]; null: not watched")
    limb_angle_deg: Positive | None = Field(
        default=50.0,
        description="Largest angle between a link and its slider [deg], past which the drives lose their grip; null: not watched",
    )
    tracking_error: Positive | None = Field(
        default=None, description="Largest distance between the commanded and the reached position [m]; null: not watched"
    )
    force: Positive | None = Field(default=5.0e4, description="Largest force on the sensor [N]; null: not watched")
    torque: Positive | None = Field(default=5.0e4, description="Largest torque on the sensor, at P's origin [N m]; null: not watched")
    energy: Positive | None = Field(default=None, description="Largest energy that the rig may create in a run [J]; null: not watched")

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        platform = scenario.rig.platform
        if platform.states_limits:
            yield ("limb_angle_deg",), f"a platform of kind {platform.kind} has no limbs of the 3-3 PSS kind; leave it out"
            for name in ("stroke", "speed", "acceleration"):
                if getattr(self, name) is not None:
                    why = f"the joints of a platform of kind {platform.kind} have limits of their own, on which this number does not act"
                    yield (name,), f"{why}; null switches them off, other numbers leave it out"
