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
from hiltestbed.contact.directions import directions, insertion
from hiltestbed.contact.touch import first_touch
from hiltestbed.errors import InputError
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.platform.shipped.pss33 import Pss33
from hiltestbed.signals import Trace
from tests.running import judged, shipped

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


def latched(damping: float, **changes):
    """A contact that pulls, too: a linear loop."""
    keys = {
        "mechanism": {"kind": "latched", "contact": {"stiffness": K, "damping": damping}},
        "rate": 2000.0,
        "physics_rate": 4000.0,
        "approach.gap": 0.0,
        "identification.kind": "none",
    }
    return shipped("02-bumper", keys | changes)


def late(damping: float):
    """Behind a second order with a delay."""
    effects = [
        {"kind": "platform.delay", "delay": LATE},
        {"kind": "platform.lag", "bandwidth": BAND},
    ]
    return latched(damping, effects=effects, duration=4.0)


def slow_across(damping: float):
    """Behind a platform that is slow along x alone, ports at the centres of mass."""
    answer = {
        "bandwidth": [4.0, 30.0, 30.0, 30.0, 30.0, 30.0],
        "damping_ratio": 0.7,
        "delay": 0.002,
    }
    keys = {
        "spacecraft.chaser.port.position": [0.0, 0.0, 0.0],
        "spacecraft.target.port.position": [0.0, 0.0, 0.0],
        "sensor": {},
        "duration": 3.0,
        "rig.platform": {"kind": "pss33", "tracking": "response", "response": answer},
        "rate": 1000.0,
        "physics_rate": 2000.0,
        "approach.velocity": [0.004, 0.0, 0.004],
        "compensation": {"force": {"kind": "none"}, "motion": {"kind": "none"}},
    }
    return latched(damping, **keys)


def motion(scenarios):
    """Time (N,) and relative position (N, R, 3) of the loop of these runs."""
    loop, trace = Loop(scenarios), Trace(scenarios[0].ticks, len(scenarios), scenarios[0].rate)
    for _ in range(scenarios[0].ticks):
        loop.step(trace)
    return trace.t, trace["pose_cmd"][:, :, :3]


def growth(t, x, start: float) -> float:
    """[1/s] of the peaks of a vibration from ``start`` [s] on."""
    z = np.abs(x)
    peaks = 1 + np.flatnonzero((z[1:-1] > z[:-2]) & (z[1:-1] >= z[2:]) & (t[1:-1] > start))
    return float(np.polyfit(t[peaks], np.log(z[peaks]), 1)[0])


def test_the_critical_damping_of_a_second_order_with_delay() -> None:
    """The measured response, and the loop itself, are at their limit at the closed form's critical
    damping within 2 %.
    """
    closed = critical_damping(effective_mass(late(1.0).spacecraft), K)
    response = measured_response(late(closed))
    for factor, stable in ((1.02, True), (0.98, False)):
        scenario = late(factor * closed)
        found = judge(scenario, response, 0.0, True, insertion(scenario.impact), None)
        assert found.stable is stable
    around = np.array([0.9, 0.95, 1.0, 1.05, 1.1]) * closed
    t, x = motion([late(float(c)) for c in around])
    slope, offset = np.polyfit(around, [growth(t, x[:, i, 2], 0.5) for i in range(5)], 1)
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


