"""The bounce that is foretold before a run: against closed forms and small steps, and against what
the loop then does.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed import run
from hiltestbed.analysis.stability import EXACT, RigResponse
from hiltestbed.analysis.trial import bounce, first_contact
from hiltestbed.contact.directions import directions
from tests.running import judged, shipped
from tests.slow import SLOW


@pytest.mark.parametrize("ratio", [0.05, 0.3, 0.8])
def test_a_bounce_without_a_rig_is_that_of_a_spring_and_a_damper(ratio) -> None:
    """It ends where the force is zero: e = exp(-zeta/s atan2(2 zeta s, 2 zeta^2 - 1)), s = sqrt(1 -
    zeta^2); nothing makes energy.
    """
    mass, k = 300.0, 2.0e4
    found = bounce(EXACT, mass, k, 2.0 * ratio * math.sqrt(k * mass), 0.0)
    s = math.sqrt(1.0 - ratio**2)
    assert found.rebound == pytest.approx(
        math.exp(-ratio / s * math.atan2(2.0 * ratio * s, 2.0 * ratio**2 - 1.0)), abs=2e-3
    )
    assert found.energy == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize(
    ("band", "zeta", "late", "ratio", "mass"),
    [(20.0, 1.0, 0.002, 0.3, 50.0), (10.0, 0.7, 0.006, 0.4, 300.0)],
)
def test_a_bounce_through_a_second_order_and_a_delay(band, zeta, late, ratio, mass) -> None:
    """Against small explicit steps of x'' = w^2 (z - x) - 2 zeta w x', m z'' = -F(t - late), F = k
    x + c x' while x > 0.
    """
    k, w = 2.0e4, 2.0 * math.pi * band
    c = 2.0 * ratio * math.sqrt(k * mass)
    f = np.arange(0.0, 101.0)
    p = 2j * math.pi * f
    found = bounce(
        RigResponse(f, w * w / (p * p + 2.0 * zeta * w * p + w * w), np.zeros(101, dtype=complex)),
        mass,
        k,
        c,
        late,
    )
    dt = 2e-5
    ago = round(late / dt)
    z, v, x, rate = 2.0 * zeta / w, 1.0, 0.0, 1.0  # on a uniform motion the rig is 2 zeta/w late
    force, work, touching = [], 0.0, True
    for j in range(round(0.6 / dt)):
        touching = touching and (x > 0.0 or j == 0)
        force.append(max(0.0, k * x + c * rate) if touching else 0.0)
        work += force[-1] * rate * dt
        v -= dt / mass * (force[j - ago] if j >= ago else 0.0)
        z += v * dt
        rate += dt * (w * w * (z - x) - 2.0 * zeta * w * rate)
        x += rate * dt
    assert found.rebound == pytest.approx(-v, rel=0.01)
    assert found.energy == pytest.approx(2.0 * work / mass - (1.0 - v * v), rel=0.01)


def light_tip(k: float, c: float, **more):
    """A probe, little of whose mass a cone's normal moves; spring, damper, no compensation."""
    bodies = {
        "chaser": {
            "mass": 750.0,
            "inertia": [200.0, 200.0, 225.0],
            "port": {"position": [0.0, 0.0, 0.9]},
        },
        "target": {
            "mass": 500.0,
            "inertia": [250.0, 250.0, 300.0],
            "port": {"position": [0.0, 0.0, -1.9]},
        },
    }
    keys = {
        "spacecraft": bodies,
        "mechanism": {"kind": "probe_cone", "contact": {"stiffness": k, "damping": c}},
        "approach": {"gap": 0.07, "offset": [0.04, 0.0], "velocity": [0.0, 0.0, 0.08]},
        "duration": 0.7,
        "sensor": {"delay": 0.002},
        "identification.kind": "none",
        "compensation": {"force": {"kind": "none"}, "motion": {"kind": "none"}},
    }
    return shipped("09-docking", keys | more)


