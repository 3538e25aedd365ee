"""The benchmark of the coefficient of restitution on a corner of its grid."""

from __future__ import annotations

import math

import pytest

from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.bench.contacts import bounce, grid, random_rigs
from hiltestbed.bench.contenders import CONTENDERS
from hiltestbed.bench.cor import (
    leaderboard,
    measure,
    measure_random,
    stability_boundary,
    statistics_of,
)
from hiltestbed.bench.cor_report import cell_text, cor_report, worst_errors
from hiltestbed.simulation import reference_scenario

CONTACTS = grid((4.0,), (0.005, 0.02), damping_ratios=(0.05,))
RECORD = set(
    [
        "method",
        "frequency",
        "delay",
        "damping_ratio",
        "contact",
        "delay_knowledge",
        "tracking",
        "cor",
        "cor_reference",
        "cor_log_error",
        "energy_generated",
        "peak_force_error",
        "stable",
    ]
)


@pytest.fixture(scope="module")
def records() -> list[dict]:
    reference = bounce([reference_scenario(c.scenario({"kind": "none"})) for c in CONTACTS])
    return [
        record for contender in CONTENDERS for record in measure(contender, CONTACTS, reference)
    ]


def test_every_method_is_on_record(records: list[dict]) -> None:
    assert len(records) == len(CONTENDERS) * len(CONTACTS)
    assert all(record.keys() >= RECORD for record in records)


def test_the_resynchronised_prediction_wins_a_first_contact(records: list[dict]) -> None:
    board = leaderboard(records, {(c.name, c.contact): 0.0 for c in CONTENDERS})
    first = next(row for row in board if row["contact"] == "first")
    assert first["method"] == "resynchronised"
    assert first["largest_log_error"] < 0.003
    assert first["stable"] == 1.0


def test_energy_created_is_what_the_rebound_has_too_much(records: list[dict]) -> None:
    """mu v^2 (e^2 - e_ref^2)/2 and, since the late force lets it in deeper, what the damper takes
    on top.
    """
    mine = [r for r in records if r["method"] == "none"]
    for record, contact in zip(mine, CONTACTS, strict=True):
        gained = record["cor"] ** 2 - record["cor_reference"] ** 2
        assert record["energy_generated"] > 0.5 * contact.mass * contact.speed**2 * gained


def test_through_the_servo_the_tracking_is_on_record() -> None:
    contacts = grid((2.0,), (0.005,), damping_ratios=(0.05,), tracking="servo")
    reference = bounce([reference_scenario(c.scenario({"kind": "none"})) for c in contacts])
    record = measure(CONTENDERS[0], contacts, reference)[0]
    assert abs(record["J1"]) <= 0.5
    assert 0.0 < record["J2"] < 5.0
    assert 0.0 < record["J3"] < 5.0


def test_the_boundary_is_where_theory_has_it() -> None:
    """Without compensation e passes 1 at the delay of the closed form: within a step of the grid of
    delays, a factor of 2.
    """
    boundary = stability_boundary(6)
    for frequency, row in zip(boundary["frequency"], boundary["none"], strict=True):
        w = 2.0 * math.pi * frequency
        limit = SpringDamper(w * w, 2.0 * 0.05 * w, 1.0).neutral_delay
        for delay, e in zip(boundary["delay"], row, strict=True):
            if not 1.0 / 1.05 < delay / limit < 1.05:
                assert (e > 1.0) == (delay > limit)


def test_random_rigs_and_the_page(records: list[dict]) -> None:
    best = next(c for c in CONTENDERS if c.name == "resynchronised" and c.contact == "first")
    found = statistics_of(measure_random(best, random_rigs(2, seed=3)))
    assert found["resynchronised"]["rebounded"] == 2
    assert found["resynchronised"]["cor_log_error"]["max"] < 0.01
    board = leaderboard(records, {(c.name, c.contact): 0.0 for c in CONTENDERS})
    summary = {"leaderboard": board, "random_rigs": found, "boundary": stability_boundary(3)}
    page = cor_report(records, summary | {"failed": {"mine": "too steep"}}).html()
    assert "resynchronised" in page
    assert "mine is left out; it ended with: too steep" in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_cells_that_round_to_nothing_have_no_sign_and_no_colour() -> None:
    shown = [cell_text(v) for v in (0.0, 4e-4, -4e-4, 0.0012, -0.25, math.nan)]
    assert shown == ["0", "0", "0", "+0.001", "-0.250", "lost"]


def test_a_map_and_the_board_tell_no_rebound_from_not_measured(records: list[dict]) -> None:
    """`none` where a contact gave no rebound, a dash where nothing was run, in map and board."""
    one = {"frequency": 2.0, "delay": 0.005, "cor_log_error": -0.3}
    found = worst_errors(
        [one, one | {"cor_log_error": 0.1}, one | {"delay": 0.02, "cor_log_error": None}],
        [2.0],
        [0.005, 0.02],
    )
    assert found[0, 0] == -0.3
    assert math.isnan(found[0, 1])
    lost = [r | {"cor_log_error": None} if r["method"] == "none" else r for r in records]
    board = leaderboard(lost, {(c.name, c.contact): 0.0 for c in CONTENDERS})
    (row,) = (r for r in board if r["method"] == "none")
    assert row["largest_log_error"] is None
    assert row["runs"]["largest_log_error"] == len(CONTACTS)
    assert row["runs"]["delay_jitter"] == 0
