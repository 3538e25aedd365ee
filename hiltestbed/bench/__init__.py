"""Benchmarks of the rig, the compensators, the identification and the diagnosis."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from hiltestbed.errors import HiltestbedError

if TYPE_CHECKING:
    from hiltestbed.bench.result import BenchResult

CHECKOUT = Path(__file__).parents[2]  # of the sources, unless the package was installed
EQUIPMENT = "tests.equipment."  # the independent rig is not installed
BENCHES = {  # name of a benchmark, and the module with its function of the same name
    "cor": "hiltestbed.bench.cor",
    "diagnosis": EQUIPMENT + "diagnosis.run",
    "facilities": "hiltestbed.bench.facilities",
    "hildock": "hiltestbed.bench.hildock.measure",
    "identification": "hiltestbed.bench.identification",
    "real": "hiltestbed.bench.real.run",
    "realtime": "hiltestbed.bench.realtime",
    "rths": "hiltestbed.bench.rths.measure",
    "throughput": "hiltestbed.bench.throughput",
}


def benchmark(name: str) -> Callable[..., BenchResult]:
    """The function that runs a benchmark.

    Raises:
        HiltestbedError: it needs the test equipment, which only a checkout of the sources has.
    """
    module = BENCHES[name]
    if module.startswith(EQUIPMENT):
        if not CHECKOUT.joinpath(*EQUIPMENT.split(".")).is_dir():
            raise HiltestbedError(
                f"bench {name}: its test equipment is not part of the installed package "
                f"({Path(__file__).parents[1]}); run it from a checkout of the sources: unpack the "
                f"source distribution or clone the repository, and in it `pip install -e .`"
            )
        sys.path.insert(0, str(CHECKOUT))  # before any other package with the name `tests`
    return getattr(import_module(module), name)
