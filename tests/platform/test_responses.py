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

from hiltestbed.platform.facilities.composed import TOOL
from hiltestbed.platform.facilities.measure import (
    dynamic_stiffness,
    frequency_response,
    modes,
)
from hiltestbed.platform.facilities.stand import Stand
from hiltestbed.platform.facilities.stewart import ARMATURE, STROKE
from tests.platform.halls import (
    arm,
    arms,
    facility,
    mass_and_jacobian,
    stewart,
)
from tests.slow import SLOW

NO_FRICTION: dict[str, Any] = {
    "friction": {"coulomb": 0.0, "stiction": 0.0, "stribeck_speed": 0.005, "viscous": 0.0}
}
DB, DEG = 1.0, 5.0


def agree(found: Any, expected: Any, what: str = "") -> None:
    """Complex ratios, within 1 dB and 5 deg."""
    ratio = np.asarray(found) / np.asarray(expected)
    gain, phase = 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
    assert np.abs(gain).max() < DB, f"{what}: {gain} dB"
    assert np.abs(phase).max() < DEG, f"{what}: {phase} deg"


def follows(rig: Any, law: Any, jac: Any, f: list[float], axes: list[int], **about: Any) -> None:
    """Tracking at the frequencies [Hz] and dynamic stiffness at the first of them, of a rig whose
    joints follow D(s) x = B(s) r + J^T F, (D, B) = law(s), r and F of A, J its Jacobian.
    """
    stands = partial(Stand, rig)
    found = frequency_response(stands, f, axes, **about).own
    yields = dynamic_stiffness(stands, f[:1])[:, 0]
    for n, s in enumerate(2j * np.pi * np.array(f)):
        dynamics, inputs = law(s)
        whole = np.diag(jac @ np.linalg.solve(dynamics, inputs))
        agree(found[axes, n], whole[axes], f"{f[n]:g} Hz")
        if n == 0:
            compliance = np.diag(jac @ np.linalg.solve(dynamics, jac.T))
            np.testing.assert_allclose(yields * compliance, 1.0, atol=0.03)


def leg_terms(rig: Any) -> tuple[Any, Any]:
    """Legs' rates per twist of A (6, 6), and mass that the legs feel (6, 6), from MuJoCo's
    matrices.
    """
    stand = Stand(rig)
    mass, jac, allowed = mass_and_jacobian(stand.model, stand.drives.kinematics.home, TOOL)
    legs = allowed[[int(stand.model.joint(f"leg_{j}").dofadr[0]) for j in range(6)]]
    way = allowed @ np.linalg.inv(legs)  # all rates per leg rate
    return np.asarray(np.linalg.inv(jac @ way), dtype=float), way.T @ mass @ way


def test_electric_legs_follow_as_a_second_order() -> None:
    rig, w = stewart("electric", bandwidth=25.0, damping_ratio=0.7), 2 * np.pi * 25.0
    legs, mass = leg_terms(rig)
    law = lambda s: (mass * (s**2 + 1.4 * w * s + w**2), w**2 * mass @ legs)  # noqa: E731
    follows(rig, law, np.linalg.inv(legs), [15.0, 37.5], [0, 2, 3])
    heave = 1.0 / np.linalg.inv(legs.T @ mass @ legs)[2, 2]
    assert heave == pytest.approx(heave_mass(ARMATURE), rel=0.02)


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
    c = 2 * drive.bulk_modulus / (drive.dead_volume + drive.area * STROKE / 2)
    wv, zeta, area = 2 * np.pi * drive.valve.bandwidth, drive.valve.damping_ratio, drive.area

    def law(s: complex) -> tuple[Any, Any]:
        valve = wv**2 / (s**2 + 2 * zeta * wv * s + wv**2)
        feedback = drive.pressure_feedback * s / (s + 2 * np.pi * drive.feedback_corner)
        den = s + c * drive.leakage + c * valve * feedback
        flow = area * c * valve * area * drive.gain / den
        back = area * c * (valve * area * drive.gain + area * s) / den
        return mass * s**2 + np.eye(6) * back, flow * legs

    # bandwidth 11 Hz at 90 deg
    follows(rig, law, np.linalg.inv(legs), [8.0, 17.0], [0, 2, 3])


def heave_mass(armature: float) -> float:
    """What a heave feels [kg], by hand: platform and payload, legs along their axes and swinging
    about the floor's joints.
    """
    lean, length = math.radians(27.5995), 2.0875477
    rod = 25 * ((length - 0.6) ** 2 + 1.1**2 / 12 + 0.0225**2 / 4)
    cylinder = 95 * (0.78**2 + 1.36**2 / 12 + 0.075**2 / 4)
    along = (25 + armature) * math.cos(lean) ** 2
    return 220 + 200 + 6 * (along + (rod + cylinder) * (math.sin(lean) / length) ** 2)


def test_the_hydraulic_platform_is_as_good_as_harbins() -> None:
    """At 10 Hz at most 2 dB and 70 deg in every axis, seals and payload included."""
    found = frequency_response(partial(Stand, stewart()), [10.0])
    assert np.abs(found.gain_db()).max() <= 2.0
    assert -found.phase_deg().min() <= 70.0


