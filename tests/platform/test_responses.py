"""Tracking of every drive against its closed form, up to 1.5 times its bandwidth; stiffness and
modes against hand calculations.

The closed forms are made from MuJoCo's own mass matrix, Jacobians and loop rows, and from the
settings; nothing of the drives is used.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.measure import dynamic_stiffness, frequency_response, modes
from hiltestbed.platform.facilities.stand import TOOL, Stand
from hiltestbed.platform.facilities.stewart import ARMATURE, STROKE
from tests.platform.halls import (
    TABLE,
    arm,
    arms,
    facility,
    mass_and_jacobian,
    static_compliance,
    stewart,
)

NO_FRICTION: dict[str, Any] = {
    "friction": {"coulomb": 0.0, "stiction": 0.0, "stribeck_speed": 0.005, "viscous": 0.0}
}
DB, DEG = 1.0, 5.0


def agree(found, expected, frequency, axes) -> None:
    for axis in axes:
        for f, a, b in zip(frequency, found.own[axis], expected[axis], strict=True):
            gain, phase = 20 * math.log10(abs(a / b)), math.degrees(np.angle(a / b))
            assert abs(gain) < DB, f"axis {axis} at {f:.3g} Hz: {gain:.3f} dB"
            assert abs(phase) < DEG, f"axis {axis} at {f:.3g} Hz: {phase:.3f} deg"


def response(rig: Any, frequency: list[float], **about: Any) -> Any:
    return frequency_response(partial(Stand, rig), frequency, **about)


def leg_terms(rig) -> tuple[Array, Array]:
    """Legs' rates per twist of A (6, 6), and mass that the legs feel (6, 6), from MuJoCo's
    matrices.
    """
    stand = Stand(rig)
    mass, jac, allowed = mass_and_jacobian(stand.model, stand.drives.kinematics.home, TOOL)
    legs = allowed[[int(stand.model.joint(f"leg_{j}").dofadr[0]) for j in range(6)]]
    way = allowed @ np.linalg.inv(legs)  # all rates per leg rate
    return np.asarray(np.linalg.inv(jac @ way), dtype=float), way.T @ mass @ way


def test_electric_legs_follow_as_a_second_order() -> None:
    f = [5.0, 15.0, 25.0, 37.5]
    found = response(stewart("electric", bandwidth=25.0, damping_ratio=0.7), f, axes=[0, 2, 3])
    s, w = 2j * np.pi * np.array(f), 2 * np.pi * 25.0
    agree(found, {a: w**2 / (s**2 + 1.4 * w * s + w**2) for a in range(6)}, f, [0, 2, 3])


def test_feed_forward_takes_the_lag_out() -> None:
    stands = partial(Stand, stewart("electric"), feed=True)
    found = frequency_response(stands, [10.0], axes=[0, 2])
    np.testing.assert_allclose(found.own[[0, 2], 0], 1.0, atol=1e-4)


def test_hydraulic_legs_follow_their_linear_equations_in_all_axes() -> None:
    """M s^2 x = A p,  p s = c (Q - A s x - C p),  Q = G_v (A K (r - x) - C_f h p), h the feedback's
    high-pass; in leg coordinates.
    """
    rig = stewart("hydraulic", **NO_FRICTION)
    drive = rig.settings.drive
    legs, mass = leg_terms(rig)
    f = [4.0, 8.0, 12.0, 17.0]  # bandwidth 11 Hz at 90 deg
    found = response(rig, f, axes=[0, 2, 3])
    side = drive.dead_volume + drive.area * STROKE / 2
    c = 2 * drive.bulk_modulus / side
    expected = {a: [] for a in range(6)}
    for s in 2j * np.pi * np.array(f):
        wv = 2 * np.pi * drive.valve.bandwidth
        valve = wv**2 / (s**2 + 2 * drive.valve.damping_ratio * wv * s + wv**2)
        feedback = drive.pressure_feedback * s / (s + 2 * np.pi * drive.feedback_corner)
        den = s + c * drive.leakage + c * valve * feedback
        flow = drive.area * c * valve * drive.area * drive.gain / den
        back = drive.area * c * (valve * drive.area * drive.gain + drive.area * s) / den
        whole = (
            np.linalg.inv(legs)
            @ np.linalg.solve(mass * s**2 + np.eye(6) * back, np.eye(6) * flow)
            @ legs
        )
        for a in range(6):
            expected[a].append(whole[a, a])
    agree(found, expected, f, [0, 2, 3])


def heave_mass(armature: float) -> float:
    """What a heave feels [kg], by hand: platform and payload, legs along their axes and swinging
    about the floor's joints.
    """
    lean, length = math.radians(27.5995), 2.0875477
    rod = 25 * ((length - 0.6) ** 2 + 1.1**2 / 12 + 0.0225**2 / 4)
    cylinder = 95 * (0.78**2 + 1.36**2 / 12 + 0.075**2 / 4)
    along = (25 + armature) * math.cos(lean) ** 2
    return 220 + 200 + 6 * (along + (rod + cylinder) * (math.sin(lean) / length) ** 2)


def heave_oil(drive: Any) -> float:
    """Stiffness of six columns of oil against heave [N/m], by hand: 2 beta A^2/V a leg, twice the
    cosine of its lean.
    """
    return (
        6
        * math.cos(math.radians(27.5995)) ** 2
        * 2
        * drive.bulk_modulus
        * drive.area**2
        / (drive.dead_volume + drive.area * STROKE / 2)
    )


def test_the_hydraulic_platform_is_as_good_as_harbins() -> None:
    """At 10 Hz at most 2 dB and 70 deg in every axis, seals and payload included."""
    found = response(stewart(), [10.0])
    assert np.abs(found.gain_db()).max() <= 2.0
    assert -found.phase_deg().min() <= 70.0


def test_the_oil_under_a_shut_valve_rings_as_by_hand() -> None:
    drive = {"gain": 1e-3, "pressure_feedback": 0.0, "leakage": 0.0, **NO_FRICTION}
    rig = stewart("hydraulic", **drive)
    by_hand = math.sqrt(heave_oil(rig.settings.drive) / heave_mass(0.0)) / (2 * math.pi)
    heave = [
        mode
        for mode in modes(partial(Stand, rig))
        if abs(mode.shape[2]) == 1.0 and mode.damping_ratio < 0.1
    ]
    assert heave[0].frequency == pytest.approx(by_hand, rel=0.02)


def test_electric_legs_are_as_stiff_as_by_hand() -> None:
    """M w^2 in heave, M what a heave feels; rotational and lateral from MuJoCo's matrices."""
    rig = stewart("electric", bandwidth=25.0)
    stiffness = 1.0 / np.diag(static_compliance(rig, 2.0))
    w = 2 * np.pi * 25.0
    assert stiffness[2] == pytest.approx(heave_mass(ARMATURE) * w**2, rel=0.02)
    legs, mass = leg_terms(rig)
    expected = 1.0 / np.diag(np.linalg.inv(legs.T @ mass @ legs * w**2))
    np.testing.assert_allclose(stiffness, expected, rtol=0.02)


