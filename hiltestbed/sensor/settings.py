"""The sensor's section of a scenario."""

from __future__ import annotations

from pydantic import Field

from hiltestbed.validation import NotNegative, Positive, Strictly, Vector3


class Sensor(Strictly):
    """The force and torque sensor below the passive port, in the order of its chain."""

    delay: NotNegative = Field(default=0.0, description="pure delay [s], any length, not only whole ticks")
    lowpass: Positive | None = Field(default=None, description="cut-off of the first-order low-pass [Hz]; null: none")
    time_constant: Positive | None = Field(default=None, description="of the charge amplifier's high-pass [s]; null: none")
    noise: NotNegative = Field(default=0.0, description="1 sigma of each force axis [N]")
    torque_noise: NotNegative = Field(default=0.0, description="1 sigma of each torque axis [N m]")
    drift: Vector3 = Field(default=(0.0, 0.0, 0.0), description="linear drift of the force axes [N/s]")
    quantisation: NotNegative = Field(default=0.0, description="step of the force reading [N]; 0: none")
    torque_quantisation: NotNegative = Field(default=0.0, description="step of the torque reading [N m]; 0: none")
    range: Positive | None = Field(default=None, description="each force axis clips here [N]; null: none")
    torque_range: Positive | None = Field(default=None, description="each torque axis clips here [N m]; null: none")