@pytest.mark.parametrize(
    ("k", "c", "damped", "stable"),
    [(3.4e5, 1.02e4, True, False), (1.0e5, 6000.0, True, True), (3.4e5, 3000.0, False, False)],
)
def test_a_bounce_in_a_cone_is_foretold(k, c, damped, stable) -> None:
    """Speed after it and energy that the rig makes, within 5 %: it may gain although much damping
    is left of what stays.
    """
    s = light_tip(k, c)
    done = run(s)
    said = {d["direction"]: d for d in done.summary["stability"]["directions"]}[
        "along the normal of the first touch"
    ]
    way = next(d for d in directions(s.impact) if d.slant)
    contact, twist = done.trace.contact, done.trace["twist_cmd"]
    first = int(np.argmax(contact))
    last = first + int(np.argmin(contact[first:]))
    before, after = way.row @ twist[first - 1], way.row @ twist[last + 60]
    assert -after / before == pytest.approx(said["rebound"], rel=0.05)
    assert done.summary["energy_generated"] / (0.5 * way.mass * before**2) == pytest.approx(
        said["rig_energy"], rel=0.05
    )
    assert (said["net_damping"] > 0.0) is damped
    assert said["stable"] is stable
    assert bool(-after / before < 1.0) is stable
    assert done.summary["stability"]["stable"] is stable


def test_the_delay_that_a_bounce_bears() -> None:
    """At the largest delay a bounce ends as fast as it began, or its damping is used up."""
    said = judged(light_tip(1.0e5, 6000.0))
    for factor, stable in ((0.98, True), (1.02, False)):
        again = judged(light_tip(1.0e5, 6000.0, **{"sensor.delay": factor * said["largest_delay"]}))
        assert again["stable"] is stable, factor


@SLOW
def test_a_prediction_makes_up_for_the_platform_where_it_knows_the_line() -> None:
    """On the first touch the rig makes nothing; on the wall across it does, less than without
    prediction; with feed-forward nowhere.
    """
    shared = {
        "approach.offset": [0.06, 0.0],
        "approach.attitude_deg": [0.0, 0.0, 0.0],
        "mechanism.latch": None,
        "duration": 3.3,
    }
    shared |= {
        "mechanism.contact": {"stiffness": 5.0e4, "damping": 800.0, "friction": 0.0},
        "sensor": {"delay": 0.002},
    }
    made = {}
    for motion in ("none", "feedforward"):
        keys = shared | {
            "compensation": {"force": {"kind": "resynchronised"}, "motion": {"kind": motion}}
        }
        done = run(shipped("09-docking", keys))
        made[motion] = done.summary["energy_generated"] / done.summary["approach_energy"]
        said = {d["direction"]: d["rig_energy"] for d in done.summary["stability"]["directions"]}
        assert said["along the normal of the first touch"] == pytest.approx(0.0, abs=1e-3)
        assert (said["along the normal of a later touch"] > 0.05) is (motion == "none")
    assert made["none"] > 0.05
    assert abs(made["feedforward"]) < 0.01
    flat = judged(shipped("02-bumper", {"compensation.motion.kind": "none"}))
    assert [d["direction"] for d in flat["directions"]] == ["along z"]


def slow_bounce(
    drives: dict, speed: float, delay: float = 0.002, motion: str = "none", duration: float = 0.8
):
    """A bumper on a rig with drives that rub, or do not, met at a speed [m/s]."""
    keys = {
        "rig.platform": drives,
        "mechanism.contact": {"stiffness": 1.0e5, "damping": 1500.0, "friction": 0.0},
        "sensor": {"delay": delay},
        "approach": {"gap": 0.3 * speed, "velocity": [0.0, 0.0, speed]},
        "identification.kind": "none",
        "duration": duration,
        "compensation": {"force": {"kind": "none"}, "motion": {"kind": motion}},
    }
    return shipped("18-stewart", keys)


SLIDERS = {"kind": "pss33", "actuator": {"kind": "single"}}
SEALS = {"kind": "stewart"}
SMOOTH = SEALS | {
    "drive": {
        "kind": "hydraulic",
        "friction": {"coulomb": 0.0, "stiction": 0.0, "stribeck_speed": 0.005, "viscous": 600.0},
    }
}


@SLOW
def test_friction_makes_more_of_a_slow_bounce_and_nothing_without_it_hangs_on_the_speed() -> None:
    """What sticks at a reversal is a length, of which a slow bounce is short; without it drives,
    valves and oil are linear.
    """
    told = {
        (speed, rubs): judged(slow_bounce(SEALS if rubs else SMOOTH, speed))
        for speed in (0.005, 0.05)
        for rubs in (True, False)
    }
    rebound = {key: said["rebound"] for key, said in told.items()}
    assert rebound[0.005, False] == pytest.approx(rebound[0.05, False], rel=5e-3)
    assert rebound[0.005, True] > 1.1 * rebound[0.005, False]
    assert rebound[0.05, True] == pytest.approx(rebound[0.05, False], rel=0.03)


