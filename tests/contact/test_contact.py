"""The contact is a spring and a damper in N/m and N s/m, or the law that effects put in its
place.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import scenario_from
from tests.platform.rigs import K, Press, fitted, pose, scenario


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.1, 0.05), (0.3, 0.0), (0.0, -0.3)])
@pytest.mark.parametrize(
    ("tracking", "k_within", "c_within"), [("ideal", 1e-9, 1e-9), ("servo", 1e-6, 1e-5)]
)
def test_the_plants_own_force_and_pose_give_stiffness_and_damping(
    tracking: str, k_within: float, c_within: float, place: tuple[float, float]
) -> None:
    s = scenario(tracking, damping=300.0)
    depth, rate, wrench = Press(plant_of([s]), s.rate, *place).run(800).columns()
    k, c = fitted(depth, rate, wrench[:, 2])
    assert k == pytest.approx(K, rel=k_within)
    assert c == pytest.approx(300.0, rel=c_within)


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_the_contact_never_pulls(tracking: str) -> None:
    """While the tip leaves k x + c v would pull: the force is 0, not negative."""
    s = scenario(tracking, stiffness=1e4, damping=2000.0)
    _, _, wrench = Press(plant_of([s]), s.rate).run(800).columns()
    assert wrench[:, 2].max() > 10.0
    assert wrench[:, 2].min() > -1e-6


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
@pytest.mark.parametrize("place", [0.0, 0.2])
def test_a_law_in_place_of_the_linear_contact_acts_as_written(tracking: str, place: float) -> None:
    """Two effects make F = 3e6 x^1.5 (1 + 2 v); under a servo within 1e-6 of the peak."""
    power = {"kind": "contact.power_law", "exponent": 1.5, "stiffness": 3.0e6}
    rise = {"kind": "contact.hunt_crossley", "alpha": 2.0}
    s = scenario_from(scenario(tracking).model_dump(mode="json") | {"effects": [power, rise]})
    depth, rate, wrench = Press(plant_of([s]), s.rate, place).run(800).columns()
    expected = 3.0e6 * np.maximum(depth, 0.0) ** 1.5 * (1.0 + 2.0 * rate)
    assert expected.max() > 100.0
    close = 1e-9 if tracking == "ideal" else 1e-6 * expected.max()
    np.testing.assert_allclose(wrench[:, 2], expected, rtol=1e-9, atol=close)


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_each_run_of_a_batch_has_its_own_contact(tracking: str) -> None:
    stiffness = [1e4, 1e5, 1e6]
    scenarios = [scenario(tracking, stiffness=k, damping=0.0) for k in stiffness]
    plant, still = plant_of(scenarios), np.zeros((3, 6))
    plant.reset(pose(z=1e-3, n=3), still)
    for _ in range(600):
        plant.advance(pose(z=1e-3, n=3), still, still)
    np.testing.assert_allclose(
        plant.wrench_sub[:, -1, 2] / plant.pose_act[:, 2], stiffness, rtol=1e-6
    )