def arm_terms(rig):
    """Mass of motors and gears (12, 12), stiffness and damping of the gears, motors' gains,
    Jacobian of A, of an arm at home.
    """
    stand = Stand(rig)
    m = stand.model
    mass, jac, _ = mass_and_jacobian(m, stand.drives.kinematics.home, TOOL)
    order = [int(m.joint(f"{kind}{j + 1}").dofadr[0]) for kind in "ag" for j in range(6)]
    mass, jac = mass[np.ix_(order, order)], jac[:, order]
    gears = order[6:]
    stiffness = np.diag(
        [0.0] * 6 + [float(np.ravel(m.jnt_stiffness[m.dof_jntid[d]])[0]) for d in gears]
    )
    damping = np.diag([0.0] * 6 + [float(np.ravel(m.dof_damping[d])[0]) for d in gears])
    return mass, stiffness, damping, mass[:6, :6], jac


def test_an_arm_follows_as_its_elastic_joints_say() -> None:
    """[M s^2 + D s + K + controller] x = B r over motors and gears; the controller's M is that of
    the locked gears.
    """
    rig = arm(**NO_FRICTION)
    mass, stiffness, damping, rigid, jac = arm_terms(rig)
    w, zeta = (2 * np.pi * rig.settings.controller.bandwidth, rig.settings.controller.damping_ratio)
    f = [2.0, 4.5, 7.0, 10.0]
    found = response(rig, f, axes=[0, 2, 4], amplitude=5e-4)
    reach = np.linalg.inv(jac[:, :6])  # what the motors are told for a pose of A
    expected = {a: [] for a in range(6)}
    for s in 2j * np.pi * np.array(f):
        loop = np.zeros((12, 12), dtype=complex)
        loop[:6, :6] = rigid * (w**2 + 2 * zeta * w * s)
        told = np.vstack([rigid * w**2 @ reach, np.zeros((6, 6))])
        whole = jac @ np.linalg.solve(mass * s**2 + damping * s + stiffness + loop, told)
        for a in range(6):
            expected[a].append(whole[a, a])
    agree(found, expected, f, [0, 2, 4])


