"""The scenario: the definition of a run, its sections, files and checks."""

from hiltestbed.scenario.scenario import (
    Scenario,
    dump_scenario,
    file_sha256,
    identity,
    load_scenario,
    put,
    resolved,
    scenario_from,
    scenario_sha256,
)

__all__ = [
    "Scenario",
    "dump_scenario",
    "file_sha256",
    "identity",
    "load_scenario",
    "put",
    "resolved",
    "scenario_from",
    "scenario_sha256",
]
