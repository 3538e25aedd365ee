"""What is compiled beside a first run is what that run asks for."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hiltestbed.cli import ahead
from hiltestbed.compiled import bound
from hiltestbed.scenario import load_scenario
from hiltestbed.simulation import run
from tests.slow import slow

SCENARIOS = Path(__file__).parents[1] / "scenarios"


@pytest.mark.parametrize("name", ["reference-bumper", slow("09-docking"), slow("18-stewart")])
def test_nothing_is_compiled_that_the_run_does_not_call(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A call is known by its kernel and the kinds of what it is bound to: by nothing else does
    Numba tell whether it has compiled it.
    """
    monkeypatch.setattr(bound, "_calls", {})
    scenario = load_scenario(SCENARIOS / f"{name}.yaml", {"duration": 0.1})
    run(scenario)
    called = len(bound._calls)
    assert called > 20
    ahead.compile_later_blocks(scenario)
    assert len(bound._calls) == called


def test_the_process_reads_what_run_was_called_with() -> None:
    given = json.dumps([str(SCENARIOS / "reference-bumper.yaml"), ["duration=0.1"], None])
    done = subprocess.run(
        [sys.executable, "-m", "hiltestbed.cli.ahead"],
        input=given.encode(),
        capture_output=True,
        timeout=300,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_no_process_is_begun_where_the_kernels_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "compiled", lambda: True)
    ahead.begin(SCENARIOS / "reference-bumper.yaml", None, None)
    assert ahead._running == []
