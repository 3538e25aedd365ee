"""The limits of a scenario."""

from __future__ import annotations

from pydantic import Field

from hiltestbed.validation import Positive, Strictly


class Safety(Strictly):
    """Limits past which the run stops; null: not watched."""

    stroke: Positive | None = Field(default=0.72, description="of a slider from home [m]; the travel of the 3-3 PSS platform's")
    speed: Positive | None = Field(default=2.0, description="of a slider [m/s]")
    acceleration: Positive | None = Field(default=None, description="of a slider [m/s^2]")
    limb_angle_deg: Positive | None = Field(
        default=50.0, description="between a link and its slider [deg]; past it the drives lose their grip"
    )
    tracking_error: Positive | None = Field(default=None, description="distance between the pose commanded and reached [m]")
    force: Positive | None = Field(default=5.0e4, description="on the sensor [N]")
    torque: Positive | None = Field(default=5.0e4, description="on the sensor, at P's origin [N m]")
    energy: Positive | None = Field(default=None, description="that the rig may create in a run [J]")
