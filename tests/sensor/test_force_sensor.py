"""The sensor's sign, by a weight that is known, and the tare that leaves the contact alone."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hiltestbed.contact.composition import structure_of
from hiltestbed.platform.build import facility_of, plant_of
from hiltestbed.platform.facilities.composed import facility_spec
from tests.platform.rigs import pose, scenario

GRAVITY = 9.81


def sensor_reading(added: float, x: float) -> np.ndarray:
    """Readings (6,) with ``added`` [kg] hung on the passive side at ``x`` [m] from the axis."""
    s = scenario()
    spec = facility_spec(facility_of(s), structure_of(s.mechanism, s.effects), timestep=1e-3)
    weight = spec.body("passive_mechanism").add_body(name="weight", pos=[x, 0.0, 0.1])
    weight.explicitinertial = True
    weight.mass = max(added, 1e-9)
    weight.ipos = [0.0, 0.0, 0.0]
    weight.inertia = np.full(3, 1e-9)
    m = spec.compile()
    data = mujoco.MjData(m)
    data.joint("platform").qpos[2] -= 0.5
    mujoco.mj_forward(m, data)
    return np.array(data.sensordata)


def test_a_known_weight_reads_as_what_the_parent_carries() -> None:
    """MuJoCo reads what the frame exerts: +98.1 N along z, and r x F, about y -0.2 m 98.1 N."""
    added = sensor_reading(10.0, 0.2) - sensor_reading(0.0, 0.2)
    np.testing.assert_allclose(
        added, [0.0, 0.0, 10.0 * GRAVITY, 0.0, -0.2 * 10.0 * GRAVITY, 0.0], atol=1e-6
    )


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_pushing_in_reads_positive_and_the_tare_leaves_nothing_without_contact(
    tracking: str,
) -> None:
    s = scenario(tracking)
    plant, still = plant_of([s]), np.zeros((1, 6))
    plant.reset(pose(z=-0.01), still)
    plant.advance(pose(z=-0.01), still, still)
    np.testing.assert_allclose(plant.wrench_sub, 0.0, atol=1e-9)
    assert not plant.contact[0]
    x, depth = 0.2, 1e-3
    plant.reset(pose(x, 0.0, depth), still)
    for _ in range(400):
        plant.advance(pose(x, 0.0, depth), still, still)
    assert plant.contact[0]
    force = plant.wrench_sub[0, -1]
    assert force[2] == pytest.approx(s.mechanism.contact.stiffness * depth, rel=1e-2)
    # A push +F along z at x: torque r x F about P's origin is -x F about y
    np.testing.assert_allclose(force[3:], [0.0, -x * force[2], 0.0], atol=2e-3 * force[2])