def test_the_oil_under_a_shut_valve_rings_as_by_hand() -> None:
    """Six columns of oil against heave: 2 beta A^2/V a leg, twice the cosine of its lean."""
    closed = {"gain": 1e-3, "pressure_feedback": 0.0, "leakage": 0.0, **NO_FRICTION}
    rig = stewart("hydraulic", **closed)
    drive, along = rig.settings.drive, math.cos(math.radians(27.5995)) ** 2
    side = drive.dead_volume + drive.area * STROKE / 2
    oil = 6 * along * 2 * drive.bulk_modulus * drive.area**2 / side
    lightly = [m for m in modes(partial(Stand, rig)) if m.damping_ratio < 0.1]
    heave = next(m.frequency for m in lightly if abs(m.shape[2]) == 1.0)
    assert heave == pytest.approx(math.sqrt(oil / heave_mass(0.0)) / (2 * math.pi), rel=0.02)


@pytest.fixture(scope="module")
def elastic() -> tuple[Any, ...]:
    """An arm; mass of its motors and gears (12, 12), their damping and stiffness, the controller's
    on the motors among them, the controller's mass (6, 6), that of the locked gears, and the
    Jacobian of A, at home.
    """
    rig = arm(**NO_FRICTION)
    stand = Stand(rig)
    m, loop = stand.model, rig.settings.controller
    mass, jac, _ = mass_and_jacobian(m, stand.drives.kinematics.home, TOOL)
    order = [int(m.joint(f"{kind}{j + 1}").dofadr[0]) for kind in "ag" for j in range(6)]
    mass, jac, rigid = mass[np.ix_(order, order)], jac[:, order], mass[np.ix_(order[:6], order[:6])]
    stiffness = np.diag(np.ravel(m.jnt_stiffness[m.dof_jntid[order]])).astype(float)
    damping = np.diag(np.ravel(m.dof_damping[order])).astype(float)
    w = 2 * np.pi * loop.bandwidth
    stiffness[:6, :6], damping[:6, :6] = rigid * w**2, rigid * 2 * loop.damping_ratio * w
    return rig, mass, damping, stiffness, jac


def test_an_arm_follows_as_its_elastic_joints_say(elastic) -> None:
    """[M s^2 + D s + K + controller] x = B r over motors and gears."""
    rig, mass, damping, stiffness, jac = elastic
    motors = stiffness[:, :6] @ np.linalg.inv(jac[:, :6])  # what they are commanded for a pose of A
    law = lambda s: (mass * s**2 + damping * s + stiffness, motors)  # noqa: E731
    follows(rig, law, jac, [4.5, 10.0], [0, 2, 4], amplitude=5e-4)


def test_an_arms_first_modes_are_those_of_its_linear_equations(elastic) -> None:
    rig, mass, damping, stiffness, _ = elastic
    rates = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    values = np.linalg.eigvals(np.vstack([np.eye(12, 24, 12), rates]))
    moving = [abs(x) / (2 * math.pi) for x in values if x.imag > 0 and -x.real < 0.9 * abs(x)]
    found = [mode.frequency for mode in modes(partial(Stand, rig)) if mode.damping_ratio < 0.9]
    np.testing.assert_allclose(found[:3], sorted(moving)[:3], rtol=0.02)


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
    found = frequency_response(partial(Stand, arms(**NO_FRICTION)), [1.0], axes=[2])
    s, w = 2j * np.pi, 2 * np.pi * 12.0
    assert abs(found.own[2, 0] / (w**2 / (s**2 + 1.8 * w * s + w**2)) - 1.0) < 0.05


def test_position_servos_follow_as_their_linear_equations_say() -> None:
    """[M s^2 + C s + K] x = K J^-1 r of the overhead gantry at home, up to 1.5 times the bandwidth
    of its slowest slide.
    """
    gantry = facility("overhead_gantry", command={"controller_rate": None})
    stand = Stand(gantry)
    m = stand.model
    mass, jac, _ = mass_and_jacobian(m, stand.drives.kinematics.home, TOOL)
    dofs = m.jnt_dofadr[m.actuator_trnid[:, 0]]
    mass, jac = mass[np.ix_(dofs, dofs)], jac[:, dofs]
    kp, kv = np.diag(m.actuator_gainprm[:, 0]), -np.diag(m.actuator_biasprm[:, 2])
    law = lambda s: (mass * s**2 + kv * s + kp, kp @ np.linalg.inv(jac))  # noqa: E731
    follows(gantry, law, jac, [3.0, 6.0], [0, 1, 2])


@SLOW
def test_the_3_3_pss_platform_yields_by_its_gains_and_follows_as_a_second_order() -> None:
    """F/(3 kp) along z, kp = m w^2 of a drive's share; without feed-forward w^2/(s + w)^2."""
    stands, f, w = partial(Stand, facility("pss33")), [10.0, 40.0], 2.0 * np.pi * 40.0
    yields = abs(dynamic_stiffness(stands, [1.0])[2, 0])
    assert yields == pytest.approx(3.0 * 214.0 * w**2, rel=0.01)
    found = frequency_response(stands, f, [2]).own[2]
    agree(found, w * w / (2j * np.pi * np.array(f) + w) ** 2)
