"""What a campaign file may say, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

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