def test_an_arm_is_as_stiff_as_its_gears_and_motors_in_series() -> None:
    rig = arm(**NO_FRICTION)
    _, stiffness, _, rigid, jac = arm_terms(rig)
    w = 2 * np.pi * rig.settings.controller.bandwidth
    yields = np.diag(1.0 / np.diag(stiffness)[6:]) + np.linalg.inv(rigid * w**2)
    compliance = static_compliance(rig, 3.0)
    np.testing.assert_allclose(
        np.diag(compliance), np.diag(jac[:, :6] @ yields @ jac[:, :6].T), rtol=0.02
    )


def test_an_arms_first_modes_are_those_of_its_linear_equations() -> None:
    rig = arm(**NO_FRICTION)
    mass, stiffness, damping, rigid, _ = arm_terms(rig)
    w, zeta = (2 * np.pi * rig.settings.controller.bandwidth, rig.settings.controller.damping_ratio)
    stiffness[:6, :6], damping[:6, :6] = rigid * w**2, rigid * 2 * zeta * w
    first = np.block(
        [
            [np.zeros((12, 12)), np.eye(12)],
            [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)],
        ]
    )
    values = np.linalg.eigvals(first)
    by_hand = sorted(
        abs(x) / (2 * math.pi) for x in values if x.imag > 0 and -x.real < 0.9 * abs(x)
    )
    found = [mode.frequency for mode in modes(partial(Stand, rig)) if mode.damping_ratio < 0.9]
    np.testing.assert_allclose(found[:3], by_hand[:3], rtol=0.02)


@pytest.mark.parametrize(("cycles", "late"), [(8, 0), (8, 2)])
def test_the_controller_is_late_by_whole_cycles(cycles: int, late: int) -> None:
    """A pose that is due at the end of its tick is referred to at the end of a cycle, d cycles on:
    (c - 1) + c d ticks late.
    """
    rig = arm({"controller_rate": 2000.0 / cycles, "delay_cycles": late}, **NO_FRICTION)
    stand = Stand(rig, 1, feed=True)
    speed = np.array([[0.02, 0.0, 0.03, 0.0, 0.0, 0.0]])
    pose = np.array([[0.0, 0.0, -0.02, 0.0, 0.0, 0.0, 1.0]])
    start = pose.copy()
    stand.reset(pose, speed)
    behind = (cycles * (late + 1) - 1) * 0.0005
    for k in range(1, 401):
        pose[0, :3] = start[0, :3] + speed[0, :3] * k * 0.0005
        stand.advance(pose, speed, np.zeros((1, 6)))
    told = stand.drives.kinematics.home.copy()
    told[stand.drives.kinematics.q] += stand.drives.reference[0]
    referred = stand.drives.kinematics.poses(told)[0]
    np.testing.assert_allclose(pose[0, :3] - referred[:3], speed[0, :3] * behind, atol=1e-8)
    # the gears sag elsewhere
    np.testing.assert_allclose(pose[0, :3] - stand.pose[0, :3], speed[0, :3] * behind, atol=3e-5)
    assert stand.drives.lag[0] == pytest.approx(behind)


