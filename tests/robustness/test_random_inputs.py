"""Random inputs, the quick part of `hiltestbed bench robustness`: a result, or an error that says
what is wrong, and nothing else. Below are cases that the long part has found.
"""

from __future__ import annotations

from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from hiltestbed.analysis.stability import stability
from hiltestbed.config.check import check_file
from hiltestbed.config.gallery import shipped
from hiltestbed.errors import InputError
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run
from tests.equipment.kept import Kept
from tests.equipment.robustness.run import STRETCH, robustness
from tests.equipment.robustness.trials import TRIALS
from tests.slow import ALL

BUMPER = shipped("scenarios") / "02-bumper.yaml"
COUNTS = {"extremes": 12 if ALL else 5, "scenario": 8 if ALL else 4, "dataset": 6}
COUNTS |= {"text": 40, "campaign": 40, "packet": 300}


@pytest.mark.parametrize("kind", COUNTS)
def test_trials_of_each_kind(kind: str, tmp_path: Path) -> None:
    with np.errstate(all="ignore"):
        for number in range(COUNTS[kind]):
            assert TRIALS[kind](np.random.default_rng([crc32(kind.encode()), number]), tmp_path)


def test_the_long_part_tells_what_it_did() -> None:
    result = robustness(minutes=0.02)
    assert result.summary["tried"] == sum(r["tried"] for r in result.records)
    assert result.summary["failed"] == 0
    assert {r["kind"] for r in result.records} == set(TRIALS)


def test_trials_go_on_where_they_were_stopped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    keep, added = tmp_path / "bench.trials.jsonl", []
    before = Kept(keep, lambda record: (record["kind"], record["number"]))
    for number in range(5):
        before.add({"kind": "packet", "number": number, "ended": "survived", "wall": 0.1})
    fault = {"fault": "the process ends with -11", "place": "ends with -11"}
    before.add({"kind": "packet", "number": 5} | fault)
    before.add({"kind": STRETCH, "number": 0, "wall": 120.0})
    targets = dict.fromkeys(TRIALS, 0) | {"packet": 9}
    monkeypatch.setattr("tests.equipment.robustness.run.TARGETS", targets)
    monkeypatch.setattr(Kept, "add", lambda self, record: added.append(record))
    result = robustness(minutes=5.0, workers=1, keep=keep)
    assert [t["number"] for t in added if t["kind"] == "packet"] == [6, 7, 8]
    assert (result.summary["tried"], result.summary["failed"]) == (9, 1)
    assert result.summary["minutes"] == pytest.approx(2.0 + added[-1]["wall"] / 60.0, abs=0.01)
    assert not keep.exists()


def test_speeds_beyond_all_bounds_end_in_words() -> None:
    result = run(load_scenario("09-docking", {"approach.velocity.2": 6e7, "duration": 0.05}))
    assert result.summary["status"] == "diverged"
    assert result.summary["stop_reason"]


@pytest.mark.parametrize("key", ["scenario", "file"])
def test_a_name_that_no_file_system_takes_is_no_file(tmp_path: Path, key: str) -> None:
    names = {"scenario": "s.yaml", "file": "run.csv"} | {key: "a" * 300}
    (tmp_path / "s.yaml").write_text(BUMPER.read_text())
    dataset = f"scenario: {names['scenario']}\nruns: [{{file: {names['file']}}}]\n"
    (tmp_path / "d.yaml").write_text(dataset)
    _, faults = check_file(tmp_path / "d.yaml")
    assert any("names no file" in str(fault) for fault in faults)


@pytest.mark.parametrize(
    ("frequency", "mass", "said"),
    [(1e9, 20.0, r"rings so fast .* give a lower frequency"), (30.0, 1e-9, "rings so fast")],
)
def test_a_frame_that_rings_beyond_all_steps_is_refused(frequency, mass, said) -> None:
    mode = {"kind": "frame.mode", "frequency": frequency, "damping_ratio": 0.1, "mass": mass}
    with pytest.raises(InputError, match=said):
        load_scenario("02-bumper", {"effects": [mode]})


def test_physics_too_fine_to_measure_the_rig_is_said_and_not_waited_for() -> None:
    judged = stability(load_scenario("15-ring-docking", {"physics_rate": 4e6, "duration": 0.003}))
    assert judged is not None
    assert judged["stable"] is None
    assert judged["verdict"].startswith("not judged: 8e+06 steps of the physics")


@pytest.mark.parametrize("gap", [-2.0e8, 2.0e8])
def test_a_start_half_way_to_the_moon_is_refused(gap: float) -> None:
    """On a rig of slides that are solved stride by stride, 5 cm each."""
    with pytest.raises(InputError, match=r"travel|reach"):
        load_scenario("21-own-rig", {"approach.gap": gap})
