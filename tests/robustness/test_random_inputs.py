"""Random inputs: a result, or an error that says what is wrong, and nothing else. Below are cases
that many trials (``HILTESTBED_TRIALS=5000``) have found.
"""

from __future__ import annotations

import os
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from hiltestbed.analysis.stability import stability
from hiltestbed.build import runnable
from hiltestbed.config.check import look_at
from hiltestbed.config.gallery import shipped
from hiltestbed.errors import InputError
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run
from tests.robustness.trials import TRIALS

BUMPER = shipped("scenarios") / "02-bumper.yaml"
# [-] trials of each kind; HILTESTBED_TRIALS asks for another number
COUNTS = {"extremes": 4, "scenario": 3, "dataset": 4, "file": 4, "campaign": 20}
COUNTS |= {"text": 20, "packet": 200}
WANTED = int(os.environ.get("HILTESTBED_TRIALS", "0"))


@pytest.mark.parametrize("kind", TRIALS)
def test_a_random_input_gives_a_result_or_an_error_that_says_what_is_wrong(
    kind: str, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    for number in range(WANTED or COUNTS[kind]):
        with subtests.test(number=number), np.errstate(all="ignore"):
            assert TRIALS[kind](np.random.default_rng([crc32(kind.encode()), number]), tmp_path)


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
    faults = look_at(tmp_path / "d.yaml").faults
    assert any("names no file" in str(fault) for fault in faults)


@pytest.mark.parametrize(
    ("frequency", "mass", "said"),
    [(1e9, 20.0, r"rings so fast .* give a lower frequency"), (30.0, 1e-9, "rings so fast")],
)
def test_a_frame_that_rings_beyond_all_steps_is_refused(frequency, mass, said) -> None:
    mode = {"kind": "frame.mode", "frequency": frequency, "damping_ratio": 0.1, "mass": mass}
    with pytest.raises(InputError, match=said):
        runnable(load_scenario("02-bumper", {"effects": [mode]}))


def test_physics_too_fine_to_measure_the_rig_is_said_and_not_waited_for() -> None:
    judged = stability(load_scenario("15-ring-docking", {"physics_rate": 4e6, "duration": 0.003}))
    assert judged["stable"] is None
    assert judged["verdict"].startswith("not judged: 8e+06 steps of the physics")


@pytest.mark.parametrize("gap", [-2.0e8, 2.0e8])
def test_a_start_half_way_to_the_moon_is_refused(gap: float) -> None:
    """On a rig of slides that are solved stride by stride, 5 cm each."""
    with pytest.raises(InputError, match=r"travel|reach"):
        runnable(load_scenario("21-own-rig", {"approach.gap": gap}))
