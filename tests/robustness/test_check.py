"""`hiltestbed check` on data, on numbers that are absurd together, and on work that is too
large.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltestbed.config.budget import run_budget
from hiltestbed.config.check import look_at
from hiltestbed.config.gallery import shipped
from hiltestbed.config.sense import warnings
from hiltestbed.errors import InputError
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run
from tests.measured import bounce

BUMPER = shipped("scenarios") / "02-bumper.yaml"


def test_check_opens_the_data(tmp_path: Path) -> None:
    table = bounce.columns()
    table["wrench_meas.fz"] = table["wrench_meas.fz"] / 4.4482216152605
    found = look_at(bounce.write_dataset(tmp_path, table))
    (fault,) = found.faults
    assert fault.file.endswith("run_0.parquet")
    assert "lbf" in fault.message
    assert "scale: 4.4482216" in fault.message
    assert "accept: [unit]" in fault.message


def test_check_says_what_is_lost(tmp_path: Path) -> None:
    table = bounce.columns()
    table["wrench_meas.fz"][100] = float("nan")
    found = look_at(bounce.write_dataset(tmp_path, table))
    assert not found.faults
    assert any("missing (NaN) in 1 of" in remark for remark in found.remarks)
    assert found.budget is not None


@pytest.mark.parametrize(
    "file", sorted(shipped("scenarios").glob("*.yaml")), ids=lambda file: file.stem
)
def test_shipped_scenarios_are_sound(file: Path) -> None:
    found = look_at(file)
    assert not found.faults
    assert not [remark for remark in found.remarks if remark.startswith("warning")]


ABSURD = {
    "a contact of a tick": ({"mechanism.contact.stiffness": 1e12}, "ticks of the loop"),
    "a delay longer than the contact": ({"sensor.delay": 0.5}, "longer than the contact"),
    "a fly and a station": ({"spacecraft.target.mass": 1e9}, "times the mass of the other"),
    "a penetration deeper than the tip": (
        {"approach.velocity": [0, 0, 3.0], "mechanism.contact.stiffness": 1e4},
        "mm across",
    ),
    "an end before the touch": ({"duration": 0.3}, "nothing touches: the gap of 10 mm takes"),
    "an approach that recedes": ({"approach.velocity": [0, 0, -0.03]}, "move away from each other"),
    "a sensor noisier than the contact": ({"sensor.noise": 1e6}, "more than the contact's peak of"),
    "a damper that stops within a step": ({"mechanism.contact.damping": 1e8}, "chatters"),
}


@pytest.mark.parametrize("name", ABSURD)
def test_numbers_that_are_absurd_together_are_warned_of(name: str) -> None:
    changes, text = ABSURD[name]
    assert any(text in warning for warning in warnings(load_scenario(BUMPER, set=changes)))


def test_the_warning_stands_in_the_summary() -> None:
    result = run(load_scenario(BUMPER, {"spacecraft.target.mass": 1e9, "duration": 0.05}))
    assert any("times the mass" in warning for warning in result.summary["warnings"])


def test_a_delay_line_of_gigabytes_is_refused_before_it_is_made() -> None:
    long = {"duration": 1000.0, "rate": 2000.0, "physics_rate": 4e6, "sensor.delay": 1000.0}
    scenario = load_scenario(BUMPER, long)
    assert run_budget([scenario]).memory > 1e11
    said = r"of memory \(allowed: .*\); HILTESTBED_MEMORY_LIMIT \[GB\] sets the limit"
    with pytest.raises(InputError, match=said):
        run(scenario)


def test_the_limit_is_the_users(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario(BUMPER, {"duration": 0.05})
    monkeypatch.setenv("HILTESTBED_MEMORY_LIMIT", "0.001")
    with pytest.raises(InputError, match="needs about"):
        run(scenario)
    monkeypatch.setenv("HILTESTBED_MEMORY_LIMIT", "inf")
    assert run(scenario).summary["status"] == "completed"
    monkeypatch.setenv("HILTESTBED_MEMORY_LIMIT", "much")
    with pytest.raises(InputError, match="is no limit"):
        run(scenario)


def test_a_week_of_work_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HILTESTBED_TIME_LIMIT", "1e-9")
    found = look_at(BUMPER)
    assert any("HILTESTBED_TIME_LIMIT" in fault.message for fault in found.faults)
