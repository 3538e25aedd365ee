"""Shipped scenarios, and a run for what its trace and its summary say."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hiltestbed.analysis.stability import stability
from hiltestbed.run_folder.result import Run
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.simulation import run_batch

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def run(scenario: Scenario) -> Run:
    """A run with its trace, without its stability, which takes longer than a short run itself."""
    return run_batch([scenario], trace=True)[0]


def shipped(name: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """The shipped scenario ``name``.yaml, with keys changed."""
    return load_scenario(SCENARIOS / f"{name}.yaml", changes)


def judged(scenario: Scenario) -> dict[str, Any]:
    """The stability of a scenario that has one."""
    found = stability(scenario)
    assert found is not None
    return found
