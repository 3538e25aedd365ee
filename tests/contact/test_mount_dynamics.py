"""The step of a compliant mount, against MuJoCo's step of the same joints and body."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.contact.mount import mount_place
from hiltestbed.contact.mount_dynamics import carried, mount_step

STEP = 1.0e-4
STIFFNESS = np.array([2.0e5, 3.0e5, 1.0e5, 2.0e4, 1.0e4, 3.0e4])
DAMPING = np.array([200.0, 100.0, 300.0, 20.0, 10.0, 30.0])
MODEL = f"""
<mujoco>
  <option timestep="{STEP}" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="mounted">
      {"".join(f'<joint type="slide" axis="{a}" stiffness="{k}" damping="{c}"/>' for a, k, c in zip(("1 0 0", "0 1 0", "0 0 1"), STIFFNESS[:3], DAMPING[:3], strict=True))}
      {"".join(f'<joint type="hinge" axis="{a}" stiffness="{k}" damping="{c}"/>' for a, k, c in zip(("1 0 0", "0 1 0", "0 0 1"), STIFFNESS[3:], DAMPING[3:], strict=True))}
      <inertial pos="0.03 -0.05 0.2" mass="80" fullinertia="5 6 3 0.2 -0.1 0.3"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("angle", [1e-3, 0.09, 0.3])
def test_a_step_is_that_of_mujoco_at_small_and_large_angles(angle: float) -> None:
    """From deflections of all joints; beyond 0.1 rad sine and cosine are computed otherwise."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    q = np.array([1e-3, -2e-3, 1e-3, angle, -0.8 * angle, 0.5 * angle])
    qd = np.zeros(6)
    body = carried(model)
    data.qpos[:] = q
    for _ in range(2000):
        mujoco.mj_step(model, data)
        mount_step(STIFFNESS, DAMPING, body, STEP, STEP, False, np.zeros(6), q, qd)
    np.testing.assert_allclose(q, data.qpos, atol=1e-9 * angle)
    np.testing.assert_allclose(qd, data.qvel, atol=1e-7 * angle)


@pytest.mark.parametrize("size", [1e-6, 0.05, 1.0])
def test_the_mounts_place_is_the_product_of_its_hinges(size: float) -> None:
    """Attitude and angular velocity, against SciPy's rotations about x, y', z'', with a tilt."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = size * rng.normal(size=6)
        qd = rng.normal(size=6)
        tilt = Rotation.from_rotvec(size * rng.normal(size=3))
        place, motion = np.empty(7), np.empty(6)
        mount_place(q, qd, np.concatenate([np.zeros(3), tilt.as_quat()]), place, motion)
        x, y, z = (
            Rotation.from_rotvec(angle * axis) for angle, axis in zip(q[3:], np.eye(3), strict=True)
        )
        assert ((x * y * z * tilt).inv() * Rotation.from_quat(place[3:])).magnitude() < 1e-14
        turning = (
            qd[3] * np.eye(3)[0]
            + qd[4] * x.apply(np.eye(3)[1])
            + qd[5] * (x * y).apply(np.eye(3)[2])
        )
        np.testing.assert_allclose(motion, np.concatenate([qd[:3], turning]), atol=1e-14)
        np.testing.assert_array_equal(place[:3], q[:3])
