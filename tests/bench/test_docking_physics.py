"""The second rig with six axes: momentum, energy, friction, latch and mount against closed
forms.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.equipment.independent_rig import Records, docking_rig, overridden, silence, simulate
from tests.equipment.independent_rig import bodies as model
from tests.equipment.independent_rig.cone import Surfaces
from tests.equipment.independent_rig.contact import Contact
from tests.equipment.independent_rig.docking import touch_wrench
from tests.equipment.independent_rig.generation import with_effect
from tests.equipment.independent_rig.mount import RIGID, carried, mount_of
from tests.equipment.independent_rig.rotation import matrix

SCENARIO: dict[str, Any] = {
    "rate": 2000,
    "duration": 1.0,
    "spacecraft": {
        "chaser": {
            "mass": 500.0,
            "inertia": [200.0, 180.0, 150.0],
            "port": {"position": [0, 0, 1.0], "attitude_deg": [0, 0, 0]},
        },
        "target": {
            "mass": 2000.0,
            "inertia": [900.0, 800.0, 700.0],
            "port": {"position": [0, 0, -1.0], "attitude_deg": [0, 0, 0]},
        },
    },
    "approach": {
        "gap": 0.05,
        "velocity": [0.0, 0.0, 0.06],
        "offset": [0.03, -0.02],
        "attitude_deg": [1, -1, 2],
        "rate_deg": [0.2, 0.1, 1],
    },
    "mechanism": {
        "kind": "probe_cone",
        "contact": {"stiffness": 5e4, "damping": 800.0, "friction": 0.1},
    },
    "rig": {"platform": {"kind": "pss33", "tracking": "ideal"}},
    "sensor": {"delay": 0.0, "noise": 0.0},
    "compensation": {"force": {"kind": "none"}},
}


def _run(changes: dict | None = None) -> tuple[Any, Records]:
    rig = docking_rig(overridden(SCENARIO, changes or {}))
    return rig, simulate(rig, silence(rig.ticks))


def _states(rig: Any, wrench: np.ndarray) -> np.ndarray:
    """(ticks + 1, 2, 19) of both bodies under the wrenches of a run."""
    state, _ = model.start(rig.bodies, rig.approach)
    origin = state[0, model.R].copy()
    out = [state.copy()]
    for k, w in enumerate(wrench):
        model.step(rig.bodies, state, w, 1.0 / rig.rate, k / rig.rate, origin)
        out.append(state.copy())
    return np.array(out)


def _angular(rig: Any, states: np.ndarray) -> np.ndarray:
    """(n, 3) angular momentum of both bodies about the origin."""
    return np.array(
        [
            sum(
                rig.bodies.mass[b] * np.cross(s[b, model.R], s[b, model.V])
                + matrix(s[b, model.Q]) @ rig.bodies.inertia[b] @ s[b, model.W]
                for b in range(2)
            )
            for s in states
        ]
    )


def test_linear_momentum_is_kept() -> None:
    rig, records = _run()
    assert records.touching.any()
    states = _states(rig, records.wrench_comp)
    total = np.einsum("b,kbi->ki", rig.bodies.mass, states[:, :, model.V])
    np.testing.assert_allclose(
        total, total[:1].repeat(len(total), axis=0), atol=1e-9 * 500.0 * 0.06
    )


def test_angular_momentum_of_round_bodies_is_kept_and_of_others_to_first_order() -> None:
    """Semi-implicit Euler keeps the moment of momentum of the centres; its gyroscopic part is of
    first order in the tick.
    """
    round_ones = {
        "spacecraft.chaser.inertia": [180.0] * 3,
        "spacecraft.target.inertia": [800.0] * 3,
    }
    rig, records = _run(round_ones)
    total = _angular(rig, _states(rig, records.wrench_comp))
    assert np.abs(total - total[0]).max() < 1e-9 * np.abs(total[0]).max()
    lost = []
    for rate in (1000, 2000, 4000):
        rig, records = _run({"rate": rate, "approach.rate_deg": [3.0, 4.0, 5.0]})
        total = _angular(rig, _states(rig, records.wrench_comp))
        lost.append(np.abs(total - total[0]).max())
    assert lost[0] / lost[1] == pytest.approx(2.0, rel=0.1)
    assert lost[1] / lost[2] == pytest.approx(2.0, rel=0.1)


def test_the_force_changes_the_momentum_by_its_impulse() -> None:
    """Of the relative motion at the ports, as logged: the target is so heavy that P stays where it
    is.
    """
    heavy = {
        "spacecraft.target.mass": 1e9,
        "spacecraft.target.inertia": [1e9] * 3,
        "spacecraft.chaser.inertia": [1e9] * 3,
    }
    heavy |= {"approach.rate_deg": [0.0, 0.0, 0.0]}
    _, records = _run(heavy)
    velocity = np.diff(records.pose_cmd[:, :3], axis=0) * 2000
    impulse = np.cumsum(records.wrench_comp[:, :3], axis=0) / 2000
    # of 1e9 kg that do move
    np.testing.assert_allclose(
        500.0 * (velocity[-1] - velocity[0]), -(impulse[-1] - impulse[0]), rtol=5e-6
    )


def test_without_damping_and_friction_a_docking_keeps_its_energy_to_first_order() -> None:
    """Kinetic energy of both bodies and k x^2/2 of the tip in the cone."""
    lost = []
    for rate in (2000, 4000, 8000):
        quiet = {"mechanism.contact.damping": 0.0, "mechanism.contact.friction": 0.0, "rate": rate}
        rig, records = _run(quiet)
        states = _states(rig, records.wrench_comp)
        kinetic = np.array(
            [
                sum(
                    0.5 * rig.bodies.mass[b] * s[b, model.V] @ s[b, model.V]
                    + 0.5 * s[b, model.W] @ rig.bodies.inertia[b] @ s[b, model.W]
                    for b in range(2)
                )
                for s in states
            ]
        )
        force = np.linalg.norm(records.physical[:, :3], axis=1)
        free = np.append(force == 0.0, False)[:-1]
        assert (~free).sum() > 0.05 * rate
        stored = 0.5 * force**2 / 5e4
        total = kinetic[:-1] + stored
        lost.append(np.abs(total[-1] - total[0]) / total[0])
        assert np.abs(total - total[0]).max() < 0.02 * total[0]
    assert lost[-1] < 1e-3
    assert lost[-1] < 0.6 * lost[0]


def test_a_centred_approach_rebounds_as_the_closed_form_of_one_axis_says() -> None:
    straight = {
        "approach.offset": [0.0, 0.0],
        "approach.attitude_deg": [0, 0, 0],
        "approach.rate_deg": [0, 0, 0],
        "approach.gap": 0.00151,
        "rate": 8000,
        "duration": 0.5,
        "mechanism.contact.damping": 400.0,
    }
    for kind in ("probe_cone", "bumper"):
        _, records = _run(straight | {"mechanism.kind": kind})
        rebound = -(records.pose_cmd[-1, 2] - records.pose_cmd[-2, 2]) * 8000 / 0.06
        z = 400.0 / (2.0 * math.sqrt(5e4 * 400.0))
        s = math.sqrt(1.0 - z * z)
        expected = math.exp(-(z / s) * (math.pi - math.atan2(2.0 * z * s, 1.0 - 2.0 * z * z)))
        assert rebound == pytest.approx(expected, abs=2e-4 + 400.0 / 400.0 / 8000)


def _law(**changes: float) -> Contact:
    return Contact(np.array([0.0, 0.0, 1.0]), 5e4, 0.0, 0.2, False)._replace(**changes)


def test_friction_is_the_coefficient_times_the_normal_force_against_the_slip() -> None:
    out, seen, states = np.zeros(6), np.zeros((2, 2)), np.zeros((2, 5))
    # in touch with the wall at 45 degrees, on +x
    pose = np.array([0.06, 0.0, -0.055, 0.0, 0.0, 0.0, 1.0])
    into, down = (
        np.array([1.0, 0.0, 1.0]) / math.sqrt(2.0),
        np.array([1.0, 0.0, -1.0]) / math.sqrt(2.0),
    )
    for speed in (1e-6, 1e-4, 1e-2, 0.1):
        twist = np.array([*(speed * (0.6 * down + 0.8 * np.array([0.0, 1.0, 0.0]))), 0.0, 0.0, 0.0])
        touch_wrench(_law(), Surfaces(), pose, twist, states, out, seen)
        normal = out[:3] @ into
        assert normal == pytest.approx(5e4 * seen[0, 0], rel=1e-12)
        expected = 0.2 * normal * speed / math.hypot(speed, 1e-4)
        assert out[:3] @ down == pytest.approx(0.6 * expected, rel=1e-9)
        assert out[1] == pytest.approx(0.8 * expected, rel=1e-9)


def test_the_lever_of_the_force_is_between_the_surface_and_the_tip() -> None:
    pose, twist = (
        np.array([0.06, 0.0, -0.055, 0.0, 0.0, 0.0, 1.0]),
        np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0]),
    )
    torque = []
    for lever in (0.0, 0.5, 1.0):
        out, seen = np.zeros(6), np.zeros((2, 2))
        touch_wrench(_law(lever=lever), Surfaces(), pose, twist, np.zeros((2, 5)), out, seen)
        into = np.array([1.0, 0.0, 1.0]) / math.sqrt(2.0)
        deepest = pose[:3] - 0.03 * np.array([0.0, 0.0, 1.0]) + 0.03 * into
        np.testing.assert_allclose(
            out[3:], np.cross(deepest - (1.0 - lever) * seen[0, 0] * into, out[:3]), atol=1e-9
        )
        # of the friction: the normal force has the same moment anywhere along its line
        torque.append(out[5])
    assert abs(torque[0] - torque[2]) > 0.01 * abs(torque[1])


@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_a_latch_closes_on_its_condition_and_bears_what_the_contact_bore(factor: float) -> None:
    """Also where the contact is stiffer than believed: then so is what holds."""
    latch = {
        "mechanism.latch": {"depth": 0.004, "angle_deg": 5.0, "speed": 0.03},
        "duration": 4.0,
        "mechanism.contact.damping": 3000.0,
    }
    rig = with_effect(
        docking_rig(overridden(SCENARIO, latch)), {"kind": "contact.stiffness", "factor": factor}
    )
    records = simulate(rig, silence(rig.ticks))
    closed = records.captured
    assert 0 < closed < rig.ticks
    assert records.touching[closed:].all()
    h = 1.0 / rig.rate
    speed = np.linalg.norm(np.diff(records.pose_act[:, :3], axis=0), axis=1) / h
    due = (records.pose_act[1:, 2] >= -0.004) & (speed <= 0.03)
    assert np.flatnonzero(due)[0] + 1 == closed
    elastic = records.physical[closed, :3] - records.physical[closed + 1, :3]
    jump = (
        factor * 5e4 * np.linalg.norm(np.diff(records.pose_act[closed : closed + 2, :3], axis=0))
        + 3000.0 * speed[closed]
    )
    assert np.linalg.norm(elastic) < jump + 1e-9
    # It pulls as well: the ring-down has both signs.
    after = records.physical[closed:, :3] - records.physical[-1, :3]
    assert after.min() < 0.0 < after.max()


def test_a_latch_from_the_start_is_six_springs_and_dampers() -> None:
    start = {
        "approach.gap": -0.001,
        "approach.offset": [0.002, -0.001],
        "approach.velocity": [0.0, 0.01, 0.0],
        "mechanism.kind": "latched",
    }
    _, records = _run(
        start | {"approach.attitude_deg": [0.2, 0.0, 0.0], "approach.rate_deg": [0.0, 0.0, 0.5]}
    )
    force = 5e4 * np.array([0.002, -0.001, 0.001]) + 800.0 * np.array([0.0, 0.01, 0.0])
    np.testing.assert_allclose(records.physical[0, :3], force, rtol=1e-12)
    turn = 0.15**2 * (
        5e4 * np.array([math.radians(0.2), 0.0, 0.0])
        + 800.0 * np.array([0.0, 0.0, math.radians(0.5)])
    )
    np.testing.assert_allclose(
        records.physical[0, 3:], turn + np.cross([0.002, -0.001, 0.001], force), rtol=1e-9
    )


MOUNT = {"stiffness": [4e5, 4e5, 9e5, 4e4, 4e4, 2e4], "damping": [0.0] * 6}


def test_a_mounted_body_swings_at_the_frequency_of_mass_and_spring() -> None:
    from tests.equipment.independent_rig.mount import derivative, moved

    mount = mount_of(MOUNT["stiffness"], MOUNT["damping"])
    y = RIGID.copy()
    y[2] = 1e-3  # along z nothing is coupled
    h, heights = 1e-4, []
    for _ in range(20_000):
        a, half, b = np.zeros(6), np.zeros(13), np.zeros(6)
        derivative(mount, y, np.zeros(6), a)
        moved(y, y[7:], a, 0.5 * h, half)
        derivative(mount, half, np.zeros(6), b)
        out = np.zeros(13)
        moved(y, half[7:], b, h, out)
        y = out
        heights.append(y[2])
    up = np.flatnonzero((np.array(heights[:-1]) < 0.0) & (np.array(heights[1:]) >= 0.0))
    period = (up[-1] - up[0]) / (len(up) - 1) * h
    assert 2.0 * math.pi / period == pytest.approx(math.sqrt(9e5 / 120.0), rel=1e-3)
    assert np.abs(heights[-2000:]).max() == pytest.approx(1e-3, rel=1e-3)


def test_what_the_sensor_feels_is_the_contact_less_what_moves_the_mounted_body() -> None:
    """Nothing before the body has moved; the whole force of latch and mount in series when it has
    come to rest.
    """
    damped = {
        "stiffness": MOUNT["stiffness"],
        "damping": [900.0, 900.0, 1300.0, 100.0, 100.0, 50.0],
    }
    _, mounted = _run(
        {
            "mechanism.mount": damped,
            "mechanism.kind": "latched",
            "approach.gap": 0.0,
            "approach.velocity": [0, 0, 0.0],
            "approach.offset": [1e-3, 0.0],
            "approach.attitude_deg": [0, 0, 0],
            "approach.rate_deg": [0, 0, 0],
            "spacecraft.chaser.mass": 1e9,
            "spacecraft.chaser.inertia": [1e9] * 3,
            "spacecraft.target.mass": 1e9,
            "spacecraft.target.inertia": [1e9] * 3,
            "duration": 6.0,
        }
    )
    springs = np.array([[4e5, 0.0], [0.0, 4e4]])  # x and the turn about y of the mount, at P
    latch = np.array([[5e4, 0.0], [0.0, 5e4 * 0.15**2]])
    # A stays 1 mm beside P. In series: k_latch (d - q) = k_mount q; A's turn against S is less than
    # a milliradian and pulls back.
    q = np.linalg.solve(springs + latch, latch @ np.array([mounted.pose_act[-1, 0], 0.0]))
    assert mounted.physical[-1, 0] == pytest.approx((springs @ q)[0], rel=1e-3)
    assert mounted.physical[0, 0] == pytest.approx(0.0, abs=1e-9)  # the body has not moved yet


def test_a_mounts_springs_carry_the_moment_of_their_force() -> None:
    mount = mount_of(MOUNT["stiffness"], MOUNT["damping"])
    y = RIGID.copy()
    y[:3] = 1e-3, 2e-3, 3e-3
    out = np.zeros(6)
    carried(mount, y, out)
    np.testing.assert_allclose(out[:3], [400.0, 800.0, 2700.0])
    np.testing.assert_allclose(out[3:], np.cross(y[:3], out[:3]))


def test_the_twist_of_the_numerical_model_is_the_slope_of_its_pose() -> None:
    rig = docking_rig(overridden(SCENARIO, {"approach.rate_deg": [3.0, -2.0, 5.0]}))
    state, _ = model.start(rig.bodies, rig.approach)
    state[1, model.W], state[1, model.V] = [0.01, 0.02, -0.03], [0.02, 0.01, 0.0]
    h, origin = 1e-5, state[0, model.R].copy()
    twist = model.relative_twist(rig.bodies, state)
    before = model.relative_pose(rig.bodies, state)
    model.step(rig.bodies, state, np.zeros(6), h, 0.0, origin)
    after = model.relative_pose(rig.bodies, state)
    np.testing.assert_allclose((after[:3] - before[:3]) / h, twist[:3], atol=1e-5)


def test_a_second_order_platform_trails_a_ramp_on_every_axis() -> None:
    servo = {
        "rig.platform": {
            "kind": "pss33",
            "tracking": "servo",
            "bandwidth": 20.0,
            "damping_ratio": 0.8,
        },
        "approach.gap": 0.2,
    }
    _, records = _run(servo | {"approach.rate_deg": [0.0, 0.0, 2.0], "duration": 0.8})
    late = 2.0 * 0.8 / (2.0 * math.pi * 20.0)
    assert not records.touching.any()
    trail = records.pose_cmd[-2] - records.pose_act[-1]
    assert trail[2] == pytest.approx(0.06 * late, rel=1e-3)
    assert 2.0 * trail[5] == pytest.approx(math.radians(2.0) * late, rel=1e-2)
