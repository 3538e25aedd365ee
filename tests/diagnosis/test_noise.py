"""Noise of the force from free flight: what is there is found with its size, and what is not there
is not.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import f as fisher

from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.diagnosis.floors import floors, white_outside
from hiltestbed.diagnosis.free_flight import TOUCH_MARGIN_ROWS, first_touch, readings_apart
from hiltestbed.diagnosis.noise import ForceNoise, force_noise, softened
from hiltestbed.diagnosis.nuisances import Aside, tones_of, wander_between
from hiltestbed.diagnosis.settings import SIGNIFICANCE_LEVEL, SIGNIFICANT
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredRun, load_dataset
from tests.measured.bounce import columns, write_dataset

ROWS, TOUCH, END, RUNS = 600, 300, 500, 6
SIGMA = np.array([0.2, 0.2, 0.3, 0.02, 0.02, 0.01])  # [N, N m]
ALONG = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def read(reading: Array, contact: np.ndarray, moved: Array | None = None) -> MeasuredRun:
    """A run of these readings (ROWS, 6), with one stretch of rows in ``contact``; where A ``moved``
    [m] along z, it is held by a latch throughout.
    """
    poses = {f"pose_act.{part}": np.zeros(ROWS) for part in ("px", "py", "pz", "qx", "qy", "qz")}
    rows = np.flatnonzero(contact)
    record: Any = SimpleNamespace(
        data={"wrench_meas": reading}, ticks=ROWS, has=lambda name: True, steps={},
        column=(poses if moved is None else poses | {"pose_act.pz": moved}).__getitem__,
    )  # fmt: skip
    survey: Any = SimpleNamespace(
        contacts=[SimpleNamespace(start=rows[0], end=rows[-1] + 1)],
        touching=lambda rows, late: contact,
        excited=() if moved is None else ("pose_act.pz",),
    )
    scenario: Any = SimpleNamespace(
        sensor=SimpleNamespace(delay=0.0, quantisation=0.0),
        rate=1000.0,
        mechanism=SimpleNamespace(captured=moved is not None, mount=None),
    )
    return MeasuredRun(record, scenario, survey)  # type: ignore[arg-type]


def run(noise: Array, touch: int = TOUCH) -> MeasuredRun:
    """Free flight, half a sine of 150 N along z, free flight."""
    t = np.arange(ROWS)
    inside = (t >= touch) & (t < END)
    force = 150.0 * np.sin(np.pi * (t - touch) / (END - touch)) * inside
    return read(noise + np.outer(force, ALONG), inside)


def latched(noise: Array, crosstalk: float = 0.0) -> MeasuredRun:
    """A latched mechanism that rings along z from the first row on; the force along x shows a part
    of it.
    """
    t = np.arange(ROWS)
    ringing = 150.0 * np.exp(-t / 300.0) * np.sin(0.1 * t)
    shown = ringing[:, None] * np.array([crosstalk, 0.0, 1.0, 0.0, 0.0, 0.0])
    return read(noise + shown, np.ones(ROWS, dtype=bool), 1e-5 * ringing)


def coloured(seed: int, correlation: float) -> list[Array]:
    """First-order noise, of the variance of the white one."""
    part = np.sqrt(1 - correlation**2)
    return [np.asarray(lfilter([part], [1, -correlation], n, axis=0)) for n in white(seed)]


def swaying(rng: np.random.Generator, size: float) -> list[Array]:
    """Baselines (ROWS, 6) of each run, of a period longer than the run [sigma]."""
    t = np.linspace(0.0, 1.0, ROWS)[:, None]
    turns = [(rng.uniform(0.25, 0.75, 6), rng.uniform(-np.pi, np.pi, 6)) for _ in range(RUNS)]
    return [size * SIGMA * np.sin(2 * np.pi * w * t + phase) for w, phase in turns]


def white(seed: int) -> list[Array]:
    rng = np.random.default_rng(seed)
    return [SIGMA * rng.standard_normal((ROWS, 6)) for _ in range(RUNS)]


def found(noise: list[Array]) -> ForceNoise:
    return force_noise([run(n) for n in noise])


def left_by(noise: ForceNoise, values: Array) -> Array:
    """What the nuisances of the noise leave of ``values`` (ROWS, 6)."""
    nuisances = noise.nuisances(ROWS, ROWS, noise.level)
    return values - Aside(np.full((ROWS, 6), 1.0 / SIGMA), nuisances).of(values)


def test_white_noise_needs_no_words() -> None:
    for noise in map(found, map(white, range(8))):
        assert noise.words() == ()
        assert not noise.level.any()


@pytest.mark.parametrize("correlation", [0.1, 0.6])
def test_colour_is_that_of_a_first_order_process(correlation: float) -> None:
    """Its spectral density at low frequency is (1 + r)/(1 - r) times that of white noise of the
    same variance.
    """
    noise = found(coloured(1, correlation))
    assert noise.colour == pytest.approx(np.sqrt((1 + correlation) / (1 - correlation)), rel=0.12)
    np.testing.assert_allclose(noise.level, SIGMA, rtol=0.1)


@pytest.mark.parametrize("crosstalk", [0.0, 0.05])
def test_a_mechanism_that_never_flies_shows_its_noise_on_the_axes_at_rest(crosstalk: float) -> None:
    """Also where they show a part of what the axis that moves does; its own noise is known in third
    differences alone, which a colour of r makes smaller by sqrt((20 - 30 r + 12 r^2 - 2 r^3) / 20).
    """
    correlation = 0.6
    noise = force_noise([latched(n, crosstalk) for n in coloured(1, correlation)])
    assert noise.colour == pytest.approx(np.sqrt((1 + correlation) / (1 - correlation)), rel=0.12)
    np.testing.assert_allclose(noise.level, SIGMA, rtol=0.15)
    assert force_noise([latched(n, crosstalk) for n in white(2)]).words() == ()


def test_the_baseline_of_an_axis_at_rest_wanders_though_that_of_the_axis_that_moves_looks_alike() -> (
    None
):
    sways = swaying(np.random.default_rng(13), 2.0)
    noise = force_noise([latched(n + s) for n, s in zip(white(13), sways, strict=True)])
    assert (len(noise.wander) - 1, noise.tones) == (5, ())


def test_a_drift_that_the_springs_of_a_latch_balance_shows_in_what_their_path_leaves_of_the_reading() -> (
    None
):
    """The loop moves the numerical model until the sensor reads nothing: the springs then carry the
    drift with the other sign.
    """
    runs = [latched(n) for n in white(14)]
    assert force_noise(runs).words() == ()
    noise = force_noise(runs, None, [-s for s in swaying(np.random.default_rng(14), 4.0)])
    # the rest of it is white
    assert (len(noise.wander) - 1, noise.colour, noise.tones, noise.level.any()) == (
        5,
        1.0,
        (),
        False,
    )


def test_a_run_without_forces_leaves_the_noise_to_the_others() -> None:
    runs, blind = [latched(n) for n in coloured(1, 0.6)], latched(white(1)[0])
    blind.record.data, blind.record.has = {}, lambda name: name[0] == "p"  # type: ignore[misc]
    alone, beside = force_noise(runs), force_noise([*runs, blind])
    assert alone.level.all()
    np.testing.assert_array_equal(beside.level, alone.level)


def test_tones_in_a_short_flight_do_not_lower_the_level() -> None:
    """Four tones take nine of the hundred readings of a flight with them: 5 % of the deviation,
    which all rows without contact show.
    """
    t = np.arange(ROWS)[:, None] * 1e-3
    levels = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        runs = []
        for n in white(seed):
            hum = sum(
                2.0 / k * np.sin(2 * np.pi * 50.0 * k * t + rng.uniform(-np.pi, np.pi, 6))
                for k in (1, 2, 3, 5)
            )
            runs.append(run(n + SIGMA * hum, touch=100))
        noise = force_noise(runs)
        assert len(noise.tones) >= 3
        levels.append(noise.level / SIGMA)
    assert np.mean(levels) == pytest.approx(1.0, abs=0.02)  # 12 sets of 6 channels: 0.6 % by chance


def test_a_hum_a_drift_and_a_bias_that_all_runs_share_are_no_noise() -> None:
    t = np.arange(ROWS)[:, None] * 1e-3
    shared = 2.0 * np.sin(2 * np.pi * 61.0 * t + 0.4) + 3.0 * t + 0.5
    assert found([n + shared * SIGMA for n in white(2)]).words() == ()


def test_an_offset_of_each_run_is_taken_out_but_for_what_they_share() -> None:
    rng = np.random.default_rng(3)
    apart = rng.standard_normal((RUNS, 6)) * SIGMA
    noise = found([n + 2.0 * SIGMA + o for n, o in zip(white(3), apart, strict=True)])
    np.testing.assert_allclose(
        np.array(noise.offset),
        apart - apart.mean(axis=0),
        atol=4 * 2 * SIGMA.max() / np.sqrt(TOUCH),
    )


def test_what_all_runs_share_of_offsets_that_differ_is_no_bias_where_chance_makes_as_much_of_them() -> (
    None
):
    rng = np.random.default_rng(8)
    apart = rng.standard_normal((RUNS, 6)) * SIGMA
    noise = found([n + o for n, o in zip(white(8), apart, strict=True)])
    assert (len(noise.wander) - 1, np.abs(noise.offset).max()) == (0, 0.0)


@pytest.mark.parametrize(("runs", "channels"), [(1, 1), (2, 1), (1, 2), (1, 6), (3, 6)])
def test_white_noise_has_no_tones_however_few_the_readings(runs: int, channels: int) -> None:
    """The largest of a thousand values of one periodogram is ten times their median: a fixed ratio
    finds tones in half of all records.
    """
    rng = np.random.default_rng(runs + 10 * channels)
    for n in (100, 300, 1500):
        for _ in range(40):
            assert tones_of([rng.standard_normal((n, channels)) for _ in range(runs)]) == []
    hum = 0.5 * np.sin(0.7 * np.arange(1500) + 1.0)[:, None]
    (w,) = tones_of([rng.standard_normal((1500, channels)) + hum for _ in range(runs)])
    assert w == pytest.approx(0.7, abs=np.pi / 1500)


def test_mains_of_another_phase_in_each_run_are_tones_and_their_frequency_is_told_to_a_part_of_a_turn() -> (
    None
):
    rng = np.random.default_rng(9)
    t = np.arange(ROWS)[:, None] * 1e-3
    hum = [
        SIGMA * np.sin(2 * np.pi * 50.0 * t + rng.uniform(-np.pi, np.pi, 6)) for _ in range(RUNS)
    ]
    noise = found([n + h for n, h in zip(white(9), hum, strict=True)])
    assert len(noise.tones) == 1
    assert noise.tones[0] * ROWS / (2 * np.pi) == pytest.approx(50.0 * ROWS * 1e-3, abs=0.1)
    np.testing.assert_allclose(noise.level, SIGMA, rtol=0.1)
    assert np.std(left_by(noise, hum[0])) < 0.1 * np.std(hum[0])


def test_a_baseline_that_bends_otherwise_in_each_run_wanders_and_a_quintic_takes_nearly_all_of_it() -> (
    None
):
    sways = swaying(np.random.default_rng(10), 4.0)
    noise = found([n + s for n, s in zip(white(10), sways, strict=True)])
    assert noise.wander.shape == (6, 6)
    one = sways[0] - sways[0].mean(axis=0)
    assert np.std(left_by(noise, one)) < 0.05 * np.std(one)


def test_a_baseline_that_rows_close_together_hardly_tell_has_a_finite_spread() -> None:
    """Sixty rows in a twentieth of a record: the higher terms are known to round-off only, and
    differ by no more than that.
    """
    rng = np.random.default_rng(6)
    free = [(np.linspace(0.9, 1.0, 60), 0.1 * rng.standard_normal((60, 3))) for _ in range(RUNS)]
    spread = wander_between(free, np.full(3, 0.1))
    assert spread is None or np.isfinite(spread).all()


def test_misfits_are_whitened_by_the_covariance_of_noise_and_nuisances() -> None:
    rng = np.random.default_rng(21)
    weight, columns, left = (
        rng.uniform(0.0, 3.0, (40, 2)),
        rng.standard_normal((40, 2, 3)),
        rng.standard_normal((40, 2)),
    )
    weight[5] = 0.0  # not measured
    aside, raised = Aside(weight, columns), 0.0
    white = (left - aside.of(left)) * weight
    for c in range(2):
        terms, misfit = columns[:, c] * weight[:, c, None], left[:, c] * weight[:, c]
        covariance = np.eye(40) + terms @ terms.T
        assert white[:, c] @ white[:, c] == pytest.approx(
            misfit @ np.linalg.solve(covariance, misfit)
        )
        raised += 0.5 * np.linalg.slogdet(covariance)[1]
    assert aside.log_determinant == pytest.approx(raised)


@pytest.mark.parametrize("runs", [3, 6])
def test_of_baselines_that_wander_what_they_share_shows_beyond_their_spread(runs: int) -> None:
    """The square of what they share, over its variance, exceeds that of significance as rarely as
    chi-square would.
    """
    rng, at = np.random.default_rng(22), np.linspace(-1.0, 1.0, 400)
    bend = at[:, None] ** 2 - 1.0 / 3.0
    found = []
    for _ in range(400):
        sway = rng.standard_normal((2, runs, 6))
        readings = [
            0.01 * rng.standard_normal((400, 6)) + a + b * bend for a, b in zip(*sway, strict=True)
        ]
        wander = wander_between([(at, x) for x in readings], np.full(6, 0.01))
        found.append(
            runs * np.mean([x.mean(axis=0) for x in readings], axis=0) ** 2 / wander[0] ** 2
        )
    assert np.max(found) < SIGNIFICANT  # 2400 draws at a level of 3e-5
    assert np.mean(
        np.array(found)
        > SIGNIFICANT * fisher.isf(0.05, 1, runs - 1) / fisher.isf(SIGNIFICANCE_LEVEL, 1, runs - 1)
    ) == pytest.approx(0.05, abs=0.02)


def test_a_share_of_the_reading_is_found_with_its_size_and_a_delay_that_varies_is_none() -> None:
    rng, share = np.random.default_rng(4), 0.01
    t = np.arange(ROWS)
    inside, phase = (t > TOUCH) & (t < END), np.pi * (t - TOUCH) / (END - TOUCH)
    force = 150.0 * np.sin(phase) * inside
    rate = 150.0 * np.pi / (END - TOUCH) * np.cos(phase) * inside

    def of(size: Array, seed: int) -> float:
        return found(
            [n + np.outer(size * rng.standard_normal(ROWS), ALONG) for n in white(seed)]
        ).share

    assert of(share * force, 4) == pytest.approx(share, rel=0.15)
    assert of(0.7 * rate, 5) < 0.1 * share


def test_outliers_after_the_contact_count_where_few_rows_lie_before_it_and_ringing_is_none() -> (
    None
):
    rng, t = np.random.default_rng(31), np.arange(ROWS)[:, None]
    behind = t > END + 0.25 * (ROWS - END)
    spiked = [n + SIGMA * 20.0 * (behind & (rng.random((ROWS, 6)) < 0.01)) for n in white(31)]
    assert found(spiked).heavy
    ringing = [
        n + SIGMA * 40.0 * np.where(t > END, np.exp(-(t - END) / 60.0) * np.sin(0.7 * t), 0.0)
        for n in white(32)
    ]
    assert not found(ringing).heavy
    assert not found(white(33)).heavy


def test_outliers_count_by_their_logarithm_and_the_level_allows_for_them() -> None:
    rng = np.random.default_rng(6)
    spiked = [n + SIGMA * 20.0 * (rng.random((ROWS, 6)) < 0.005) for n in white(6)]
    noise = found(spiked)
    assert noise.heavy
    free = np.concatenate([s[: TOUCH - 10] for s in spiked]) / noise.level
    assert np.mean(softened(free, True) ** 2) == pytest.approx(1.0, rel=0.05)
    z = np.linspace(-2.0, 2.0, 9)
    assert np.array_equal(softened(z, False), z)
    assert softened(np.array([50.0]), True)[0] ** 2 < 60.0
    # a descent from afar still feels its way
    assert np.all(np.diff(softened(np.linspace(-50, 50, 101), True)) > 0.0)


@pytest.mark.parametrize(("stated", "told"), [(0.0, 2.0), (1.0, 2.0), (2.0, 0.0), (2.01, 0.0)])
def test_steps_that_the_scenario_does_not_state_are_told(stated: float, told: float) -> None:
    runs = [run(n) for n in white(8)]
    for one in runs:
        one.record.steps["wrench_meas.fz"] = 2.0
        one.survey.noise = {"wrench_meas.fz": SimpleNamespace(white=0.3)}  # type: ignore[misc]
        one.scenario.sensor.quantisation = stated  # type: ignore[misc]
    noise = force_noise(runs)
    assert noise.step == told
    assert any("steps of 2 N" in words for words in noise.words()) == bool(told)


def test_too_short_a_flight_tells_nothing() -> None:
    assert force_noise([run(n) for n in white(7)[:0]]).words() == ()


@pytest.mark.parametrize("free", [31, 100])
def test_few_free_rows_leave_the_noise_to_all_of_them(free: int) -> None:
    """31 rows know it to a quarter, 1600 to 4 %; three differences take a contact out. Where all
    are noisier than chance, the few tell.
    """
    values = 50.0 * np.sin(np.linspace(0.0, 20.0, 1600)) + np.random.default_rng(3).standard_normal(
        1600
    )
    assert white_outside(values[:free], values) == pytest.approx(1.0, abs=0.08)
    values[free:] += 5.0 * np.random.default_rng(4).standard_normal(1600 - free)
    assert white_outside(values[:free], values) == pytest.approx(1.0, abs=0.6)


@pytest.mark.parametrize("lost", [(), (20, 45, 70)], ids=["every row", "rows lost"])
def test_noise_that_a_dead_zone_hides_is_taken_from_the_contact(
    lost: tuple[int, ...], tmp_path: Path
) -> None:
    table = columns(force_noise=0.1)
    table["wrench_meas.fz"] *= np.abs(table["wrench_meas.fz"]) > 20.0
    kept = np.setdiff1d(np.arange(len(table["t"])), lost)
    data = load_dataset(
        write_dataset(tmp_path, {name: values[kept] for name, values in table.items()})
    )
    assert floors(data.runs)["wrench_meas.fz"] == pytest.approx(0.1, rel=0.25)


@pytest.mark.parametrize("hum", [0.0, 1.6])
def test_a_touch_before_the_believed_one_is_no_free_flight(hum: float) -> None:
    """A spring that is met 30 rows early, beside a hum: the level is nearly what it is without, and
    not that of the spring.
    """
    rows = np.arange(ROWS)
    wave = hum * np.sin(0.314 * rows)
    # [N] up to 24 N
    early = np.where((rows > TOUCH - 30) & (rows <= TOUCH), 0.8 * (rows - TOUCH + 30), 0.0)
    met = [n + np.outer(early + wave, ALONG) for n in white(8)]
    flat = [n + np.outer(wave, ALONG) for n in white(8)]
    # 3 rows are within the hum
    assert found(met).levels() == pytest.approx(found(flat).levels(), rel=0.2)
    assert [first_touch(run(n)) for n in met] == pytest.approx([TOUCH - 30] * RUNS, abs=8)


def test_free_flight_begins_when_a_mount_has_swung_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven time constants, here of 4 ms, after a reading without a mount would be free: 50 ms
    after the contact.
    """
    plain = run(np.zeros((ROWS, 6)))
    survey: Any = SimpleNamespace(
        contacts=plain.survey.contacts,
        touching=lambda rows, late: (np.arange(rows) >= TOUCH) & (np.arange(rows) < END + late),
    )
    plain = MeasuredRun(plain.record, plain.scenario, survey)
    assert [int(r[r > TOUCH][0]) for r, _ in [readings_apart(plain, [2])]] == [END + 50]
    monkeypatch.setattr(
        MountDynamics, "of", lambda scenarios: SimpleNamespace(slowest=lambda: 0.004)
    )
    assert [int(r[r > TOUCH][0]) for r, _ in [readings_apart(plain, [2])]] == [END + 50 + 28]


def test_a_baseline_that_wanders_up_to_a_touch_is_free_flight() -> None:
    bend = 3.0 * np.sin(np.linspace(0.0, 3.0, ROWS))[:, None]  # [N], ten times the noise
    assert [first_touch(run(n + bend)) for n in white(9)] == [TOUCH - TOUCH_MARGIN_ROWS] * RUNS
