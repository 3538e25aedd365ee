"""A force sensor with delay, drift and noise in a MuJoCo model of your own.

MuJoCo's force and torque sensors are ideal. Two user sensors beside them, `needstage="acc"`, show
what a real one would read: MuJoCo calls `measure` in every step, after the forces are known.

    python examples/sensor/in_mujoco.py
"""

from __future__ import annotations

import mujoco
import numpy as np

from hiltestbed.sensor import ForceSensor

MODEL = """
<mujoco>
  <option timestep="0.0005" gravity="0 0 0"/>
  <worldbody>
    <body name="plate">
      <site name="mount"/>
      <geom type="box" size="0.1 0.1 0.01" mass="1" solref="-1e5 -200"/>
    </body>
    <body pos="0 0 0.0601"><freejoint/><geom type="sphere" size="0.05" mass="2"/></body>
  </worldbody>
  <sensor>
    <force name="force" site="mount"/>
    <torque name="torque" site="mount"/>
    <user name="measured" dim="6" needstage="acc"/>
  </sensor>
</mujoco>
"""


class Measured:
    """The callback: MuJoCo's force and torque through a sensor, into its user sensor."""

    def __init__(self, sensor: ForceSensor) -> None:
        self.sensor, self.time = sensor, -1.0

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData, stage: int) -> None:
        if stage != mujoco.mjtStage.mjSTAGE_ACC or data.time == self.time:
            return  # RK4 and mj_forward call several times an instant
        self.time = data.time
        wrench = np.concatenate([data.sensor("force").data, data.sensor("torque").data])
        data.sensor("measured").data[:] = self.sensor(wrench)


def bounce(sensor: ForceSensor, duration: float = 0.1) -> np.ndarray:
    """(steps, 2) true and measured force along z of a ball at 0.1 m/s."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qvel[2] = -0.1
    mujoco.set_mjcb_sensor(Measured(sensor))
    try:
        rows = []
        while data.time < duration:
            mujoco.mj_step(model, data)
            rows.append((data.sensor("force").data[2], data.sensor("measured").data[2]))
    finally:
        mujoco.set_mjcb_sensor(None)
    return np.array(rows)


if __name__ == "__main__":
    late = ForceSensor(2000.0, {"delay": 0.005, "noise": 0.1, "drift": [0.0, 0.0, 2.0]}, seed=1)
    rows = bounce(late)
    true, measured = (np.argmax(np.abs(rows[:, j])) for j in range(2))
    print(
        f"peak {rows[true, 0]:.2f} N at step {true}, read {rows[measured, 1]:.2f} N at {measured}"
    )
