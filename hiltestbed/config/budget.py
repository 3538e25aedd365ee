"""Estimated memory, time and disk space of a run, a sweep or a diagnosis, from its files, before
anything is allocated.

The estimates are rough: their constants are those of one machine, for any kind of rig. They
distinguish a minute from a week, and a gigabyte from a petabyte. Work beyond a limit is refused;
environment variables set the limits:

    HILTESTBED_MEMORY_LIMIT   [GB], default: MEMORY_PART of the free memory
    HILTESTBED_DISK_LIMIT     [GB], default: DISK_PART of the free disk space
    HILTESTBED_TIME_LIMIT     [h], default: WEEK
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hiltestbed.errors import InputError
from hiltestbed.measured.units import UNITS
from hiltestbed.signals import GROUPS

if TYPE_CHECKING:
    from hiltestbed.campaign.schema import LoadedCampaign
    from hiltestbed.config.dataset import LoadedDataset
    from hiltestbed.scenario import Scenario

GB = 1e9
MEMORY_PART, DISK_PART = 0.8, 0.9
HOUR = UNITS["s"]["h"]
WEEK = 168.0  # [h]
COLUMNS = sum(len(group.parts) for group in GROUPS.values()) + 2
COPIES = 3  # of a trace in memory while it is written
BASE = 0.47 * GB  # an interpreter with its packages and compiled blocks
STATES = 4  # copies of the delay lines: the loop's own and those kept for the replay of a failure
TICK, INSTANT = 6e-5, 6e-6  # [s] on one core per tick and per physics step, for a single run
BATCH_FACTOR = 0.25  # part of that for each further run in its batch
REFERENCE = 0.5  # time of a reference run, relative to that of its run
STARTUP = 6.0  # [s] to start with compiled kernels, and to write report and recording
ROW = 700.0  # [byte] per row in trace.parquet and recording.rrd together
FIXED_FILES = 2.5e6  # [byte] of a recording and a report of even the shortest run
DIAGNOSIS_PER_ROW = 6e-3  # [s] per row of a dataset: 6 runs of 900 rows take 10 to 60 s
FIT_PER_ROW = 3.0e4  # [byte] per row of a dataset while links are replayed for many hypotheses
# time constants of a low-pass, the sensor's or its own, for which the identification keeps data
FILTER_MEMORY = 10.0


@dataclass(frozen=True)
class Budget:
    """Resources that a task needs. memory, disk: [byte]; time: [s] on one core."""

    memory: float
    time: float
    disk: float

    def __str__(self) -> str:
        return (
            f"about {_bytes(self.memory)} of memory, {_duration(self.time)} on one core, "
            f"{_bytes(self.disk)} on disk"
        )

    def refused(self, folder: Path = Path()) -> list[str]:
        """Why the task is refused: a sentence for each limit that it exceeds."""
        out = []
        for name, need, usual, unit, show in (
            ("memory", self.memory, _free_memory, "GB", _bytes),
            ("disk", self.disk, lambda: _free_disk(folder), "GB", _bytes),
            ("time", self.time, lambda: WEEK * HOUR, "h", _duration),
        ):
            variable = f"HILTESTBED_{name.upper()}_LIMIT"
            limit = _given(variable, HOUR if unit == "h" else GB) or usual()
            if not need <= limit:
                need_text = f"needs about {show(need)} of {name} (allowed: {show(limit)})"
                out.append(f"{need_text}; {variable} [{unit}] sets the limit")
        return out


def refuse_beyond(budget: Budget, what: str, do: str, folder: Path = Path()) -> None:
    """Raises InputError if ``what`` exceeds a limit; ``do`` says how to reduce its needs."""
    found = budget.refused(folder)
    if found:
        raise InputError(f"{what}: {'; '.join(found)}; {do}")


def _free_disk(folder: Path) -> float:
    """[byte] that a task may take below ``folder``."""
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    try:
        usage = shutil.disk_usage(there)
        # a file system without blocks reports no size
        return DISK_PART * usage.free if usage.total else math.inf
    except OSError:
        return math.inf


def _given(variable: str, unit: float) -> float | None:
    text = os.environ.get(variable, "")
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value > 0:
        raise InputError(
            f"{variable}: is no limit (got {text!r}); allowed is a number above 0, or inf"
        )
    return value * unit


def _free_memory() -> float:
    """[byte] that a task may take without swapping; infinite if the system does not report it."""
    found = []
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            found += [
                1024.0 * float(line.split()[1]) for line in file if line.startswith("MemAvailable")
            ]
        with open("/sys/fs/cgroup/memory.max", encoding="ascii") as file:
            found += [float(text) for text in [file.read().strip()] if text.isdigit()]
    except (OSError, ValueError):
        pass
    return MEMORY_PART * min(found, default=math.inf)


def run_budget(scenarios: Sequence[Scenario], rows: bool = True) -> Budget:
    """Budget of runs in lockstep; ``rows``: whether their traces are kept and written."""
    ticks, n, first = max(s.ticks for s in scenarios), len(scenarios), scenarios[0]
    trace = ticks * n * COLUMNS * 8.0
    lines = sum(delay_line(s) for s in scenarios)
    one = ticks * (TICK + INSTANT * first.substeps) * (1 + REFERENCE)
    core = one * (1 + BATCH_FACTOR * (n - 1))
    disk = n * (ticks * ROW + FIXED_FILES) if rows else 2e3 * n
    return Budget(BASE + (COPIES * trace if rows else 0.0) + STATES * lines, STARTUP + core, disk)


def delay_line(scenario: Scenario) -> float:
    """[byte] of the delay lines: wrenches of physics steps, poses and estimates of ticks."""
    sensor, effects = scenario.sensor, scenario.effects
    delays = [sensor.delay, *(getattr(effect, "delay", 0.0) for effect in effects)]
    delays += [8.0 * e.sigma for e in effects if e.kind == "sensor.jitter"]  # type: ignore[attr-defined]
    late = sum(getattr(effect, "ticks", 0) for effect in effects)
    lowpass = 0.0 if sensor.lowpass is None else 1.0 / (2.0 * math.pi * sensor.lowpass)
    constant = max(lowpass, scenario.identification.settles)
    remembered = FILTER_MEMORY * constant * scenario.rate * 28 * 8.0
    held = sum(delays) * (scenario.physics_rate * 48.0 + scenario.rate * 8.0 * 80.0)
    return remembered + held + late * 13 * 8.0


def campaign_budget(campaign: LoadedCampaign, workers: int = 1, chunk: int = 64) -> Budget:
    """Budget of a campaign whose cases are like its scenario."""
    from hiltestbed.build import runnable_from

    scenario = runnable_from(campaign.source)
    cases, keeps = campaign.spec.cases, campaign.spec.keep != "summary"
    together = min(chunk, cases)
    one = run_budget([scenario] * together, rows=False)
    held = min(together * scenario.ticks, 400_000) * COLUMNS * 8.0 * COPIES if keeps else 0.0
    disk = cases * (scenario.ticks * ROW if keeps else 2e3)
    return Budget(
        workers * (one.memory + held),
        STARTUP + (one.time - STARTUP) * cases / together / workers,
        disk,
    )


def dataset_budget(dataset: LoadedDataset) -> Budget:
    """Budget of a diagnosis of runs that last as long as their scenarios."""
    rows = sum(s.ticks for s in dataset.scenarios)
    return Budget(BASE + rows * FIT_PER_ROW, 10.0 + rows * DIAGNOSIS_PER_ROW, 2e6 + rows * ROW)


def _bytes(size: float) -> str:
    return _shown(size, {"TB": 1e12, "GB": GB, "MB": 1e6, "kB": 1e3}, 1.0)


def _duration(seconds: float) -> str:
    return _shown(
        seconds, {"days": UNITS["s"]["d"]} | {u: UNITS["s"][u] for u in ("h", "min", "s")}, 2.0
    )


def _shown(size: float, units: Mapping[str, float], least: float) -> str:
    """A size in the first of the ``units`` of which it has ``least``."""
    if math.isinf(size):
        return "no limit"
    unit = next((u for u, factor in units.items() if size >= least * factor), list(units)[-1])
    return f"{size / units[unit]:.3g} {unit}"
