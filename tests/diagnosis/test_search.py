"""What leads a search to a cause: effects with a vector, stiction, a response taken step by step, a varying delay, a hidden tone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hiltestbed.diagnosis.candidates import Scales, candidate, sensor_candidates
from hiltestbed.diagnosis.tones import tone_beside

from hiltestbed.diagnosis.fit import Residual, fit, square
from hiltestbed.diagnosis.links import AHEAD, FORM, Effects, LinkRun, PlatformLink, WrenchLink, unstamped
from hiltestbed.diagnosis.search import jitter_beside, null_fit, prescreen
from hiltestbed.diagnosis.stiction import finest_sticks, stick_starts
from hiltestbed.frames import Array
from hiltestbed.scenario import scenario_from

H = 1e-3
STIFFNESS = 1e5
NOISE = 0.1  # N
POSE_NOISE = 2e-6  # m


def scenario(delay: float = 0.005) -> Any:
    body = {"mass": 500.0, "inertia": [200.0, 180.0, 150.0], "port": {"position": [0, 0, 1.0]}}
    return scenario_from({
        "name": "search", "duration": 0.5, "rate": 1 / H, "physics_rate": 4 / H, "spacecraft": {"chaser": body, "target": body},
        "approach": {"velocity": [0.0, 0.0, 0.03], "gap": 0.003}, "mechanism": {"contact": {"stiffness": STIFFNESS, "damping": 400.0}},
        "rig": {"platform": {"tracking": "ideal"}}, "sensor": {"delay": delay, "noise": NOISE},
    })  # fmt: skip


def bounce(rows: int = 500, speed: float = 0.03) -> Array:
    """(N, 3) approach from 0.1 s before the touch, half a sine of 0.3 s in contact, rebound."""
    t = np.arange(rows) * H - 0.1 - 0.3 * H
    inside = speed * 0.3 / math.pi * np.sin(math.pi * np.clip(t, 0.0, 0.3) / 0.3)
    z = np.where(t < 0.0, speed * t, np.where(t < 0.3, inside, -speed * (t - 0.3)))
    return np.asarray(np.column_stack([0.0 * t, 0.0 * t, z]), dtype=np.float64)


def contact_link(effects: Effects, seed: int = 1) -> WrenchLink:
    """Readings of a contact with `effects` in it, with noise."""
    path, s = bounce(), scenario()
    sigma = np.full((len(path), 6), NOISE)
    touching = path[:, 2] > 0.0
    clean = WrenchLink([LinkRun(s, np.zeros((len(path), 6)), sigma, touching)], [path])
    measured = clean.predict(0, effects) + NOISE * np.random.default_rng(seed).standard_normal((len(path), 6))
    return WrenchLink([LinkRun(s, measured, sigma, touching)], [path])


def platform_link(effects: Effects, speeds: tuple[float, ...] = (0.03, 0.06)) -> PlatformLink:
    """Positions of a platform with `effects`, with noise."""
    paths, s, rng = [bounce(speed=v) for v in speeds], scenario(), np.random.default_rng(2)
    commands = [np.column_stack([p[1:], np.tile([0.0, 0.0, 0.0, 1.0], (len(p) - 1, 1))]) for p in paths]
    runs = [LinkRun(s, np.zeros((len(c), 3)), np.full((len(c), 3), POSE_NOISE), np.ones(len(c), dtype=bool)) for c in commands]
    link = PlatformLink(runs, commands)
    for i, run in enumerate(runs):
        run.measured = link.path(i, effects) + POSE_NOISE * rng.standard_normal(run.measured.shape)
    return link


class Along:
    """A link whose output is a vector's components, each on a channel of its own, in units of the noise."""

    name, channels = "dynamics", ("x", "y", "z")

    def __init__(self, measured: Array) -> None:
        self.runs = [LinkRun(scenario(), measured, np.ones_like(measured), np.ones(len(measured), dtype=bool))]

    def predict(self, i: int, effects: Effects) -> Array:
        return (
            np.tile(np.sum([p["offset"] for _, p in effects], axis=0) * 1e3, (len(self.runs[0].measured), 1))
            if effects
            else np.zeros(self.runs[0].measured.shape)
        )