def test_two_arms_follow_together() -> None:
    """Both sides' motors are the same second order, so that the relative pose follows as one arm's
    does where the gears are stiff.
    """
    found = response(arms(**NO_FRICTION), [1.0], axes=[2])
    s, w = 2j * np.pi, 2 * np.pi * 12.0
    assert abs(found.own[2, 0] / (w**2 / (s**2 + 1.8 * w * s + w**2)) - 1.0) < 0.05


def test_position_servos_follow_as_their_linear_equations_say() -> None:
    """x = J (M s^2 + C s + K)^-1 K J^-1 r of the overhead gantry at home, up to 1.5 times the
    bandwidth of each slide; and its compliance J K^-1 J^T, levers of the wrist and all.
    """
    gantry = facility("overhead_gantry", command={"controller_rate": None})
    stand = Stand(gantry)
    m = stand.model
    mass, jac, _ = mass_and_jacobian(m, stand.drives.kinematics.home, TOOL)
    dofs = m.jnt_dofadr[m.actuator_trnid[:, 0]]
    mass, jac = mass[np.ix_(dofs, dofs)], jac[:, dofs]
    kp, kv = m.actuator_gainprm[:, 0], -m.actuator_biasprm[:, 2]
    f = [2.0, 4.0, 6.0]
    expected: dict[int, list[complex]] = {a: [] for a in range(6)}
    for s in 2j * np.pi * np.array(f):
        loop = np.linalg.solve(mass * s**2 + np.diag(kv * s + kp), np.diag(kp))
        for a, ratio in enumerate(np.diag(jac @ loop @ np.linalg.inv(jac))):
            expected[a].append(ratio)
    agree(response(gantry, f, axes=[0, 1, 2]), expected, f, [0, 1, 2])
    yields = np.diag(jac @ np.diag(1.0 / kp) @ jac.T)
    np.testing.assert_allclose(np.diag(static_compliance(gantry, 2.0))[:3], yields[:3], rtol=0.02)


def test_a_users_lift_yields_as_its_servo_on_its_mass() -> None:
    """kp - m w^2 + i w kv, with m the lift, gimbal and payload."""
    moved, kp, kv, w = 110.0 + 40.0 + 30.0 + 25.0 + 200.0, 5.2e6, 4.6e4, 2 * np.pi * 10.0
    found = dynamic_stiffness(partial(Stand, facility("mjcf", model=TABLE)), [10.0])[2, 0]
    assert abs(found / (kp - moved * w**2 + 1j * w * kv) - 1.0) < 0.02


def test_the_3_3_pss_platform_yields_by_its_gains_and_follows_as_a_second_order() -> None:
    """F/(3 kp) along z, kp = m w^2 of a drive's share; without feed-forward w^2/(s + w)^2."""
    stands, f, w = partial(Stand, facility("pss33")), [10.0, 40.0], 2.0 * np.pi * 40.0
    yields = abs(dynamic_stiffness(stands, [1.0])[2, 0])
    assert yields == pytest.approx(3.0 * 214.0 * w**2, rel=0.01)
    agree(
        frequency_response(stands, f, [2]), {2: w * w / (2j * np.pi * np.array(f) + w) ** 2}, f, [2]
    )
