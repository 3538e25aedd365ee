"""After capture: six axes of the latched place, against the Jacobian of the wrench in MuJoCo and
against a law written down here.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed import load_scenario
from hiltestbed.contact.sides import sides_of
from hiltestbed.identification.methods.rls import Rls
from hiltestbed.loop import Loop
from hiltestbed.platform.plant import Plant
from tests.contact.test_jacobian import measured
from tests.slow import SLOW, slow

QUIET = {"sensor.noise": 0.0, "sensor.torque_noise": 0.0}


def ended(name: str, **changes: object) -> Loop:
    """The loop of a shipped scenario without noise, at its end."""
    loop = Loop([load_scenario(name, set=QUIET | changes)])
    while loop.k < loop.scenarios[0].ticks:
        loop.step()
    return loop


def test_a_latch_is_found_on_six_axes_as_its_jacobian_has_it() -> None:
    """Through servo and delay, off the axis and askew; the Jacobian is that of the same latch under
    ideal tracking.

    Across the axes it has half the angle by which the latch is turned, under half a degree here:
    turns do not add up like shifts.
    """
    found = ended("10-glancing")
    ideal = ended(
        "10-glancing", **{"rig.platform.tracking": "ideal", "duration": 4.0, "sensor.delay": 0.0}
    )
    assert found.plant.captured[0]
    assert ideal.plant.captured[0]
    plant = cast("Plant", ideal.plant)
    steps = measured(plant, plant.pose_act[0].copy(), np.zeros(3), 1)
    estimates = (found.identification.stiffness, found.identification.damping)
    for estimate, true in zip(estimates, steps, strict=True):
        np.testing.assert_allclose(estimate[0], np.diag(true), rtol=1e-3)
        scale = np.sqrt(np.outer(np.diag(true), np.diag(true)))
        assert np.abs((true - np.diag(np.diag(true))) / scale).max() < 0.5 * np.radians(0.5)


def swing(t: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Six motions ``(N, 6)`` of the ``size`` (6,) at frequencies of their own, with their rates."""
    w = 2.0 * np.pi * np.array([1.1, 1.7, 2.3, 2.9, 3.7, 4.3])
    return size * np.sin(np.outer(t, w)), size * w * np.cos(np.outer(t, w))


@pytest.mark.parametrize(
    "scenario", [slow("15-ring-docking"), "16-probe-drogue", slow("17-gripper")]
)
def test_the_lever_of_a_latch_is_taken_out(scenario: str) -> None:
    """Each hard capture as a law: K (r - r_hold) + C r' at the site, K radius^2 against turning."""
    loaded = load_scenario(scenario, set=QUIET)
    phases = loaded.mechanism.phases()
    close = phases[-1].close
    lever = sides_of(loaded.mechanism).sites["A", close.active][1][:3]
    delay = round(loaded.sensor.delay * loaded.rate)
    t = np.arange(2000) / loaded.rate
    motion, rate = swing(t, np.array([1e-3] * 3 + [2e-3] * 3))
    attitude = Rotation.from_euler("xyz", [0.5, -0.3, 4.0], degrees=True)
    turned = Rotation.from_rotvec(motion[:, 3:]) * attitude
    place = np.array([0.004, -0.003, 0.01]) + attitude.apply(lever) + motion[:, :3]
    held = place[0] - np.array([1e-4, 2e-4, -1e-4])
    spin = np.stack([body_rate(motion[k, 3:], rate[k, 3:]) for k in range(len(t))])
    arm = turned.apply(lever)
    pose = np.column_stack([place - arm, turned.as_quat()])
    twist = np.column_stack([rate[:, :3] - np.cross(spin, arm), spin])
    force = close.stiffness * (place - held) + close.damping * rate[:, :3]
    torque = close.radius**2 * (close.stiffness * motion[:, 3:] + close.damping * spin) + np.cross(
        place, force
    )
    wrench = np.column_stack([force, torque])
    estimate = Rls.start([loaded])
    estimate.source.captured[:], estimate.source.steps[:] = True, len(phases)
    for k in range(len(t)):
        estimate.update(wrench[max(k - delay, 0)][None], pose[k][None], twist[k][None])
    factor = np.array([1.0] * 3 + [close.radius**2] * 3)
    np.testing.assert_allclose(estimate.stiffness[0], close.stiffness * factor, rtol=1e-3)
    np.testing.assert_allclose(estimate.damping[0], close.damping * factor, rtol=1e-3)


def body_rate(vector: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Angular velocity (3,) in the frame of a rotation vector (3,), to second order in it."""
    return rate + 0.5 * np.cross(vector, rate)


@SLOW
def test_what_rubs_or_stands_still_is_not_told() -> None:
    """The gripper's jaws share every load, and nothing moves after the clamping."""
    loop = ended("17-gripper", duration=9.0)
    assert loop.plant.phases.begun[0] == 3
    estimate = loop.identification.stiffness[0]
    assert np.isnan(estimate).all()
