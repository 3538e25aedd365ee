"""hiltestbed: a hardware-in-the-loop contact simulator for spacecraft docking, in software.

The closed loop is in ``hiltestbed/loop.py``: read that first. Use from Python:

    import hiltestbed
    scenario = hiltestbed.load_scenario("reference-bumper", set={"sensor.delay": 0.010})
    run = hiltestbed.run(scenario)
    run.summary["cor"], run.trace["pose_act"]
    hiltestbed.write_run(run, "runs/first")
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiltestbed.compiled.kernel_cache import settle

if TYPE_CHECKING:
    from hiltestbed.analysis.comparison import Comparison, compare
    from hiltestbed.campaign.schema import load_campaign
    from hiltestbed.campaign.sweep import Sweep, read_sweep, sweep
    from hiltestbed.config.dataset import load_dataset
    from hiltestbed.config.gallery import shipped
    from hiltestbed.diagnosis.diagnose import diagnose
    from hiltestbed.diagnosis.report.diagnosis import Diagnosis
    from hiltestbed.plugins import load_plugins
    from hiltestbed.run_folder.result import Run
    from hiltestbed.run_folder.store import read_run, write_run
    from hiltestbed.scenario import Scenario, dump_scenario, load_scenario
    from hiltestbed.signals import RunTrace
    from hiltestbed.simulation import run, run_batch
    from hiltestbed.supervision.failure import replay_failure

    __version__: str

settle(Path(__file__).parent, os.environ)  # must precede the loading of any kernel

__all__ = [
    "Comparison",
    "Diagnosis",
    "Run",
    "RunTrace",
    "Scenario",
    "Sweep",
    "__version__",
    "compare",
    "diagnose",
    "dump_scenario",
    "load_campaign",
    "load_dataset",
    "load_plugins",
    "load_scenario",
    "read_run",
    "read_sweep",
    "replay_failure",
    "run",
    "run_batch",
    "shipped",
    "sweep",
    "write_run",
]

_HOMES = {  # module, to the public names in it
    "analysis.comparison": ("Comparison", "compare"),
    "campaign.schema": ("load_campaign",),
    "campaign.sweep": ("Sweep", "read_sweep", "sweep"),
    "config.dataset": ("load_dataset",),
    "config.gallery": ("shipped",),
    "diagnosis.diagnose": ("diagnose",),
    "diagnosis.report.diagnosis": ("Diagnosis",),
    "plugins": ("load_plugins",),
    "run_folder.result": ("Run",),
    "run_folder.store": ("read_run", "write_run"),
    "scenario": ("Scenario", "dump_scenario", "load_scenario"),
    "signals": ("RunTrace",),
    "simulation": ("run", "run_batch"),
    "supervision.failure": ("replay_failure",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Public names are imported on first access, so that importing the package is fast."""
    if name == "__version__":
        from importlib.metadata import version

        return version("hiltestbed")
    if name in _HOME:
        return getattr(import_module(f"hiltestbed.{_HOME[name]}"), name)
    raise AttributeError(f"module 'hiltestbed' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
