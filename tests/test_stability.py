"""Stability before the run: against closed forms, and against what the loop then does."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import fsolve

from hiltestbed import run
from hiltestbed.analysis.stability import (
    EXACT,
    RigResponse,
    judge,
    largest_delay,
    measured_response,
    net_damping,
    stability,
)
from hiltestbed.contact.directions import directions
from hiltestbed.contact.touch import first_touch
from hiltestbed.errors import InputError
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.platform.pss33.settings import Pss33
from hiltestbed.signals import Trace
from tests.running import judged, shipped
from tests.slow import SLOW, slow

# of the platform: natural frequency [Hz], damping ratio, delay [s]
BAND, ZETA, LATE = 10.0, 0.7, 0.006
K = 2.0e4


def critical_damping(mass: float, stiffness: float) -> float:
    """Of a rig that is a second order with a delay: (k + c s) w^2 e^(-s tau) + m s^2 (s^2 + 2 zeta
    w s + w^2) = 0 at s = j omega.
    """
    w = 2.0 * math.pi * BAND

    def both(x):
        c, omega = x
        s = 1j * omega
        left = (stiffness + c * s) * w * w * np.exp(-s * LATE) + mass * s * s * (
            s * s + 2.0 * ZETA * w * s + w * w
        )
        return [left.real, left.imag]

    return float(
        fsolve(both, [stiffness * (LATE + 2.0 * ZETA / w), math.sqrt(stiffness / mass)])[0]
    )


def latched(damping: float):
    """A contact that pulls, too: a linear loop, behind a second order with a delay."""
    effects = [
        {"kind": "platform.delay", "delay": LATE},
        {"kind": "platform.lag", "bandwidth": BAND},
    ]
    return shipped(
        "02-bumper",
        {
            "mechanism": {"kind": "latched", "contact": {"stiffness": K, "damping": damping}},
            "effects": effects,
            "rate": 2000.0,
            "physics_rate": 4000.0,
            "duration": 4.0,
            "approach.gap": 0.0,
            "identification.kind": "none",
        },
    )


def test_the_critical_damping_of_a_second_order_with_delay() -> None:
    """The measured response, and the loop itself, are at their limit at the closed form's critical
    damping within 2 %.
    """
    mass = effective_mass(latched(1.0))
    closed = critical_damping(mass, K)
    response = measured_response(latched(closed))
    above, below = (judge(latched(factor * closed), response, 0.0) for factor in (1.02, 0.98))
    assert above is not None
    assert above.stable
    assert below is not None
    assert not below.stable
    around = np.array([0.9, 0.95, 1.0, 1.05, 1.1]) * closed
    scenarios = [latched(float(c)) for c in around]
    loop, trace = Loop(scenarios), Trace(8000, len(scenarios), 2000.0)
    for _ in range(8000):
        loop.step(trace)
    z, t = np.abs(trace["pose_cmd"][:, :, 2]), trace.t
    growth = []
    for i in range(len(around)):
        peaks = 1 + np.flatnonzero(
            (z[1:-1, i] > z[:-2, i]) & (z[1:-1, i] >= z[2:, i]) & (t[1:-1] > 0.5)
        )
        growth.append(np.polyfit(t[peaks], np.log(z[peaks, i]), 1)[0])
    slope, offset = np.polyfit(around, growth, 1)
    assert -offset / slope == pytest.approx(closed, rel=0.02)


def test_a_rig_that_follows_exactly_bears_the_contacts_own_damping_as_delay() -> None:
    """c - k tau to first order in w tau, and at the limit phase c w/k over w."""
    mass, k, c, tau = 400.0, 1e4, 200.0, 0.004
    found = net_damping(EXACT.finer(), mass, k, c, tau)
    assert found is not None
    frequency, left = found
    assert left == pytest.approx(c - k * tau, rel=0.02)
    assert frequency == pytest.approx(math.sqrt(k / mass) / (2.0 * math.pi), rel=0.02)
    omega = math.sqrt((c * c + math.sqrt(c**4 + 4.0 * k * k * mass * mass)) / 2.0) / mass
    assert largest_delay(EXACT.finer(), mass, k, c) == pytest.approx(
        math.atan(c * omega / k) / omega, rel=1e-3
    )


def test_the_measured_response_is_the_drives_second_order() -> None:
    """Without feed-forward the shipped platform is w^2/(s + w)^2, within 1 dB and 5 degrees up to
    1.5 times its bandwidth.
    """
    s = shipped("03-bumper-delay-uncompensated", {"compensation.motion.kind": "none"})
    assert isinstance(s.rig.platform, Pss33)
    found = measured_response(s)
    reach = found.frequency <= 1.5 * s.rig.platform.bandwidth
    p, w = 2j * math.pi * found.frequency[reach], 2.0 * math.pi * s.rig.platform.bandwidth
    ratio = found.follows[reach] / (w * w / (p + w) ** 2)
    assert np.abs(20.0 * np.log10(np.abs(ratio))).max() < 1.0
    assert np.abs(np.degrees(np.angle(ratio))).max() < 5.0


@pytest.mark.parametrize("kind", ["pss33", slow("stewart"), slow("serial_arm")])
def test_what_is_said_before_the_run_is_what_the_run_does(kind) -> None:
    """ln e = -pi c_net/(2 m w): the net damping that was foretold is the one that the bounce shows,
    and the verdict its sign.
    """
    s = shipped("03-bumper-delay-uncompensated", {"rig.platform": {"kind": kind}})
    done = run(s).summary
    said = done["stability"]
    foretold = (
        -math.pi
        * said["net_damping"]
        / (2.0 * effective_mass(s) * 2.0 * math.pi * said["frequency"])
    )
    assert math.log(done["cor"]) == pytest.approx(foretold, abs=0.015)
    assert not said["stable"]
    assert said["verdict"].startswith("unstable: net damping -")
    assert said["largest_delay"] < 0.005


def test_a_slower_controller_of_the_sliders_is_as_late_as_its_cycles() -> None:
    """500 Hz in a loop of 2 kHz, one cycle held back: 4 (1 + 1) - 1 ticks at low frequency. A cycle
    that is not whole is refused.
    """
    command = {"controller_rate": 500.0, "delay_cycles": 1}
    keys = {
        "rig.platform": {"kind": "pss33", "command": command},
        "rate": 2000.0,
        "physics_rate": 4000.0,
    }
    s = shipped("03-bumper-delay-uncompensated", keys)
    direct = shipped("03-bumper-delay-uncompensated", keys | {"rig.platform": {"kind": "pss33"}})
    found, none = measured_response(s), measured_response(direct)
    low = (found.frequency > 0.0) & (found.frequency <= 4.0)
    late = -np.angle(found.follows[low] / none.follows[low]) / (
        2.0 * math.pi * found.frequency[low]
    )
    assert late == pytest.approx(7 / 2000.0, rel=0.02)
    with pytest.raises(InputError, match=r"controller_rate: does not divide the loop's rate"):
        shipped(
            "03-bumper-delay-uncompensated", keys | {"rig.platform.command.controller_rate": 900.0}
        )


def test_stiffer_or_later_than_the_limit_is_unstable() -> None:
    s = shipped("18-stewart", {"sensor.delay": 0.001, "compensation.force.kind": "none"})
    said = judged(s)
    assert said["stable"]
    for key, limit in (
        ("mechanism.contact.stiffness", said["largest_stiffness"]),
        ("sensor.delay", said["largest_delay"]),
    ):
        for factor, stable in ((0.99, True), (1.01, False)):
            again = judged(
                shipped(
                    "18-stewart",
                    {"sensor.delay": 0.001, "compensation.force.kind": "none"}
                    | {key: factor * limit},
                )
            )
            assert again["stable"] is stable, (key, factor)


def slow_across(damping: float):
    """A latch behind a platform that is slow along x alone, ports at the centres of mass."""
    answer = {
        "bandwidth": [4.0, 30.0, 30.0, 30.0, 30.0, 30.0],
        "damping_ratio": 0.7,
        "delay": 0.002,
    }
    still = {
        "spacecraft.chaser.port.position": [0.0, 0.0, 0.0],
        "spacecraft.target.port.position": [0.0, 0.0, 0.0],
    }
    return shipped(
        "02-bumper",
        {
            "mechanism": {"kind": "latched", "contact": {"stiffness": K, "damping": damping}},
            "sensor": {},
            "duration": 3.0,
            "rig.platform": {"kind": "pss33", "tracking": "response", "response": answer},
            "rate": 1000.0,
            "physics_rate": 2000.0,
            "approach": {"gap": 0.0, "velocity": [0.004, 0.0, 0.004], "offset": [0.0, 0.0]},
            "identification.kind": "none",
            "compensation": {"force": {"kind": "none"}, "motion": {"kind": "none"}},
        }
        | still,
    )


def test_the_worst_axis_is_what_the_verdict_says() -> None:
    """Along x the loop diverges, along z it does not, each as fast as its net damping says: growth
    -c_net/(2 m).
    """
    s = slow_across(700.0)
    said = judged(s)
    assert said["verdict"].startswith("unstable along x: net damping -")
    by = {d["direction"]: d for d in said["directions"]}
    assert by["along z"]["stable"]
    assert set(by) == {"along x", "along y", "along z", "about x", "about y", "about z"}
    loop, trace = Loop([s]), Trace(3000, 1, s.rate)
    for _ in range(3000):
        loop.step(trace)
    t, mass = trace.t, effective_mass(s)
    for axis, name in ((0, "along x"), (2, "along z")):
        z = np.abs(trace["pose_cmd"][:, 0, axis])
        peaks = 1 + np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:]) & (t[1:-1] > 0.3))
        growth = np.polyfit(t[peaks], np.log(z[peaks]), 1)[0]
        assert growth == pytest.approx(
            -by[name]["net_damping"] / (2.0 * mass), rel=0.15, abs=0.02
        ), name


def test_a_probe_that_meets_the_cone_off_the_axis_turns_both_bodies() -> None:
    """J of the ball's contact is the cone's normal and its moment about A, 30 mm before the centre;
    its mass has both bodies' levers.
    """
    s = shipped(
        "09-docking", {"approach.offset": [0.06, 0.0], "approach.attitude_deg": [0.0, 0.0, 0.0]}
    )
    touch = first_touch(s)
    assert touch is not None
    row, half = touch[0], math.sqrt(0.5)  # the cone has half an angle of 45 degrees
    expected = np.concatenate([[half, 0.0, half], np.cross([0.0, 0.0, -0.03], [half, 0.0, half])])
    np.testing.assert_allclose(row, expected, atol=1e-6)
    way = next(d for d in directions(s) if d.name == "along the normal of the first touch")
    total = 0.0
    for body, sense in ((s.spacecraft.chaser, 1.0), (s.spacecraft.target, 1.0)):
        arm = np.array(body.port.position) + sense * np.array([0.0, 0.0, -0.03])
        moment = np.cross(arm, row[:3])
        total += 1.0 / body.mass + float(moment @ (moment / np.array(body.inertia)))
    assert way.mass == pytest.approx(1.0 / total, rel=1e-6)


@SLOW
def test_a_command_through_the_inverse_of_the_platform_is_judged_as_it_runs() -> None:
    """The platform's response times its inverse is 1 to second order: the lag of 2 zeta/w = 15 ms,
    by far too much, is gone.
    """
    rig = {
        "rig.platform.tracking": "response",
        "rig.platform.response": {"bandwidth": 15.0, "damping_ratio": 0.7},
        "sensor.noise": 0.0,
    }
    inverse = {
        "compensation.motion": {"kind": "inverse_model", "bandwidth": 15.0, "damping_ratio": 0.7}
    }
    found = {}
    for name, changes in {
        "none": {"compensation.motion": {"kind": "none"}},
        "inverse": inverse,
    }.items():
        summary = run(
            shipped("02-bumper", {"compensation.force": {"kind": "phase_lead"}} | rig | changes)
        ).summary
        found[name] = summary["stability"]
        assert found[name]["rebound"] == pytest.approx(summary["cor"], rel=1e-3)
        assert found[name]["stable"] is (summary["cor"] < 1.0)
    assert (found["none"]["stable"], found["inverse"]["stable"]) == (False, True)


def test_what_changes_the_command_by_measurements_is_not_judged() -> None:
    changes = {
        "compensation.motion": {"kind": "adaptive_time_series"},
        "compensation.force": {"kind": "phase_lead"},
    }
    found = judged(shipped("02-bumper", changes))
    assert found["stable"] is None
    assert found["verdict"].startswith(
        "not judged with adaptive_time_series, which changes the command by measurements; without "
        "it"
    )


@SLOW
def test_what_adds_a_force_of_its_own_is_not_judged() -> None:
    said = judged(shipped("20-facing-arms"))
    assert said["stable"] is None
    assert "not judged with cor_designed" in said["verdict"]
    assert said["uncompensated"]["stable"] is False


def test_bodies_that_move_by_themselves_have_no_loop() -> None:
    assert stability(shipped("22-air-bearing")) is None


def test_a_contact_faster_than_what_was_measured_is_not_judged() -> None:
    slow = RigResponse(np.arange(3.0), np.ones(3, dtype=complex), np.zeros(3, dtype=complex))
    assert net_damping(slow.finer(), 400.0, 1e6, 10.0, 0.0) is None
