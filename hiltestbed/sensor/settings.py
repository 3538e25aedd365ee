"""The sensor section of a scenario."""

from __future__ import annotations

from pydantic import Field

from hiltestbed.config.validation import NotNegative, Positive, Strictly, Vector3


class Sensor(Strictly):
    """The force-torque sensor below the passive port; keys in the order of its signal chain."""

    delay: NotNegative = Field(
        default=0.0,
        description="Pure delay of the reading [s]; need not be a whole number of ticks",
    )
    lowpass: Positive | None = Field(
        default=None, description="Cut-off frequency of the first-order low-pass [Hz]; null: none"
    )
    time_constant: Positive | None = Field(
        default=None,
        description="Time constant of the charge amplifier's high-pass [s]; null: none",
    )
    noise: NotNegative = Field(
        default=0.0, description="Standard deviation of the noise of each force axis [N]"
    )
    torque_noise: NotNegative = Field(
        default=0.0, description="Standard deviation of the noise of each torque axis [N m]"
    )
    drift: Vector3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Linear drift of the force axes from the start of the run [N/s]",
    )
    quantisation: NotNegative = Field(
        default=0.0, description="Quantisation step of the force reading [N]; 0: none"
    )
    torque_quantisation: NotNegative = Field(
        default=0.0, description="Quantisation step of the torque reading [N m]; 0: none"
    )
    range: Positive | None = Field(
        default=None,
        description="Measuring range of each force axis, at which the reading clips [N]; null: "
        "unlimited",
    )
    torque_range: Positive | None = Field(
        default=None,
        description="Measuring range of each torque axis, at which the reading clips [N m]; null: "
        "unlimited",
    )
