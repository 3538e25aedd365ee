"""The second rig: closed forms, records of a third one, effects that stay in their link."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hiltestbed.config.gallery import shipped
from hiltestbed.config.yaml_source import read_source
from tests.equipment.independent_rig import (
    EFFECTS,
    FOREIGN,
    NEEDS,
    PLAIN,
    SIZES,
    Facility,
    Records,
    draw_effects,
    draw_facility,
    link_of,
    nominal_rig,
    overridden,
    rig_of,
    silence,
    simulate,
    with_effect,
)
from tests.slow import ALL

FLAT = overridden(
    read_source(shipped("scenarios") / "reference-bumper.yaml").data,
    {
        "rate": 8000,
        "duration": 0.5,
        "approach.gap": 0.00151,
        "mechanism.contact.damping": 400.0,
        "sensor.delay": 0.0,
        "compensation.force": {"kind": "none"},
    },
)
REDUCED = 400.0  # kg
SPEED = 0.03


def _quiet(changes: dict | None = None, effects: tuple[dict, ...] = ()) -> Records:
    rig = nominal_rig(overridden(FLAT, changes or {}))
    for effect in effects:
        rig = with_effect(rig, effect)
    return simulate(rig, silence(rig.ticks))


@pytest.mark.parametrize("damping", [0.0, 400.0, 2000.0])
def test_restitution_without_delay_is_the_closed_form_of_a_separation_at_no_force(
    damping: float,
) -> None:
    records = _quiet({"mechanism.contact.damping": damping})
    rebound = -(records.pose_cmd[-1, 2] - records.pose_cmd[-2, 2]) * 8000 / SPEED
    z = damping / (2.0 * math.sqrt(1e5 * REDUCED))
    s = math.sqrt(1.0 - z * z)
    # The integrator is of first order: its error is of the order of c h/mu.
    assert rebound == pytest.approx(
        math.exp(-(z / s) * (math.pi - math.atan2(2.0 * z * s, 1.0 - 2.0 * z * z))),
        abs=2e-4 + damping / REDUCED / 8000,
    )


def test_a_pure_delay_gives_the_series_of_the_delayed_oscillator() -> None:
    delay = 0.005
    records = _quiet({"mechanism.contact.damping": 0.0, "sensor.delay": delay})
    t = np.arange(1, len(records.pose_cmd) + 1) / 8000 - 0.00151 / SPEED  # since the touch
    w2, x = 1e5 / REDUCED, np.zeros(len(t))
    for n in range(40):
        late = np.maximum(t - n * delay, 0.0)
        x += SPEED * (-w2) ** n * late ** (2 * n + 1) / math.factorial(2 * n + 1)
    inside = (t > 0.0) & (np.cumsum((t > 0.0) & (x < 0.0)) == 0)
    assert inside.sum() > 1000
    # of 1.9 mm: semi-implicit Euler at 8 kHz
    assert np.abs(records.pose_cmd[inside, 2] - x[inside]).max() < 2e-6


def test_momentum_is_kept_and_free_bodies_fly_straight_off_centre_too() -> None:
    records = _quiet({"approach.offset": [0.1, -0.05], "approach.rate_deg": [0.0, 0.0, 0.5]})
    before = records.pose_cmd[:300]
    np.testing.assert_allclose(np.diff(before[:, 2]) * 8000, SPEED, rtol=1e-9)
    # Turning about z with the target at rest: the quaternion's z part grows with half the angle.
    np.testing.assert_allclose(
        before[:, 5], np.sin(0.5 * np.radians(0.5) * np.arange(1, 301) / 8000), atol=1e-12
    )


DELAYED = {"sensor.delay": 0.002}


def test_the_reading_is_the_physical_wrench_late() -> None:
    records = _quiet(DELAYED, ({"kind": "sensor.delay", "delay": 0.001},))
    np.testing.assert_allclose(records.wrench_meas[24:], records.physical[:-24], atol=1e-7)
    assert not records.wrench_meas[:24].any()


CLOSED: dict[str, tuple[dict, Callable[[Records], tuple]]] = {
    "sensor.gain": (
        {"factor": 1.1, "axis": "z"}, lambda r: (r.wrench_meas[:, 2], 1.1 * r.physical[:, 2]),
    ),
    "sensor.crosstalk": (
        {"ratio": 0.03, "source": "z", "axis": "x"},
        lambda r: (r.wrench_meas[:, 0], 0.03 * r.physical[:, 2]),
    ),
    "sensor.saturation": (
        {"limit": 50.0}, lambda r: (r.wrench_meas[:, 2], np.minimum(r.physical[:, 2], 50.0)),
    ),
    "sensor.deadzone": ({"width": 30.0}, lambda r: (r.wrench_meas[:, 2], _dead(r.physical[:, 2]))),
    "sensor.drift": (
        {"rate": 2.0, "axis": "y"}, lambda r: (r.wrench_meas[:, 1], 2.0 * np.arange(4000) / 8000),
    ),
    "contact.preload": ({"force": 12.0}, lambda r: (r.physical[:, 2], _spring(r, preload=12.0))),
    "contact.stiffness": (
        {"factor": 0.8}, lambda r: (r.physical[:, 2], _spring(r, stiffness=8e4)),
    ),
    "contact.touch_offset": (
        {"offset": 2e-4}, lambda r: (r.physical[:, 2], _spring(r, offset=2e-4)),
    ),
    # k, c times 1/(1 + k/K)
    "frame.compliance": ({"stiffness": 9e5}, lambda r: (r.physical[:, 2], 0.9 * _spring(r))),
    # no slip
    "contact.surface_friction": (
        {"coefficient": 0.2}, lambda r: (r.physical[:, 0], 0.0 * r.physical[:, 2]),
    ),
    "platform.scale": (
        {"factor": 1.05, "axis": "z"}, lambda r: (r.pose_act[1:, 2], 1.05 * r.pose_cmd[:-1, 2]),
    ),
    "platform.delay": ({"delay": 0.002}, lambda r: (r.pose_act[17:, 2], r.pose_cmd[:-17, 2])),
    "loop.deadzone": ({"width": 30.0}, lambda r: (r.wrench_comp[:, 2], _dead(r.used[:, 2]))),
    "log.skew": ({"delay": 0.002}, lambda r: (r.wrench_meas[16:, 2], r.used[:-16, 2])),
}  # fmt: skip
"""Of an effect: its parameters, and records that are to be equal under it."""


def _dead(force: np.ndarray) -> np.ndarray:
    return np.where(force < 30.0, 0.0, force)


def _spring(
    r: Records, stiffness: float = 1e5, offset: float = 0.0, preload: float = 0.0
) -> np.ndarray:
    z = r.pose_act[:, 2] - offset
    v = np.diff(r.pose_act[:, 2], prepend=r.pose_act[0, 2] - SPEED / 8000) * 8000
    return np.where(z > 0.0, np.maximum(stiffness * z + 400.0 * v + preload, 0.0), 0.0)


@pytest.mark.parametrize("name", CLOSED)
def test_an_effect_does_what_its_definition_says(name: str) -> None:
    size, equal = CLOSED[name]
    found, expected = equal(_quiet(None, ({"kind": name, **size},)))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_damping_that_grows_with_the_force_dissipates_while_a_latch_pushes_and_while_it_pulls() -> (
    None
):
    """Of Hunt-Crossley, y - ln(1 + y) of y = alpha v before a half swing is that of y = -alpha v
    after it, whichever way the latch is
    loaded: dv/dx = -k x (1 + alpha v) / (m v).
    """
    alpha = 8.0
    latched = {"mechanism.kind": "latched", "approach.gap": 0.0, "duration": 1.2}
    z = _quiet(latched, ({"kind": "contact.hunt_crossley", "alpha": alpha},)).pose_act[:, 2]
    through = np.flatnonzero(z[1:-1] * z[2:] <= 0.0) + 1
    y = alpha * np.abs(z[through + 1] - z[through]) * 8000
    assert len(y) >= 4
    np.testing.assert_allclose(y[:-1] - np.log1p(y[:-1]), -y[1:] - np.log1p(-y[1:]), rtol=1e-2)


def test_an_appendage_keeps_the_momentum_of_the_whole_body() -> None:
    slosh = {
        "kind": "dynamics.appendage",
        "mass_ratio": 0.2,
        "frequency": 3.0,
        "damping_ratio": 0.2,
        "body": "chaser",
    }
    rig = with_effect(nominal_rig(overridden(FLAT, {"duration": 2.0})), slosh)
    push = np.zeros((rig.ticks, 6))
    push[:80, 2] = 100.0  # 1 N s
    pose = simulate(rig, silence(rig.ticks), wrench_comp=push).pose_cmd[:, 2]
    # When it has come to rest the appendage moves with the body: as if it were a part of it.
    assert (pose[-1] - pose[-2]) * 8000 == pytest.approx(SPEED - 1.0 / REDUCED, abs=2e-5)


CHANGED = {
    "platform": {"pose_act", "wrench_meas", "wrench_comp"},
    "contact": {"wrench_meas", "wrench_comp"},
    "sensor": {"wrench_meas", "wrench_comp"},
    "compensation": {"wrench_comp"},
    "dynamics": {"pose_cmd"},
    "log": {"wrench_meas"},
}


def changed_by(facility: Facility, effects: list[dict], rng: np.random.Generator) -> set[str]:
    """Channels that the nominal links, each on what a rig with these effects recorded as its input,
    give otherwise than that rig.
    """
    rig, healthy = (rig_of(facility, 3, e, PLAIN) for e in (effects, []))
    noise = silence(rig.ticks)._replace(
        delay=rng.standard_normal(rig.ticks), repeat=rng.random(rig.ticks)
    )
    records = simulate(rig, noise)
    replayed = simulate(healthy, noise, pose_cmd=records.pose_cmd, wrench_comp=records.wrench_comp)
    floors = {"pose_cmd": 1e-9, "pose_act": 1e-9, "wrench_meas": 1e-4, "wrench_comp": 1e-3}
    return {
        c
        for c, floor in floors.items()
        if np.abs(getattr(records, c) - getattr(replayed, c)).max() > floor
    }


@pytest.mark.parametrize(
    "name", [*EFFECTS, *FOREIGN] if ALL else {link_of(n): n for n in (*FOREIGN, *EFFECTS)}.values()
)
def test_an_effect_changes_what_its_link_gives_and_nothing_else(name: str) -> None:
    rng = np.random.default_rng(11)
    facility = draw_facility(rng, frozenset({"slide"}) | NEEDS.get(name, frozenset()))
    effects = draw_effects(rng, (name,), facility)
    assert changed_by(facility, effects, rng) == CHANGED[link_of(name)]


def test_every_effect_has_a_size_and_the_touch_falls_between_ticks() -> None:
    assert set(SIZES) == set(EFFECTS)
    facility = draw_facility(np.random.default_rng(6), frozenset({"slide"}))
    for changes, speed in zip(facility.runs, facility.speeds, strict=True):
        assert 0.2 < (changes["approach.gap"] / speed * facility.scenario["rate"]) % 1.0 < 0.8