def test_the_first_contact_is_the_same_however_long_the_run_is() -> None:
    """Also where it ends before the touch at 0.3 s."""
    told = [judged(slow_bounce(SLIDERS, 0.02, duration=duration)) for duration in (0.8, 0.2)]
    first, second = (
        {key: said[key] for key in ("rebound", "rig_energy", "largest_delay", "stable")}
        for said in told
    )
    assert first == second


def test_drives_that_rub_bear_the_delay_that_is_told() -> None:
    """Runs with a little less delay end slower than they began, with a little more faster."""
    said = judged(slow_bounce(SLIDERS, 0.008, motion="feedforward"))
    assert said["largest_delay"] > 0.002
    for factor, faster in ((0.97, False), (1.03, True)):
        s = slow_bounce(SLIDERS, 0.008, factor * said["largest_delay"], "feedforward")
        assert (run(s).summary["cor"] > 1.0) is faster, factor


def test_a_tip_that_slides_in_its_socket_ends_as_foretold() -> None:
    """Centred, tilted: the normal turns by up to half a right angle while the tip slides to the
    bottom. Along the impulse of the run.
    """
    keys = {
        "approach.offset": [0.0, 0.0],
        "approach.attitude_deg": [4.0, -3.0, 0.0],
        "approach.gap": 0.03,
        "duration": 1.0,
        "mechanism.contact.friction": 0.1,
    }
    done = run(light_tip(1.0e5, 6000.0, **keys)).summary
    by = {d["direction"]: d for d in done["stability"]["directions"]}
    first = by["along the normal of the first touch"]
    assert first["rebound"] == pytest.approx(done["cor_normal"], rel=0.02)
    assert first["caveat"] is None
    assert by["along z"]["caveat"].startswith("of a head-on touch")


def test_a_bounce_that_is_not_the_first_contacts_says_to_which_side_it_is() -> None:
    later = judged(shipped("09-docking", {"compensation": {"force": {"kind": "resynchronised"}}}))
    caveats = {d["direction"]: d["caveat"] for d in later["directions"]}
    assert caveats["along the normal of a later touch"].startswith("an upper bound")
    moving = judged(shipped("16-probe-drogue"))
    assert "to either side" in moving["directions"][0]["caveat"]


@pytest.mark.parametrize(
    "gives",
    [
        {"kind": "frame.mode", "frequency": 12.0, "damping_ratio": 0.02, "mass": 10.0},
        {"kind": "contact.relaxation", "stiffness": 2.0e4, "time_constant": 0.05},
    ],
)
def test_what_gives_way_behind_the_contact_is_in_the_bounce_that_is_foretold(gives) -> None:
    """A frame takes part of deflection and damper's work: without it the rebound is 0.91."""
    s = shipped("02-bumper", {"effects": [gives], "compensation": {"force": {"kind": "none"}}})
    said, done = judged(s), run(s).summary
    assert abs(done["cor"] - 0.907) > 0.01
    assert said["rebound"] == pytest.approx(done["cor"], rel=1e-3)
    assert said["caveat"] is None


def test_what_is_not_in_the_bounce_that_is_foretold_is_said() -> None:
    """A gain that is not believed makes another stiffness of the model's contact; a delay is in the
    force that is late.
    """
    hidden = [{"kind": "sensor.gain", "factor": 1.3}, {"kind": "sensor.delay", "delay": 0.001}]
    said = judged(shipped("02-bumper", {"effects": hidden}))
    assert said["caveat"] == "without sensor.gain"


def test_a_stiffness_that_an_effect_of_the_contact_does_not_bear_is_not_simulated() -> None:
    """A gram on 1 GN/m would ring in 1,250 steps an instant, which no scenario may."""
    ringing = {"kind": "frame.mode", "frequency": 1.0e4, "damping_ratio": 0.1, "mass": 1e-3}
    simulated = first_contact(shipped("02-bumper", {"effects": [ringing]}))
    assert simulated.bounce(0.0) is not None
    assert simulated.bounce(0.0, 1.0e4) is None
