"""What a campaign file may say, and what is refused; a case of its design depends on its number and the
seed alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.campaign.cases import case_seed, case_values
from hiltestbed.campaign.schema import load_campaign
from hiltestbed.errors import InputError


def faults_of(path: Path, text: str) -> list[str]:
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_campaign(path)
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize(
    ("vary", "design", "words"),
    [
        (
            "sensor.dealy: {values: [1]}",
            "kind: grid",
            "vary.sensor.dealy: unknown key (did you mean 'delay'?)",
        ),
        (
            "sensor.delay: {uniform: [0.01, 0.01]}",
            "kind: random, cases: 4",
            "is an empty range (got [0.01, 0.01])",
        ),
        (
            "sensor.delay: {log_uniform: [0.0, 0.01]}",
            "kind: random, cases: 4",
            "allowed are limits > 0",
        ),
        ("sensor.delay: {normal: [0.01, 0]}", "kind: random, cases: 4", "no spread"),
        ("sensor.delay: {values: [0.1], uniform: [0, 1]}", "kind: grid", "exactly one of"),
        ("sensor.delay: {uniform: [0, 0.01]}", "kind: grid", "needs points"),
        (
            "sensor.delay: {uniform: [0, 0.01], points: 3}",
            "kind: sobol, cases: 4",
            "allowed in a grid alone",
        ),
        (
            "sensor.delay: {uniform: [-1, 0.01]}",
            "kind: random, cases: 4",
            "vary.sensor.delay.uniform.0: is out of range (got -1.0)",
        ),
        (
            "approach.velocity.2: {values: [0.1]}, approach.velocity: {values: [[0, 0, 1]]}",
            "kind: grid",
            "is a part of approach.velocity",
        ),
        ("sensor.delay: {values: [0.1]}", "kind: sobl, cases: 3", "did you mean 'sobol'"),
        (
            "sensor.delay: {values: [0.1]}",
            "kind: sobol, cases: 1000000000",
            "too many cases (got 1000000000)",
        ),
        (
            "sensor.delay: {uniform: [0, 0.01], points: 31623}, rate: {uniform: [1, 2], points: "
            "31623}",
            "kind: grid",
            "(got 1000014129)",
        ),
    ],
)
def test_a_fault_is_named_with_its_place_and_what_is_allowed(
    file: Path, vary: str, design: str, words: str
) -> None:
    faults = faults_of(file, f"scenario: scenario.yaml\nvary: {{{vary}}}\ndesign: {{{design}}}\n")
    assert any(words in fault for fault in faults)
    assert all(fault.startswith(f"{file}:") and fault.split(":")[1] in "123" for fault in faults)


def test_a_scenario_that_is_missing_or_faulty_is_named(file: Path) -> None:
    assert (
        "names no file"
        in faults_of(
            file, "scenario: none.yaml\nvary: {seed: {values: [1]}}\ndesign: {kind: grid}\n"
        )[0]
    )
    (file.parent / "bad.yaml").write_text("name: x\n")
    faults = faults_of(
        file, "scenario: bad.yaml\nvary: {seed: {values: [1]}}\ndesign: {kind: grid}\n"
    )
    assert all("bad.yaml" in fault for fault in faults)
    faults = faults_of(
        file,
        "scenario: scenario.yaml\nset: {sensor.noise: -1}\nvary: {seed: {values: [1]}}\ndesign: "
        "{kind: grid}\n",
    )
    assert faults[0].startswith(f"{file}:2:7: set.sensor.noise: is out of range")


def test_a_campaign_may_set_what_its_values_stand_on(file: Path) -> None:
    loaded = load_campaign(file, {"set": {"duration": 0.1}})
    assert loaded.nominal.duration == 0.1


def test_the_scenario_may_be_a_shipped_one_by_its_name(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(
        "scenario: 02-bumper\nvary: {sensor.delay: {values: [0.001]}}\ndesign: {kind: grid}\n"
    )
    assert load_campaign(file).nominal.name == "bumper"


VARY = (
    "{sensor.delay: {uniform: [0.0, 0.01]}, mechanism.contact.stiffness: {log_uniform: "
    "[1.0e3, 1.0e5]}}"
)


def designed(file: Path, design: str, vary: str = VARY):
    file.write_text(f"scenario: scenario.yaml\nvary: {vary}\ndesign: {{{design}}}\n")
    return load_campaign(file).spec


@pytest.mark.parametrize(
    "design", ["kind: sobol, cases: 64, seed: 5", "kind: random, cases: 64, seed: 5"]
)
def test_a_case_is_the_same_alone_in_any_order_and_in_a_longer_campaign(
    file: Path, design: str
) -> None:
    spec = designed(file, design)
    together = case_values(spec, range(64))
    assert case_values(spec, [17]) == [together[17]]
    assert case_values(spec, [40, 3]) == [together[40], together[3]]
    longer = designed(file, design.replace("cases: 64", "cases: 1000"))
    assert case_values(longer, [63]) == [together[63]]


def test_another_seed_gives_other_points_and_other_noise(file: Path) -> None:
    first, second = (
        case_values(designed(file, f"kind: sobol, cases: 8, seed: {seed}"), range(8))
        for seed in (1, 2)
    )
    assert all(a != b for a, b in zip(first, second, strict=True))


def test_seeds_differ_from_case_to_case_and_fit_a_scenario() -> None:
    seeds = {case_seed(3, case) for case in range(1000)}
    assert len(seeds) == 1000
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_a_seed_that_varies_is_not_spawned(file: Path) -> None:
    spec = designed(file, "kind: grid", "{seed: {values: [4, 7]}}")
    assert [values["seed"] for values in case_values(spec, range(2))] == [4, 7]


def test_sobol_points_are_one_in_each_cell(file: Path) -> None:
    """The first 2^(2m) points of a Sobol sequence lie one in each of 2^m x 2^m cells."""
    spec = designed(file, "kind: sobol, cases: 64, seed: 9")
    delays, stiffnesses = zip(
        *(
            [row["sensor.delay"], row["mechanism.contact.stiffness"]]
            for row in case_values(spec, range(64))
        ),
        strict=True,
    )
    cells = np.histogram2d(
        np.array(delays) / 0.01, (np.log10(stiffnesses) - 3) / 2, bins=8, range=[[0, 1], [0, 1]]
    )[0]
    assert np.all(cells == 1)


def test_a_grid_is_every_combination_with_both_ends_exact(file: Path) -> None:
    vary = (
        "{sensor.delay: {uniform: [0.0, 0.01], points: 3}, mechanism.contact.stiffness: "
        "{log_uniform: [1.0e3, 1.0e5], points: 3}}"
    )
    spec = designed(file, "kind: grid", vary)
    rows = [
        (row["sensor.delay"], row["mechanism.contact.stiffness"])
        for row in case_values(spec, range(spec.cases))
    ]
    assert spec.cases == 9
    assert [delay for delay, _ in rows] == [0.0] * 3 + [0.005] * 3 + [0.01] * 3
    assert [stiffness for _, stiffness in rows[:3]] == [1e3, pytest.approx(1e4), 1e5]


def test_a_normal_key_has_its_mean_and_spread(file: Path) -> None:
    spec = designed(
        file,
        "kind: random, cases: 2000, seed: 1",
        "{mechanism.contact.damping: {normal: [100.0, 5.0]}}",
    )
    values = np.array([row["mechanism.contact.damping"] for row in case_values(spec, range(2000))])
    assert abs(values.mean() - 100.0) < 4 * 5.0 / np.sqrt(2000)
    assert abs(values.std() - 5.0) < 4 * 5.0 / np.sqrt(2 * 2000)