@pytest.mark.parametrize("direction", [(1, 1, 1), (1, -1, 0), (-1, -1, 2), (0, 1, -1)])
def test_a_vector_is_weighed_in_whichever_direction_it_points(direction: tuple[int, int, int]):
    measured = np.tile(1e3 * 0.02 * np.array(direction, dtype=float), (10, 1))
    residual = Residual(Along(measured))
    null = null_fit(residual)
    c = candidate("dynamics.port_offset", {f"offset.{j}": [0.0] for j in range(3)}, starts=[(0, 0, 0), (0.05, 0.05, 0.05)], body="chaser")
    gain, starts = prescreen(residual, null, null.jacobian, c)
    assert gain == pytest.approx(null.chi2, rel=1e-6)  # linear in the vector: all of it can be taken off
    assert fit(residual, (c,), starts).theta == pytest.approx(0.02 * np.array(direction), abs=1e-8)


def test_a_drift_is_found_up_to_the_size_of_the_contact():
    scales = Scales(force=300.0, depth=3e-3, stiffness=1e5, tick=H, noise=0.1, slow=0.02, fast=0.1, duration=0.5)
    drifts = [c for c in sensor_candidates(scales, {}) if c.effect == "sensor.drift"]
    assert len(drifts) == 3  # an axis each
    assert all(c.low[0] <= -300.0 / 0.5 and c.high[0] >= 300.0 / 0.5 for c in drifts)


def test_a_stick_is_found_to_where_the_last_jump_ends():
    stick = 8.37e-5
    link = platform_link([("platform.friction", {"stick": stick, FORM: 20})])
    starts = stick_starts(link, POSE_NOISE, 4)[20]
    # 9.5 mm in and out at 0.06 m/s are some 230 jumps: a noise of 2 um at their end is 2e-6/230/stick = 1e-4 of the stick.
    assert starts[0] == pytest.approx(stick, rel=1e-4)
    residual = Residual(link)
    left = square(residual([("platform.friction", {"stick": starts[0], FORM: 20})]))
    count = np.count_nonzero(residual(()))
    assert left < count + 4.0 * math.sqrt(2.0 * count)  # of chi-square with as many degrees of freedom
    assert finest_sticks(residual, [2e-3], 1e-3, 4) == [2e-3]  # no better than none at all: left as it is


def test_a_mode_integrated_step_by_step_is_one_that_answers_a_step_early():
    frequency, ratio, steps = 12.0, 0.05, 20
    w, dt = 2.0 * math.pi * frequency, H / steps
    link = platform_link([])
    command = link.commands[0][:, 2]
    x, v, node = -0.0030, 0.03, np.concatenate([[-0.0030], command])
    s = link.runs[0].scenario.approach
    assert (s.gap, s.velocity[2]) == (0.003, 0.03)
    reached = [x]
    for k in range(len(command) - 1):
        rate = (node[k + 1] - node[k]) / H
        for j in range(steps):
            u = node[k] + rate * (j + 1) * dt
            v += dt * (w * w * (u - x) - 2.0 * ratio * w * (v - rate))
            x += dt * v
        reached.append(x)
    early, exact = (link.path(0, [("platform.mode", {"frequency": frequency, "damping_ratio": ratio, AHEAD: a})])[:, 2] for a in (dt, 0.0))
    near, far = (float(np.max(np.abs(np.array(reached) - path))) for path in (early, exact))
    assert near < 0.2 * far  # the step early is what the two differ by, but for the frequency and damping themselves
    assert far < 2.0 * dt * 0.06 / (2.0 * ratio)  # a step at twice the speed of approach, magnified by the mode


def test_a_reading_that_is_late_throughout_is_no_varying_delay():
    late = Residual(contact_link([("sensor.delay", {"delay": 0.3e-3})]))
    assert jitter_beside(late, null_fit(late)) is None


def test_a_delay_that_varies_is_found_with_its_size():
    sigma, link, rng = 0.4e-3, contact_link([]), np.random.default_rng(3)
    slope = link.slope(0, [])
    link.runs[0].measured = link.runs[0].measured - slope * sigma * rng.standard_normal((len(slope), 1))
    residual = Residual(link)
    found = jitter_beside(residual, null_fit(residual))
    assert found is not None
    # Some 300 rows in contact: 1/sqrt(2 x 300) is a relative error of 0.04 of the deviation; three of them, and the edges.
    assert found.theta[-1] == pytest.approx(sigma, rel=0.15)


