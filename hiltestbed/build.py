"""From a scenario, which is numbers and names, to one that can run: the faults that need a model
are found, and the rate of the physics steps is determined.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hiltestbed.config.validation import Problem
from hiltestbed.config.yaml_source import Source, dotted
from hiltestbed.contact.findings import faults
from hiltestbed.errors import InputError
from hiltestbed.platform.build import problems as facility_problems
from hiltestbed.scenario import Scenario, scenario_from


def runnable_from(
    source: Source | Mapping[str, Any], set: Mapping[str, Any] | None = None
) -> Scenario:
    """As :func:`hiltestbed.scenario.scenario_from`, of a scenario that is to run. Raises InputError
    with every fault, those of its models included.
    """
    return _timed(scenario_from(source, set, _problems))


def runnable(scenario: Scenario) -> Scenario:
    """``scenario``, with its physics rate stated. Raises InputError if its models cannot run."""
    found = [f"{dotted(path)}: {message}" for path, message in _problems(scenario)]
    if found:
        raise InputError(f"scenario {scenario.name}: " + "; ".join(found))
    return _timed(scenario)


def _timed(scenario: Scenario) -> Scenario:
    return scenario.model_copy(update={"stated_physics_rate": scenario.physics_rate})


def _problems(scenario: Scenario) -> Iterator[Problem]:
    """Faults that need a model: of a mechanism's files, a start out of reach."""
    platform = scenario.rig.platform
    yield from platform.start_problems(scenario)
    if platform.start_needs_model:
        yield from facility_problems(scenario)
    yield from ((("mechanism",), message) for message in faults(scenario))
