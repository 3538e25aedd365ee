"""hiltestbed: a hardware-in-the-loop contact simulator for spacecraft docking, in software.

The closed loop is ``hiltestbed/loop.py``: read that first. From Python as from the shell:

    import hiltestbed
    scenario = hiltestbed.load_scenario("scenarios/reference-bumper.yaml", set={"sensor.delay": 0.010})
    run = hiltestbed.run(scenario)
    run.summary["cor"], run.trace["pose_act"]
    hiltestbed.write_run(run, "runs/first")
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiltestbed.kernel_cache import settle

if TYPE_CHECKING:
    from hiltestbed.campaign.schema import load_campaign
    from hiltestbed.campaign.sweep import read_sweep, sweep
    from hiltestbed.dataset import load_dataset
    from hiltestbed.diagnosis.diagnose import diagnose
    from hiltestbed.failure import replay
    from hiltestbed.recording import read_run, write_run
    from hiltestbed.scenario import dump_scenario, load_scenario
    from hiltestbed.shipped import shipped
    from hiltestbed.simulation import run, run_batch

settle(Path(__file__).parent, os.environ)  # before any kernel is loaded

__all__ = [
    "diagnose",
    "dump_scenario",
    "load_campaign",
    "load_dataset",
    "load_scenario",
    "read_run",
    "read_sweep",
    "replay",
    "run",
    "run_batch",
    "shipped",
    "sweep",
    "write_run",
]

_HOME = {
    "diagnose": "diagnosis.diagnose",
    "dump_scenario": "scenario",
    "load_campaign": "campaign.schema",
    "load_dataset": "dataset",
    "load_scenario": "scenario",
    "read_run": "recording",
    "read_sweep": "campaign.sweep",
    "replay": "failure",
    "run": "simulation",
    "run_batch": "simulation",
    "shipped": "shipped",
    "sweep": "campaign.sweep",
    "write_run": "recording",
}


def __getattr__(name: str) -> Any:
    """Public names are imported when they are asked for, so that importing the package costs nothing."""
    if name in _HOME:
        return getattr(import_module(f"hiltestbed.{_HOME[name]}"), name)
    raise AttributeError(f"module 'hiltestbed' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
