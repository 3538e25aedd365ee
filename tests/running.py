"""A run for what its trace and its summary say."""

from __future__ import annotations

from hiltestbed.run_folder.result import Run
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import run_batch


def run(scenario: Scenario) -> Run:
    """A run with its trace and its reference; not told is whether it is stable, which takes longer
    than a short run itself.
    """
    return run_batch([scenario], trace=True)[0]
