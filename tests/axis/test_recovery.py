"""Planted numbers come back within their intervals, from machines integrated elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.axis.diagnose import diagnosed
from hiltestbed.axis.models import AxisRun, model_of
from tests.axis import machines
from tests.slow import SLOW


def found(kind, runs, nominal, rotates=False):
    """Verdict, causes by effect, and the conclusion."""
    model = model_of(kind, runs, nominal, rotates)
    d = diagnosed(model)
    assert d.conclusion is not None
    return d.verdict, {cause.effect: cause for cause in d.extension}, d.conclusion


def test_a_carriage_gives_back_its_mass_and_what_resists_it():
    runs = [machines.carriage(s) for s in (0, 1)]
    _, causes, c = found("drive", runs, {"mass": 30.0})
    assert set(causes) == {"dynamics.mass", "dynamics.force"}
    force = causes["dynamics.force"].parameters
    assert 30.0 * causes["dynamics.mass"].parameters["factor"][0] == pytest.approx(42.0, rel=0.01)
    assert force["viscous"][0] == pytest.approx(130.0, rel=0.02)
    # an offset of 4 N beside 18 N of friction is 22 N forth and 14 N back
    forth, back = force["coulomb"][0], force.get("coulomb_back", force["coulomb"])[0]
    offset = force.get("offset", (0.0,))[0]
    assert forth + offset == pytest.approx(22.0, rel=0.02)
    assert back - offset == pytest.approx(14.0, rel=0.02)
    interval = force["viscous"][1]
    assert interval is not None
    low, high = interval
    assert low <= 130.0 <= high
    assert np.all(c.after < 0.02 * c.before)


def test_gravity_on_a_joint_is_no_spring_and_no_friction():
    runs = [machines.carriage(s, gravity=300.0, offset=0.0, swing=6.0) for s in (0, 1)]
    _, causes, _ = found("drive", runs, {"mass": 42.0}, rotates=True)
    assert "dynamics.gravity" in causes
    assert "dynamics.mass" not in causes
    # an axis that turns is in N m and rad
    assert causes["dynamics.force"].parameters["viscous"][2] == "N m s/rad"


def test_a_delay_and_a_bandwidth_are_told_apart():
    runs = [machines.servo(s) for s in (0, 1)]
    _, causes, _ = found("servo", runs, {}, rotates=True)
    assert set(causes) == {"platform.drive", "platform.delay"}
    drive = causes["platform.drive"].parameters
    assert drive["bandwidth"][0] == pytest.approx(6.0, rel=0.03)
    assert causes["platform.delay"].parameters["delay"][0] == pytest.approx(0.03, abs=0.004)


@SLOW
@pytest.mark.parametrize(
    ("planted", "named", "other"),
    [
        ({"friction": 0.02}, "platform.drive", "platform.backlash"),
        ({"play": 0.04}, "platform.backlash", None),
    ],
)
def test_play_and_dry_friction_are_told_apart(planted, named, other):
    runs = [machines.servo(s, **planted) for s in (0, 1, 2)]
    _, causes, _ = found("servo", runs, {}, rotates=True)
    assert named in causes
    assert other not in causes
    name, true = next(iter(planted.items()))
    name = "width" if name == "play" else name
    assert causes[named].parameters[name][0] == pytest.approx(true, rel=0.1)


def test_a_damper_gives_back_its_friction_and_its_preload():
    runs = [machines.damper(s) for s in (0, 1)]
    verdict, causes, _ = found("damper", runs, {"stiffness": 0.0, "damping": 500.0})
    assert causes["contact.damping"].parameters["factor"][0] == pytest.approx(1.6, rel=0.02)
    assert causes["contact.dry_friction"].parameters["force"][0] == pytest.approx(120.0, rel=0.03)
    assert causes["contact.preload"].parameters["force"][0] == pytest.approx(35.0, rel=0.1)
    assert verdict in ("named", "named_in_part", "ambiguous")


def test_a_servo_that_follows_and_a_damper_that_is_as_believed_depart_from_nothing():
    rng = np.random.default_rng(5)
    t, u = machines.chirp(20.0, 100.0, 0.1, 2.0, 0.4)
    runs = [AxisRun(f"{i}", t, u, u + 1e-3 * rng.standard_normal(len(t))) for i in range(3)]
    assert found("servo", runs, {})[0] == "no_discrepancy"
    true = machines.damper(0, slip=0.0, preload=0.0)
    assert found("damper", [true, machines.damper(1, slip=0.0, preload=0.0)],
                 {"damping": 800.0})[0] == "no_discrepancy"  # fmt: skip


def test_what_differs_between_runs_is_needed_and_its_size_is_not_determined():
    """A spring of 20, 100 and 180 N/m: the mean of two predicts the third better than none does,
    and three values that differ by so much do not exclude 0 (Student's t with two degrees of
    freedom: 100 +- 4.30 * 80/sqrt(3) N/m).
    """
    runs = [
        r._replace(u=r.u + k * r.y)
        for r, k in zip(map(machines.carriage, range(3)), (20.0, 100.0, 180.0), strict=True)
    ]
    d = diagnosed(model_of("drive", runs, {"mass": 42.0}))
    (force,), (spring,) = d.causes, d.undetermined
    assert (force.effect, spring.effect) == ("dynamics.force", "dynamics.spring")
    for name, planted in (("viscous", 130.0), ("coulomb", 18.0), ("offset", 4.0)):
        assert force.parameters[name][0] == pytest.approx(planted, rel=0.005)
    value, ends, _ = spring.parameters["stiffness"]
    assert value == pytest.approx(100.0, rel=0.01)
    assert ends is not None
    # the jackknife of three leaves two in: each fit is the mean of two values
    assert np.diff(ends)[0] / 2.0 == pytest.approx(4.30 * 80.0 / np.sqrt(3.0), rel=0.2)


@pytest.mark.parametrize(
    ("seed", "verdict"),
    [(3, "inconclusive"), (19, "unknown"), (90, "unknown")],
    ids=["as at other paces", "worse than a constant", "better on stretches by chance"],
)
def test_random_walks_are_no_response(seed, verdict):
    rng = np.random.default_rng(seed)
    t = np.arange(1500) / 100.0
    runs = [
        AxisRun(f"{i}", t, *np.cumsum(rng.standard_normal((2, 1500)), axis=1)) for i in range(2)
    ]
    d = diagnosed(model_of("servo", runs, {}))
    assert (d.verdict, d.extension) == (verdict, ())


def test_constants_and_copies_tell_nothing():
    t, u = machines.chirp(10.0, 100.0, 0.1, 2.0, 0.4)
    for y in (np.full(len(t), 0.2), 3.0 * u + 0.1):
        assert model_of("servo", [AxisRun("a", t, u, y)], {}).tells_nothing()
    assert model_of("servo", [AxisRun("a", t, 0.0 * u, u)], {}).tells_nothing()


def test_causes_that_explain_only_together_are_found_together():
    """A brake with play whose owner fitted a spring and a damper to its first record: of the true
    causes none helps by itself while the others stand where they do.
    """
    rng, rate, steps = np.random.default_rng(4), 200.0, 20
    limit, stiff, play, c, preload = 15.7e3, 6.4e6, 4.66e-3, 8.4e3, -2.0e3
    t = np.arange(int(10.0 * rate)) / rate
    x = 0.03 * np.sin(2.0 * np.pi * 0.5 * t) * (1.0 + 0.1 * np.sin(0.7 * t))
    fine = np.interp(np.arange(len(t) * steps) / (rate * steps), t, x)
    at, reach, force = 0.0, limit / stiff + 0.5 * play, np.zeros(len(t))
    for i, there in enumerate(fine):
        at = min(max(at, there - reach), there + reach)
        bent = there - at
        if i % steps == 0:
            spring = max(bent - 0.5 * play, 0.0) + min(bent + 0.5 * play, 0.0)
            force[i // steps] = stiff * spring
    v = np.gradient(x, 1.0 / rate)
    y = force + c * v + preload + 50.0 * rng.standard_normal(len(t))
    k, d = np.linalg.lstsq(np.column_stack([x, v]), y, rcond=None)[0]
    runs = [AxisRun("sine", t, x, y)]
    _, causes, found_ = found("damper", runs, {"stiffness": float(k), "damping": float(d)})
    assert causes["contact.dry_friction"].parameters["force"][0] == pytest.approx(limit, rel=0.03)
    assert causes["contact.backlash"].parameters["width"][0] == pytest.approx(play, rel=0.03)
    assert found_.fit.rms()[0] < 0.05 * found_.null.rms()[0]


def test_the_friction_of_a_buffer_that_a_mass_falls_on():
    """Few rows, a motion under way in the first one, and a turn between two rows."""
    rng, runs, fine, every = np.random.default_rng(7), [], 1e-5, 100
    for speed in (0.3, 0.6, 1.0):
        x, v, rows = 0.0, speed, []
        while len(rows) < 300 and x >= 0.0:
            force = 20e3 * x + 200.0 * v + 60.0 * np.tanh(v / 1e-4)
            rows.append((x, force))
            for _ in range(every):
                v += fine * (9.81 - (20e3 * x + 200.0 * v + 60.0 * np.tanh(v / 1e-4)) / 50.0)
                x += fine * v
        place, force = np.array(rows).T + [[2e-6], [0.2]] * rng.standard_normal((2, len(rows)))
        runs.append(AxisRun(f"{speed}", 1e-3 * np.arange(float(len(rows))), place, force))
    _, causes, _ = found("damper", runs, {"stiffness": 20e3, "damping": 200.0})
    friction = causes["contact.dry_friction"].parameters["force"]
    assert friction[0] == pytest.approx(60.0, rel=0.01)
