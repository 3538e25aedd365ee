"""The replayed links against closed forms, and against the blocks of the simulation that they share their kernels with."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hiltestbed.diagnosis.chain import lead_record, sense_record
from hiltestbed.effects.sensor import sensor_chain

from hiltestbed.contact.law import PARAMETERS, STATES, contact_force, contact_parameters
from hiltestbed.diagnosis.links import DynamicsLink, LinkRun, WrenchLink, advanced, flat_pose
from hiltestbed.numerical_model.bodies import Spacecraft
from hiltestbed.platform.response import PlatformPath, platform_parameters, replay_platform
from hiltestbed.scenario import scenario_from

H = 1e-3


def scenario(effects=(), velocity=(0.0, 0.0, 0.03), **sensor):
    body = {"mass": 500.0, "inertia": [200.0, 180.0, 150.0], "port": {"position": [0.05, 0, 1.0]}}
    other = {"mass": 2000.0, "inertia": [900.0, 900.0, 700.0], "port": {"position": [0, 0.1, -1.0]}}
    return scenario_from({
        "name": "links", "duration": 0.4, "rate": 1 / H, "physics_rate": 4 / H, "spacecraft": {"chaser": body, "target": other},
        "approach": {"velocity": list(velocity), "gap": 0.006}, "mechanism": {"contact": {"stiffness": 1e5, "damping": 400.0}},
        "rig": {"platform": {"tracking": "ideal"}}, "sensor": sensor, "effects": list(effects),
    })  # fmt: skip


def bounce(rows=400):
    """(N, 3) a smooth approach, contact and rebound on z, and a slow slide on x."""
    t = np.arange(rows) * H
    return np.asarray(np.column_stack([0.004 * t, 0.0 * t, -0.006 + 0.03 * t - 0.05 * t**2]), dtype=np.float64)


PLATFORMS = [
    {"kind": "platform.delay", "delay": 0.0037},
    {"kind": "platform.lag", "bandwidth": 20.0},
    {"kind": "platform.mode", "frequency": 15.0, "damping_ratio": 0.05},
    {"kind": "platform.backlash", "width": 2e-4},
    {"kind": "platform.friction", "stick": 1e-4},
    {"kind": "platform.speed_limit", "speed": 0.02},
    {"kind": "platform.scale", "factor": 1.03, "axis": "z"},
]


@pytest.mark.parametrize("effect", PLATFORMS, ids=lambda e: e["kind"])
def test_a_platform_replayed_is_the_platform_simulated(effect):
    s = scenario([effect])
    command = np.column_stack([bounce()[1:], np.tile([0.0, 0.0, 0.0, 1.0], (399, 1))])
    path = PlatformPath([s])
    simulated = np.array([path.advance(k, command[k][None])[0, -1].copy() for k in range(399)])
    replayed = np.empty((399, 3))
    parameters = platform_parameters([(effect["kind"], {k: v for k, v in effect.items() if k != "kind"})])
    replay_platform(command, np.array([0.0, 0.0, -0.006]), np.array([0.0, 0.0, 0.03]), H, 4, parameters, replayed)
    assert np.allclose(replayed[1:], simulated[:-1], rtol=0, atol=1e-12)


def test_a_lag_trails_a_ramp_by_its_own_delay():
    ramp = np.column_stack([np.zeros(1500), np.zeros(1500), 0.01 * (np.arange(1500) + 1) * H])
    out = np.empty((1500, 3))
    replay_platform(ramp, np.zeros(3), np.array([0.0, 0.0, 0.01]), H, 3, platform_parameters([("platform.lag", {"bandwidth": 10.0})]), out)
    assert out[-1, 2] == pytest.approx(0.01 * (1499 * H - 2 * 0.7 / (2 * math.pi * 10.0)), abs=1e-9)


def test_play_is_crossed_at_a_reversal():
    z = np.concatenate([np.linspace(0, 1e-3, 100), np.linspace(1e-3, 0, 100)])
    out = np.empty((200, 3))
    command = np.column_stack([0 * z, 0 * z, z])
    replay_platform(command, np.zeros(3), np.zeros(3), H, 1, platform_parameters([("platform.backlash", {"width": 2e-4})]), out)
    assert out[100, 2] == pytest.approx(1e-3 - 1e-4, abs=1e-12)
    assert out[-1, 2] == pytest.approx(z[-2] + 1e-4, abs=1e-12)


def law(effects, x, v, dt=1e-4, k=1e5, c=0.0, captured=False):
    p = contact_parameters(k, c, 0.0, captured, effects)
    assert p.shape == (PARAMETERS,)
    state = np.zeros(STATES)
    return np.array([contact_force(a, b, dt, p, state) for a, b in zip(x, v, strict=True)])


def test_springs_in_series():
    x = np.linspace(0, 2e-3, 20)
    got = law([("frame.compliance", {"stiffness": 4e5})], x, np.zeros(20))
    assert np.allclose(got, 1e5 * 4e5 / 5e5 * x, rtol=1e-9)


def test_a_maxwell_branch_relaxes_with_its_time_constant():
    t = np.arange(1, 4001) * 1e-4
    ramp = np.minimum(t, 0.1) * 0.01
    rate = np.where(t <= 0.1, 0.01, 0.0)
    got = law([("contact.relaxation", {"stiffness": 5e4, "time_constant": 0.05})], ramp, rate) - 1e5 * ramp
    peak = 5e4 * 0.01 * 0.05 * (1 - math.exp(-0.1 / 0.05))
    assert got[999] == pytest.approx(peak, rel=1e-9)
    assert got[-1] == pytest.approx(peak * math.exp(-0.3 / 0.05), rel=1e-9)


def test_friction_that_gives_before_it_slips_turns_round_in_twice_its_stretch():
    """Up to 10 mm, back to 4 mm: the spring of 1e6 N/m holds 500 N after 0.5 mm, and -500 N 1 mm after the turn."""
    x = np.concatenate([np.linspace(0, 10e-3, 1001)[1:], np.linspace(10e-3, 4e-3, 601)[1:]])
    friction = {"force": 500.0, "stiffness": 1e6}
    got = law([("contact.dry_friction", friction)], x, np.full(1600, 0.1), k=0.0, captured=True)
    expected = np.where(np.arange(1600) < 1000, np.minimum(1e6 * x, 500.0), np.maximum(500.0 - 1e6 * (10e-3 - x), -500.0))
    assert np.allclose(got, expected, atol=1e-6)


def test_play_before_a_slider_travels_with_it():
    """2 mm of play: after the turn at 10 mm the force falls to nothing in 0.5 mm, stays there for 2 mm, and grows the other way."""
    x = np.concatenate([np.linspace(0, 10e-3, 1001)[1:], np.linspace(10e-3, 4e-3, 601)[1:]])
    effects = [("contact.dry_friction", {"force": 500.0, "stiffness": 1e6}), ("contact.backlash", {"width": 2e-3})]
    got = law(effects, x, np.full(1600, 0.1), k=0.0, captured=True)
    back = 10e-3 - x[1000:]
    assert np.allclose(got[1000:], np.where(back < 2.5e-3, np.maximum(500.0 - 1e6 * back, 0.0), np.maximum(-1e6 * (back - 2.5e-3), -500.0)))
    assert np.all(got[:90] == 0.0)
    assert got[999] == pytest.approx(500.0)


def test_a_slow_push_on_a_frame_with_a_mode_meets_its_static_stiffness():
    t = np.arange(1, 20001) * 1e-4
    mode = {"frequency": 20.0, "damping_ratio": 0.3, "mass": 40.0}
    x = 1e-3 * np.minimum(t, 1.0)
    force = law([("frame.mode", mode)], x, np.where(t <= 1.0, 1e-3, 0.0))
    frame = 40.0 * (2 * math.pi * 20.0) ** 2
    assert force[-1] == pytest.approx(1e-3 * 1e5 * frame / (1e5 + frame), rel=1e-4)


def test_adhesion_pulls_and_a_bumper_does_not():
    x, v = np.full(3, 1e-5), np.full(3, -0.05)
    assert np.all(law([], x, v, c=400.0) == 0.0)
    assert np.allclose(law([("contact.adhesion", {"force": 8.0})], x, v, c=400.0), -8.0)


def test_the_numerical_model_replayed_is_the_numerical_model():
    s = scenario(velocity=(0.01, -0.004, 0.03))
    wrench = np.random.default_rng(1).normal(0, [30, 20, 200, 5, 8, 3], (300, 6))
    craft, poses = Spacecraft([s]), []
    for w in wrench:
        craft.advance(w[None])
        poses.append(craft.pose[0].copy())
    link = DynamicsLink([LinkRun(s, np.zeros((300, 6)), np.ones((300, 6)), np.ones(300, bool))], [wrench])
    assert np.allclose(link.predict(0, ()), flat_pose(np.array(poses)), rtol=0, atol=1e-12)


def test_a_body_with_an_appendage_keeps_the_momentum_of_the_whole():
    s = scenario()
    wrench = np.zeros((4000, 6))
    wrench[:100, 2] = 50.0
    link = DynamicsLink([LinkRun(s, np.zeros((4000, 6)), np.ones((4000, 6)), np.ones(4000, bool))], [wrench])
    swing = ("dynamics.appendage", {"mass_ratio": 0.2, "frequency": 2.0, "damping_ratio": 0.3, "body": "chaser"})
    rigid, slosh = link.predict(0, ()), link.predict(0, [swing])
    rebound = [np.diff(z[-2:, 2])[0] for z in (rigid, slosh)]
    assert rebound[1] == pytest.approx(rebound[0], rel=1e-6)  # damped out, both parts move as one body of the believed mass


def test_a_late_record_is_the_record_read_earlier():
    s = scenario(delay=0.005)
    path = bounce()
    link = WrenchLink([LinkRun(s, np.zeros((400, 6)), np.ones((400, 6)), np.ones(400, bool))], [path])
    plain, late = link.predict(0, ()), link.predict(0, [("log.skew", {"delay": 0.003})])
    assert np.allclose(late[3:], plain[:-3], rtol=0, atol=1e-9)
    assert np.allclose(advanced(late, 3.0)[:-6], plain[:-6], rtol=0, atol=1e-9)


def test_lead_undoes_the_lag_it_was_made_for():
    sub = np.repeat(np.sin(np.arange(500) * 0.02)[:, None, None] * 100.0, 6, axis=2)
    lagged, led = np.empty((500, 6)), np.empty((500, 6))
    sense_record(np.ascontiguousarray(sub), 0.0, H, *sensor_chain([("sensor.lag", {"time_constant": 0.01})], H).arrays(), lagged)
    lead_record(lagged, 0.0105, 0.0005, H, led)
    assert np.max(np.abs(led[50:] - sub[50:, 0])) < 0.1 * np.max(np.abs(lagged[50:] - sub[50:, 0]))
