"""How a facility computes: today's sets stay as they were, and each choice does what it says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.bench.test_docking_physics import SCENARIO as DOCKING
from tests.bench.test_independent_rig import FLAT
from tests.equipment.independent_rig import (
    Nuisances,
    Records,
    docking_rig,
    draw_nuisances,
    draw_set,
    nominal_rig,
    overridden,
    silence,
    simulate,
    with_effect,
    with_nuisances,
)
from tests.equipment.independent_rig.nuisances import CHANNELS, shifted

AT_A_KILOHERTZ = {
    "rate": 1000,
    "approach.gap": 0.00151,
    "duration": 0.3,
    "mechanism.contact.damping": 400.0,
}

# Sums of the absolute values of pose_cmd, pose_act, wrench_meas and wrench_comp of all runs, as the
# sets were before they could be drawn with other noise, nuisances and designs; the same bytes then
# gave the same SHA-256.
BEFORE = {
    ("healthy", 4): [5439.399744729424, 5439.333279362924, 167214.974062837, 173700.7327535198],
    ("single", 5): [6653.8143116311785, 6652.995687939143, 107353.47556938953, 112999.18660569409],
    ("pair", 6): [8454.485052181528, 8454.245829622882, 284446.7505502196, 295527.5602531234],
    ("foreign", 7): [6674.6877089777645, 6674.561631776969, 323653.46882732934, 297426.7354965438],
}


@pytest.mark.parametrize(("kind", "seed"), list(BEFORE))
def test_a_seed_draws_the_set_that_it_drew_before_there_were_choices(kind: str, seed: int) -> None:
    hidden = draw_set(np.random.default_rng(seed), kind)  # type: ignore[arg-type]
    sums = [sum(float(np.abs(getattr(r, c)).sum()) for r in hidden.runs) for c in CHANNELS]
    np.testing.assert_allclose(sums, BEFORE[kind, seed], rtol=1e-12)


def test_the_default_is_the_plain_rig_to_the_byte() -> None:
    for rig in (nominal_rig(overridden(FLAT, AT_A_KILOHERTZ)), docking_rig(DOCKING)):
        plain, chosen = (
            simulate(r, silence(rig.ticks)) for r in (rig, with_nuisances(rig, Nuisances()))
        )
        for channel in CHANNELS:
            assert getattr(plain, channel).tobytes() == getattr(chosen, channel).tobytes()
    assert draw_nuisances(np.random.default_rng(1), width=0.0) == Nuisances()


def _flat(
    nuisances: Nuisances, changes: dict | None = None, effects: tuple[dict, ...] = ()
) -> Records:
    rig = nominal_rig(overridden(FLAT, AT_A_KILOHERTZ | (changes or {})))
    for effect in effects:
        rig = with_effect(rig, effect)
    return simulate(with_nuisances(rig, nuisances), silence(rig.ticks))


def test_without_states_of_its_own_a_contact_does_not_depend_on_the_sub_steps() -> None:
    for substeps in (2, 13, 200):
        np.testing.assert_allclose(
            _flat(Nuisances(substeps=substeps)).pose_cmd, _flat(Nuisances()).pose_cmd, atol=1e-12
        )


def test_stiction_depends_on_the_sub_steps_by_less_than_the_way_of_one() -> None:
    stick = ({"kind": "platform.friction", "stick": 2e-4},)
    free = {"approach.gap": 0.02}
    fine, coarse = (_flat(Nuisances(substeps=n), free, stick).pose_act[:, 2] for n in (200, 2))
    assert 1e-6 < np.abs(fine - coarse).max() < 2e-4 + 0.03 * 1e-3


def test_a_reading_taken_before_its_stamp_is_a_delay_of_the_sensor() -> None:
    early = _flat(Nuisances(read=0.4), {"compensation.force.kind": "none"})
    late = _flat(Nuisances(), {"sensor.delay": 0.4e-3, "compensation.force.kind": "none"})
    np.testing.assert_allclose(early.wrench_meas, late.wrench_meas, atol=1e-9)


@pytest.mark.parametrize("six", [False, True])
def test_a_command_that_is_obeyed_late_moves_the_platform_late(six: bool) -> None:
    scenario = overridden(DOCKING, {"rate": 1000, "approach.gap": 0.2, "duration": 0.3})
    rig = (
        docking_rig(scenario)
        if six
        else nominal_rig(overridden(FLAT, AT_A_KILOHERTZ | {"approach.gap": 0.05}))
    )
    found = simulate(with_nuisances(rig, Nuisances(move=0.3)), silence(rig.ticks))
    between = found.pose_cmd[:-2] + 0.7 * (found.pose_cmd[1:-1] - found.pose_cmd[:-2])
    np.testing.assert_allclose(found.pose_act[2:], between, atol=1e-9)


@pytest.mark.parametrize("six", [False, True])
def test_an_encoder_read_before_its_stamp_logs_an_earlier_pose(six: bool) -> None:
    rig = (
        docking_rig(overridden(DOCKING, {"rate": 1000}))
        if six
        else nominal_rig(overridden(FLAT, AT_A_KILOHERTZ))
    )
    now, before = (
        simulate(with_nuisances(rig, Nuisances(encoder=e)), silence(rig.ticks)) for e in (0.0, 0.25)
    )
    expected = now.pose_act[1:] - 0.25 * np.diff(now.pose_act, axis=0)
    np.testing.assert_allclose(before.pose_act[1:], expected, atol=1e-9)
    np.testing.assert_array_equal(before.wrench_meas, now.wrench_meas)  # of the log alone


def test_a_share_of_the_old_twist_is_a_share_of_explicit_euler() -> None:
    """Explicit Euler acts as a delay of one step: ln of the restitution grows by (pi/2) w h, and by
    the share of it.
    """
    quiet = {"mechanism.contact.damping": 0.0, "compensation.force.kind": "none", "duration": 0.5}

    def gain(step: float) -> float:
        pose = _flat(Nuisances(step=step), quiet).pose_cmd[:, 2]
        return math.log(-(pose[-1] - pose[-2]) * 1000 / 0.03)

    w = math.sqrt(1e5 / 400.0)
    assert gain(0.5) - gain(0.0) == pytest.approx(0.5 * 0.5 * math.pi * w * 1e-3, rel=0.05)


def test_the_contacts_rate_is_the_slope_of_the_tick_or_of_half_of_it() -> None:
    """A platform that lags bends its path within a tick: there alone the two differ, by a quarter
    of a tick of its acceleration.
    """
    lag = ({"kind": "platform.lag", "bandwidth": 15.0},)
    tick, fine = (
        _flat(Nuisances(rate=r, substeps=200), {"rate": 250, "duration": 0.6}, lag).physical[:, 2]
        for r in (0.0, 1.0)
    )
    touching = (tick > 0.0) & (fine > 0.0)
    assert 0.1 < np.abs(tick - fine)[touching].max() < 30.0
    same = [_flat(Nuisances(rate=r)).physical for r in (0.0, 1.0)]
    np.testing.assert_allclose(same[0], same[1], atol=1e-6)


@pytest.mark.parametrize(
    ("scheme", "share"),
    [("exact", 1.0 - math.exp(-1.0 / 3.0)), ("semi_implicit", 0.25), ("trapezoidal", 1.0 / 3.5)],
)
def test_schemes_of_the_sensors_lag(scheme: str, share: float) -> None:
    found = _flat(
        Nuisances(scheme=scheme),
        {"compensation.force.kind": "none"},
        ({"kind": "sensor.lag", "time_constant": 3e-3},),
    )  # type: ignore[arg-type]
    y = 0.0
    for k, u in enumerate(found.physical[:, 2]):
        y += (u - y) * share
        assert found.wrench_meas[k, 2] == pytest.approx(y, abs=1e-9)


@pytest.mark.parametrize("scheme", ["exact", "semi_implicit", "trapezoidal"])
def test_schemes_of_the_platforms_lag_meet_where_the_tick_is_finely_divided(scheme: str) -> None:
    lag = ({"kind": "platform.lag", "bandwidth": 20.0},)
    reference = _flat(Nuisances(scheme="exact", substeps=200), None, lag).pose_act[:, 2]
    error = [
        np.abs(
            _flat(Nuisances(scheme=scheme, substeps=n), None, lag).pose_act[:, 2] - reference
        ).max()
        for n in (4, 40)
    ]  # type: ignore[arg-type]
    assert error[0] < 2e-5
    assert error[1] < (2e-6 if scheme == "semi_implicit" else 2e-7)
    if scheme == "semi_implicit":
        assert error[0] / error[1] == pytest.approx(12.0, rel=0.3)  # first order, against 200


def test_the_lever_is_that_of_the_choice() -> None:
    off = {
        "approach.offset": [0.05, 0.0],
        "approach.velocity": [0.004, 0.0, 0.03],
        "mechanism.contact.friction": 0.2,
    }
    arm = []
    for lever in (0.0, 1.0):
        found = _flat(Nuisances(lever=lever), off).physical
        k = int(np.argmax(found[:, 2]))
        arm.append(found[k, 4] + found[k, 2] * _flat(Nuisances(lever=lever), off).pose_act[k, 0])
    assert arm[0] != pytest.approx(arm[1], rel=0.1)  # of the friction


def test_stamps_move_single_channels_by_whole_and_part_rows() -> None:
    base = draw_set(np.random.default_rng(3), "healthy", literal=True)
    moved = draw_set(
        np.random.default_rng(3),
        "healthy",
        literal=True,
        nuisances=Nuisances(stamps={"pose_act": 1.0, "wrench_meas": -0.5}),
    )
    for plain, late, log in zip(base.runs, moved.runs, moved.logs, strict=True):
        np.testing.assert_array_equal(late.pose_act[1:, :3], plain.pose_act[:-1, :3])
        np.testing.assert_allclose(
            late.wrench_meas[:-1], 0.5 * (plain.wrench_meas[:-1] + plain.wrench_meas[1:])
        )
        np.testing.assert_array_equal(late.pose_cmd, plain.pose_cmd)
        np.testing.assert_array_equal(log.pose_act, late.pose_act)


def test_a_shift_of_a_straight_line_is_exact() -> None:
    rows = np.arange(20.0)[:, None] * np.ones((1, 6))
    np.testing.assert_allclose(shifted(rows, 0.3)[1:, 0], np.arange(1.0, 20.0) - 0.3)


def test_choices_are_drawn_from_their_ranges() -> None:
    rng = np.random.default_rng(9)
    drawn = [draw_nuisances(rng) for _ in range(400)]
    substeps = np.array([n.substeps for n in drawn])
    assert substeps.min() == 2
    assert 180 < substeps.max() <= 200
    assert np.median(substeps) == pytest.approx(20.0, rel=0.3)  # evenly by ratio
    levers = np.array([n.lever for n in drawn], dtype=float)
    assert levers.min() < 0.02 < 0.98 < levers.max()
    for name in ("read", "move", "encoder", "step"):
        values = np.array([getattr(n, name) for n in drawn])
        assert 0.0 <= values.min() < 0.02
        assert 0.48 < values.max() <= 0.5
    stamps = [n.stamps for n in drawn]
    rows = np.array([rows for s in stamps for rows in s.values()])
    assert np.mean([len(s) for s in stamps]) == pytest.approx(2.0, rel=0.1)
    assert np.abs(rows).max() <= 1.0
    assert 0.3 < np.mean(rows == np.round(rows)) < 0.7
    narrow = [draw_nuisances(np.random.default_rng(s), width=0.2) for s in range(200)]
    assert max(n.substeps for n in narrow) <= 32
    assert max(n.move for n in narrow) <= 0.1
    assert replace(narrow[0], substeps=3) != narrow[0]