def test_a_hum_behind_a_dead_zone_is_found_in_the_contact():
    zone = ("sensor.deadzone", {"width": 30.0})
    hum = ("sensor.hum", {"frequency": 130.0, "amplitude": 1.5, "phase": 0.4, "axis": "z"})
    residual = Residual(contact_link([zone, hum]))
    base = fit(residual, (candidate("sensor.deadzone", {"width": [25.0, 30.0]}),), [(30.0,)])
    found = tone_beside(residual, base)
    assert found is not None
    # 300 rows: the frequency of a tone 15 times the noise is known to sqrt(6)/(pi T 15 sqrt(300)) = 0.01 Hz in T = 0.3 s.
    assert found.effects()[1][1]["frequency"] == pytest.approx(130.0, abs=0.05)
    assert found.effects()[1][1]["amplitude"] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("form", [{}, {FORM: "continuous"}])
def test_a_record_stamped_whole_ticks_late_is_the_record_so_many_rows_on(form: dict[str, str]):
    link = contact_link([])
    effects = [("sensor.hum", {"frequency": 61.0, "amplitude": 2.0, "phase": 0.3, "axis": "z"})]
    stamped = link.predict(0, [*effects, ("log.skew", {"delay": 3 * H} | form)])
    assert stamped[50:] == pytest.approx(link.predict(0, effects)[47:-3], abs=1e-9)


def test_what_the_loop_read_is_had_from_a_late_record_across_a_touch():
    link = contact_link([])
    skew = ("log.skew", {"delay": 2.7e-3, FORM: "continuous"})
    noise = NOISE * np.random.default_rng(4).standard_normal((500, 6))
    in_time, late = link.predict(0, []), link.predict(0, [skew])
    run = link.runs[0]
    run.measured = late + np.concatenate([np.zeros((3, 6)), noise[:-3]])
    used = unstamped(run, late, in_time, 3)
    assert used[:-3] == pytest.approx((in_time + noise)[:-3], abs=4.0 * NOISE)  # beyond which nothing is taken for noise
    kept = np.abs(noise[:-3]) < 4.0 * NOISE
    assert used[:-3][kept] == pytest.approx((in_time + noise)[:-3][kept], abs=1e-9)


@pytest.mark.parametrize("form", ["elastic", 0.0, "continuous"])
def test_the_platform_does_not_mind_how_an_effect_of_the_contact_is_read(form: str | float):
    link = platform_link([])
    contact = [("frame.compliance", {"stiffness": 1e6, FORM: form}), ("contact.misalignment", {"angles_deg": [1.0, 1.0], FORM: form})]
    assert np.array_equal(link.path(0, contact), link.path(0, ()))


def test_responses_that_are_integrated_step_by_step_look_no_further_than_the_command():
    link = platform_link([])
    lag, mode = ("platform.lag", {"bandwidth": 50.0}), ("platform.mode", {"frequency": 30.0, "damping_ratio": 0.1})
    one = link.path(0, [(lag[0], lag[1] | {AHEAD: H}), mode])
    both = link.path(0, [(lag[0], lag[1] | {AHEAD: H}), (mode[0], mode[1] | {AHEAD: H})])
    assert np.array_equal(one, both)


def test_where_a_reading_lies_on_the_steps_of_the_facility_the_data_bear_it_out():
    """A damper's force jumps from tick to tick: between two instants a reading is on neither side of the jump, or on the line across."""
    delay, grid = 2.7 * H, 2  # in the first half of a tick, whose start the line crosses
    link = contact_link([])
    for own, other in ((None, grid), (grid, None)):
        link.grid = own
        link.runs[0].measured = link.predict(0, [("sensor.delay", {"delay": delay})])
        found = {}
        for tried in (own, other):
            link.grid = tried
            found[tried] = fit(Residual(link), (candidate("sensor.delay", {"delay": [2.0 * H, 2.8 * H]}),), [[2.0 * H], [2.8 * H]])
        assert found[own].theta[0] == pytest.approx(delay, rel=1e-4)
        assert found[own].chi2 < 1e-3 * found[other].chi2
