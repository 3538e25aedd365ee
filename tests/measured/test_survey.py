"""What one run holds, from its contacts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.measured.noise import white_noise
from hiltestbed.measured.record import Record
from hiltestbed.measured.survey import ContactSpan, Survey, look
from hiltestbed.scenario import Scenario, load_scenario


def _record(scenario: Scenario, pz: np.ndarray, **forces: np.ndarray) -> Record:
    """A record of a reached pose that moves along z alone, and of forces with noise of 1 N."""
    rows = len(pz)
    pose, wrench = np.zeros((rows, 7)), np.random.default_rng(1).standard_normal((rows, 6))
    pose[:, 2], pose[:, 6] = pz, 1.0
    for name, force in forces.items():
        wrench[:, ("fx", "fy", "fz").index(name)] += force
    data = {"pose_act": pose, "wrench_meas": wrench}
    valid = {group: np.ones(values.shape, bool) for group, values in data.items()}
    return Record(1, Path(), np.arange(rows) / scenario.rate, data, valid)


@pytest.mark.parametrize("peak", [200.0, -200.0, None])
def test_what_pulls_touches_as_well_as_what_pushes(peak: float | None) -> None:
    contact = ContactSpan(10, 20, peak, 1e-3, None, None if peak is None else abs(peak))
    survey = Survey(0, {}, (contact,), ())
    assert survey.touching(40, late=4, least=50.0).sum() == 10 + 2 + 4 + 3
    assert survey.touching(40, late=4, least=500.0).any() == (peak is None)


@pytest.mark.parametrize("leaves", [False, True])
def test_what_a_latch_holds_stays_in_contact_while_its_force_passes_through_zero(
    leaves: bool,
) -> None:
    scenario = load_scenario("09-docking")
    assert scenario.mechanism.latch is not None
    t = np.arange(8000) / scenario.rate
    ring = np.where(t > 1.0, np.exp(-(t - 1.0)) * np.sin(2.0 * np.pi * 2.0 * (t - 1.0)), 0.0)
    depth = np.where(t < 1.0, 0.02 * (t - 1.0), 1e-3 * ring)
    if leaves:
        depth = np.where(t > 3.5, -0.06 * (t - 3.5), depth)
        ring = ring * (t < 3.5)
    contacts = look(_record(scenario, depth, fz=400.0 * ring), scenario).contacts
    if leaves:  # out of the latch's reach at the end: it held nothing
        assert len(contacts) > 2
    else:
        assert len(contacts) == 1
        assert abs(contacts[0].start - 2000) < 10
        assert contacts[0].end == 8000


def test_a_tilted_port_that_is_met_in_the_first_rows_before_the_pose_says_so() -> None:
    """Beside the axis a tilt of 2 degrees brings a plane 5 mm nearer: it is met while pz says that
    there is a gap, as the record begins.
    """
    scenario = load_scenario("02-bumper")
    assert scenario.mechanism.flat
    t = np.arange(1400) / scenario.rate
    force = np.where((t > 0.004) & (t < 0.1), 300.0 * np.sin(np.pi * (t - 0.004) / 0.096), 0.0)
    pz = -0.0048 + 0.04 * np.minimum(t, 0.05) - 0.04 * np.maximum(t - 0.05, 0.0)
    found = look(_record(scenario, pz, fz=force), scenario)
    # the force is 10 times its noise, with two sigma to spare, after 1 ms
    late = 2.5e-3 * scenario.rate
    (contact,) = found.contacts
    assert abs(found.free - 0.004 * scenario.rate) < late
    assert abs(contact.start - 0.004 * scenario.rate) < late
    assert abs(contact.end - 0.1 * scenario.rate) < late


@pytest.mark.parametrize(("name", "found"), [("16-probe-drogue", 1), ("02-bumper", 0)])
def test_what_swings_on_its_side_is_in_contact_where_it_is_pressed_across(
    name: str, found: int
) -> None:
    """A head on a rod that stays in its socket, the stroke at rest; a plane is pressed along its
    normal.
    """
    scenario, rows = load_scenario(name), np.arange(2000)
    survey = look(_record(scenario, rows * 0.0 - 0.05, fx=60.0 * (rows > 999)), scenario)
    assert len(survey.contacts) == found
    assert survey.touching(len(rows), 0, least=30.0)[1500] == bool(found)


@pytest.mark.parametrize("speed", [0.037, 3.3])
@pytest.mark.parametrize("noise", [0.4, 1.0])
def test_the_noise_of_a_quantised_motion_is_that_of_its_samples_and_of_its_steps(
    speed: float, noise: float
) -> None:
    """Independent of each other where noise dithers the steps; third differences of them are whole
    steps, and so is their median.
    """
    rng = np.random.default_rng(6)
    read = np.round(speed * np.arange(6000) + noise * rng.standard_normal(6000))
    found = white_noise(1e-5 * read, 1e-5)
    assert found == pytest.approx(1e-5 * np.hypot(noise, 1.0 / np.sqrt(12.0)), rel=0.05)
    read[3000] += 50.0
    assert white_noise(1e-5 * read, 1e-5) == pytest.approx(found, rel=0.02)


def _command(pz: np.ndarray, step: float) -> Record:
    """A record at 1 kHz of a command along z, rounded to steps."""
    pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(pz), 1))
    pose[:, 2] = step * np.round(pz / step)
    valid = {"pose_cmd": np.ones(pose.shape, dtype=bool)}
    t = 0.001 * np.arange(len(pz), dtype=np.float64)
    return Record(1, Path(), t, {"pose_cmd": pose}, valid, steps={"pose_cmd.pz": step})


def test_a_command_in_steps_is_smooth_where_it_creeps_and_jumps_where_it_was_told_to() -> None:
    """A slow ramp keeps within a step of what was rounded, and within less where it moves; a hold
    stays what it is up to its jump.
    """
    t, step = np.arange(4000, dtype=np.float64) * 0.001, 1e-4
    creep = np.where(t < 2.0, 0.004 * t, 0.008)
    told = creep + np.where(t >= 2.5, 0.05, 0.0) + np.where(t >= 3.2, -0.02, 0.0)
    record = _command(told, step)
    filled = record.filled("pose_cmd")[:, 2]
    np.testing.assert_allclose(filled, told, atol=1.01 * step)
    np.testing.assert_allclose(filled[100:1900], told[100:1900], atol=0.1 * step)
    np.testing.assert_array_equal(filled[2400:], record.column("pose_cmd.pz")[2400:])


def test_a_smooth_command_in_few_digits_is_smoothed_and_a_jerk_is_not() -> None:
    """Rounding errors of a command that moves by several steps a row: a local cubic takes off two
    thirds, and leaves a jerk as it was.
    """
    t, step = np.arange(2000, dtype=np.float64) * 0.001, 1e-5
    told = 1e-3 * np.sin(2.0 * np.pi * 7.0 * t) + np.where(t >= 1.0, 3.0 * step, 0.0)
    record = _command(told, step)
    filled, left = record.filled("pose_cmd")[:, 2], record.unsmoothed()[:, 2]
    near = np.abs(t - 1.0) < 0.004
    np.testing.assert_allclose(left[near], step / np.sqrt(12.0))
    assert not left[np.abs(t - 1.0) > 0.03].any()
    np.testing.assert_allclose(filled[near], told[near], atol=0.51 * step)
    smooth = left == 0.0
    assert np.std((filled - told)[smooth]) < 0.45 * step / np.sqrt(12.0)
    record.data["pose_cmd"][300], record.valid["pose_cmd"][300] = np.nan, False
    np.testing.assert_allclose(record.unsmoothed()[400:, 2], left[400:])
    assert np.isfinite(record.filled("pose_cmd")).all()