def test_what_is_said_before_the_run_is_what_the_run_does() -> None:
    """ln e = -pi c_net/(2 m w): the net damping that was foretold is the one that the bounce shows,
    and the verdict its sign.
    """
    s = shipped("03-bumper-delay-uncompensated")
    done = run(s).summary
    said = done["stability"]
    foretold = (
        -math.pi
        * said["net_damping"]
        / (2.0 * effective_mass(s.spacecraft) * 2.0 * math.pi * said["frequency"])
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
    keys = {"sensor.delay": 0.001, "compensation.force.kind": "none"}
    said = judged(shipped("18-stewart", keys))
    assert said["stable"]
    for key, limit in (
        ("mechanism.contact.stiffness", said["largest_stiffness"]),
        ("sensor.delay", said["largest_delay"]),
    ):
        for factor, stable in ((0.99, True), (1.01, False)):
            again = judged(shipped("18-stewart", keys | {key: factor * limit}))
            assert again["stable"] is stable, (key, factor)


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
    t, x = motion([s])
    for axis, name in ((0, "along x"), (2, "along z")):
        expected = -by[name]["net_damping"] / (2.0 * effective_mass(s.spacecraft))
        assert growth(t, x[:, 0, axis], 0.3) == pytest.approx(expected, rel=0.15, abs=0.02), name


def test_a_probe_that_meets_the_cone_off_the_axis_turns_both_bodies() -> None:
    """J of the ball's contact is the cone's normal and its moment about A, 30 mm before the centre;
    its mass has both bodies' levers.
    """
    s = shipped(
        "09-docking", {"approach.offset": [0.06, 0.0], "approach.attitude_deg": [0.0, 0.0, 0.0]}
    )
    touch = first_touch(s.impact)
    row, half = touch[0], math.sqrt(0.5)  # the cone has half an angle of 45 degrees
    expected = np.concatenate([[half, 0.0, half], np.cross([0.0, 0.0, -0.03], [half, 0.0, half])])
    np.testing.assert_allclose(row, expected, atol=1e-6)
    way = next(d for d in directions(s.impact) if d.name == "along the normal of the first touch")
    total = 0.0
    for body, sense in ((s.spacecraft.chaser, 1.0), (s.spacecraft.target, 1.0)):
        arm = np.array(body.port.position) + sense * np.array([0.0, 0.0, -0.03])
        moment = np.cross(arm, row[:3])
        total += 1.0 / body.mass + float(moment @ (moment / np.array(body.inertia)))
    assert way.mass == pytest.approx(1.0 / total, rel=1e-6)


def test_a_command_through_the_inverse_of_the_platform_is_judged_as_it_runs() -> None:
    """The platform's response times its inverse is 1 to second order: the lag of 2 zeta/w = 15 ms,
    by far too much, is gone.
    """
    second_order = {"bandwidth": 15.0, "damping_ratio": 0.7}
    keys = {
        "rig.platform.tracking": "response",
        "rig.platform.response": second_order,
        "sensor.noise": 0.0,
        "compensation.force": {"kind": "phase_lead"},
    }
    inverse = {"compensation.motion": {"kind": "inverse_model"} | second_order}
    done = run(shipped("02-bumper", keys | inverse)).summary
    assert done["stability"]["rebound"] == pytest.approx(done["cor"], rel=1e-3)
    assert done["stability"]["stable"]
    assert done["cor"] < 1.0
    assert not judged(shipped("02-bumper", keys | {"compensation.motion.kind": "none"}))["stable"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"compensation.motion": {"kind": "adaptive_time_series"}},
            "adaptive_time_series, which changes the command by measurements; without it",
        ),
        (
            {"compensation.force": {"kind": "cor_designed", "stiffness": 1e5, "damping": 400.0}},
            "cor_designed",
        ),
    ],
)
def test_what_adds_a_force_or_changes_the_command_by_measurements_is_not_judged(
    changes, said
) -> None:
    phase_lead = {"compensation.force": {"kind": "phase_lead"}, "sensor.delay": 0.01}
    found = judged(shipped("02-bumper", phase_lead | changes))
    assert found["stable"] is None
    assert found["verdict"].startswith(f"not judged with {said}")
    assert found["uncompensated"]["stable"] is False


def test_bodies_that_move_by_themselves_have_no_loop() -> None:
    assert stability(shipped("22-air-bearing")) is None


def test_a_contact_faster_than_what_was_measured_is_not_judged() -> None:
    slow = RigResponse(np.arange(3.0), np.ones(3, dtype=complex), np.zeros(3, dtype=complex))
    assert net_damping(slow.finer(), 400.0, 1e6, 10.0, 0.0) is None
