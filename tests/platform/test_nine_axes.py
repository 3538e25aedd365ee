"""Both platforms together: one relative pose, a sensor that forgets its payload, and docking as if
there were no upper platform.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.build import runnable_from
from hiltestbed.compiled.state import arrays_of
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.platform.build import plant_of
from hiltestbed.platform.facilities.motion import GRAVITY
from hiltestbed.platform.facilities.prs3 import BLEND, DOCKING
from hiltestbed.platform.nine_axes import NineAxes
from hiltestbed.platform.plant import Plant
from hiltestbed.scenario import Scenario
from tests.platform.rigs import scenario
from tests.running import run


def nine_axes(tracking: str = "servo", upper: str = "servo", **keys: Any) -> Scenario:
    data = scenario(tracking).model_dump(mode="json")
    data["rig"]["upper"] = {"kind": "prs3", "tracking": upper}
    for key, value in keys.items():
        data[key] = data[key] | value if isinstance(value, dict) else value
    return runnable_from(data)


def relative(t: Array, middle: float = 1.0) -> tuple[Array, Array, Array]:
    """A relative motion that shakes the upper platform: poses (t, 7), twists (t, 6) of the ticks,
    accelerations (t, 6).

    Heave 0.2 m at 0.35 Hz, 0.97 m/s^2; tilts of 1.5 deg at 0.5 Hz, 0.26 rad/s^2.
    """
    h = t[1] - t[0]
    gap = middle + 0.2 * np.sin(2.2 * t)
    tilt = np.radians(1.5) * np.column_stack(
        [np.sin(np.pi * t), np.cos(np.pi * t), np.zeros_like(t)]
    )
    turn = Rotation.from_rotvec(tilt)
    pose = np.column_stack([0.02 * np.sin(t), 0.0 * t, -gap, turn.as_quat()])
    twist = np.zeros((len(t), 6))
    twist[1:, :3] = np.diff(pose[:, :3], axis=0) / h
    twist[1:, 3:] = (turn[1:] * turn[:-1].inv()).as_rotvec() / h
    accel = np.zeros((len(t), 6))
    accel[2:] = np.diff(twist[1:], axis=0) / h
    twist[0] = 2.0 * twist[1] - twist[2]
    return pose, twist, accel


def shaken(plant: Plant, seconds: float = 1.5, middle: float = 1.0) -> dict[str, Array]:
    """What a plant gives on that motion: the reached pose less the one commanded, and the wrench at
    every instant.
    """
    t = np.arange(0.0, seconds, 1.0 / 2000.0)
    pose, twist, accel = relative(t, middle)
    n = len(plant.pose_act)
    plant.reset(np.repeat(pose[:1], n, axis=0), np.repeat(twist[:1], n, axis=0))
    out: dict[str, list[Array]] = {"error": [], "wrench": [], "pose_W": []}
    for k in range(1, len(t)):
        plant.advance(*(np.repeat(a[k : k + 1], n, axis=0) for a in (pose, twist, accel)))
        out["error"].append(plant.pose_act[0] - pose[k])
        out["wrench"].append(plant.wrench_sub[0].copy())
        out["pose_W"].append(plant.pose_W[0].copy())
    return {name: np.array(rows) for name, rows in out.items()}


def test_both_platforms_follow_and_the_sensor_loses_weight_and_inertia_of_its_payload() -> None:
    """120 kg shaken by 1 m/s^2 and 0.3 rad/s^2 (inertia 116 N, and 31 N across by the tilt): less
    than 0.05 % of the weight is left.
    """
    plant = plant_of([nine_axes()])
    result = shaken(plant)
    assert_follows(result, 1e-5)
    wrench = result["wrench"].reshape(-1, 6)
    tracking = plant._tracking
    assert isinstance(tracking, NineAxes)
    weight = tracking.upper.drives.payload[0] * GRAVITY
    assert weight == pytest.approx(120.0 * GRAVITY)
    assert np.linalg.norm(wrench[:, :3], axis=1).max() < 5e-4 * weight
    # over the lever of its centre of mass
    assert np.linalg.norm(wrench[:, 3:], axis=1).max() < 5e-4 * weight * 0.30
    heavier = tracking.upper.drives.payload
    # believed 1 % heavier than it is: 1 % of weight and inertia is left, and nothing hides it
    heavier[0] *= 1.01
    left = np.linalg.norm(shaken(plant, 0.2)["wrench"].reshape(-1, 6)[:, :3], axis=1)
    assert left.max() == pytest.approx(0.01 * weight, rel=0.15)


def test_both_platforms_without_drives_realise_the_relative_pose() -> None:
    assert_follows(shaken(plant_of([nine_axes("ideal", "ideal")])), 1e-12)


def assert_follows(result: dict[str, Array], most: float) -> None:
    """Both platforms together are within ``most`` of the relative pose, and the lower one alone
    stays near its centre.
    """
    assert np.abs(result["error"]).max() < most
    assert np.abs(result["pose_W"][:, :3]).max() < 0.25  # while the ports are 0.8 to 1.2 m apart


def test_coming_home_and_leaving_again_leaves_no_step() -> None:
    """The gap swings from 0.05 m, where the upper platform is clamped, to 0.45 m: the reached pose
    has no jump beyond 2 um.
    """
    result = shaken(plant_of([nine_axes()]), 3.5, middle=0.25)
    assert np.abs(result["error"]).max() < 1e-5
    assert np.abs(np.diff(result["error"], axis=0)).max() < 2e-6
    force = np.linalg.norm(result["wrench"].reshape(-1, 6)[:, :3], axis=1)
    assert force.max() < 5e-4 * 120.0 * GRAVITY


def test_docking_is_what_it_is_without_an_upper_platform_bit_for_bit() -> None:
    approach = {"gap": 0.01, "velocity": [0.003, 0.0, 0.03], "attitude_deg": [2.0, -1.0, 3.0]}
    scene = nine_axes("ideal", approach=approach, duration=0.5)
    data = scene.model_dump(mode="json")
    data["rig"]["upper"] = {"kind": "fixed"}
    with_upper, without = run(scene).trace, run(runnable_from(data)).trace
    assert without.contact.any()
    for name in ("pose_act", "twist_act", "wrench_true", "pose_cmd", "slider_act"):
        assert np.array_equal(with_upper[name], without[name])


def test_the_state_between_two_ticks_is_all_of_it() -> None:
    first, second = plant_of([nine_axes()]), plant_of([nine_axes()])
    shaken(first, 0.3)
    shaken(second, 0.1)
    for name, array in arrays_of(second).items():
        array[...] = arrays_of(first)[name]
    pose, twist, accel = relative(np.arange(0.2, 0.5, 1.0 / 2000.0))
    for k in range(200, 260):
        for plant in (first, second):
            plant.advance(pose[k : k + 1], twist[k : k + 1], accel[k : k + 1])
        assert np.array_equal(first.pose_act, second.pose_act)
        assert np.array_equal(first.wrench_sub, second.wrench_sub)


def test_the_upper_platform_is_clamped_when_the_ports_touch() -> None:
    """From 0.4 m at 0.3 m/s: what the sensor reads in contact is the contact's, k x + c v of the
    pose reached.
    """
    s = nine_axes(approach={"gap": 0.4, "velocity": [0.0, 0.0, 0.3]}, duration=1.6)
    trace = run(s).trace
    touch = trace.contact & (trace["pose_act"][:, 2] > 1e-4)
    contact, depth, rate = s.mechanism.contact, trace["pose_act"][touch, 2], trace["twist_act"]
    law = np.maximum(contact.stiffness * depth + contact.damping * rate[touch, 2], 0.0)
    np.testing.assert_allclose(trace["wrench_true"][touch, 2], law, atol=0.5, rtol=1e-3)


def test_an_effect_of_the_lower_platform_is_seen_where_the_lower_platform_moves() -> None:
    """10 ms of transport delay at 0.2 m/s are 2 mm behind on the last stretch, and nothing while
    the upper platform alone moves.
    """
    approach = {"gap": 0.6, "velocity": [0.0, 0.0, 0.2]}
    late = [{"kind": "platform.delay", "delay": 0.01}]
    s = nine_axes("ideal", "ideal", approach=approach, duration=2.9, effects=late)
    trace = run(s).trace
    behind = trace["pose_cmd"][:-1, 2] - trace["pose_act"][1:, 2]
    gap = -trace["pose_act"][1:, 2]
    np.testing.assert_allclose(behind[gap > DOCKING + BLEND], 0.0, atol=1e-12)
    last = (gap < DOCKING - 0.005) & (gap > 0.05)
    np.testing.assert_allclose(behind[last], 0.2 * 0.01, atol=1e-9)


@pytest.mark.parametrize(
    ("approach", "message"),
    [
        ({"gap": 2.3}, "0 to 2.19 m"),
        ({"gap": 1.0, "velocity": [0.0, 0.0, 0.6]}, "to come to rest before the touch"),
        (
            {"gap": 2.0, "attitude_deg": [4.0, 4.0, 0.0], "offset": [0.2, 0.2]},
            "outside the workspace",
        ),
    ],
)
def test_a_start_that_the_nine_axes_cannot_hold_is_refused(
    approach: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        nine_axes(approach=approach)


def test_without_the_upper_platform_two_metres_are_refused_and_with_it_they_are_not() -> None:
    data = nine_axes(approach={"gap": 2.0}).model_dump(mode="json")
    data["rig"]["upper"]["kind"] = "fixed"
    with pytest.raises(InputError, match="outside the workspace"):
        runnable_from(data)
