"""One chunk of cases, from case numbers to table rows: what a worker runs, here or elsewhere."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.campaign.cases import case_values, lockstep_groups
from hiltestbed.campaign.columns import row
from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario, scenario_from
from hiltestbed.signals import GROUPS, RunTrace, groups

if TYPE_CHECKING:
    from hiltestbed.loop import Loop

BLOCK = 128  # rows between two updates of the hashes: 64 runs take 5 MB
ROWS_LIMIT = 400_000  # rows of trace in memory at a time (0.25 GB), if traces are kept


@dataclass
class ChunkResult:
    """One row per case, the files that are kept (path below `cases/` to bytes), wall time [s]."""

    cases: tuple[int, ...]
    rows: list[dict[str, Any]]
    files: dict[str, bytes] = field(default_factory=dict)
    wall: float = 0.0


def run_chunk(campaign: LoadedCampaign, cases: Sequence[int]) -> ChunkResult:
    """Runs the cases, those of one structure in lockstep; a case that cannot run has the reason."""
    start = time.perf_counter()
    result = ChunkResult(tuple(cases), [])
    values = dict(zip(cases, case_values(campaign.spec, cases), strict=True))
    scenarios: list[tuple[int, Scenario]] = []
    for case in cases:
        try:
            scenarios.append((case, scenario_from(campaign.source, values[case])))
        except InputError as error:
            result.rows.append(row(campaign.spec, case, values[case], None, str(error), None))
    for group in lockstep_groups(scenarios, _group_size(campaign, scenarios)):
        _run_group(campaign, group, values, result)
    result.wall = time.perf_counter() - start
    return result


def _has_rows(campaign: LoadedCampaign, scenario: Scenario) -> bool:
    """Whether rows of the trace are needed: kept, or because `log.*` effects act on the record."""
    on_record = any(effect.link == "log" for effect in scenario.effects)
    return campaign.spec.keep != "summary" or on_record


def _group_size(campaign: LoadedCampaign, scenarios: list[tuple[int, Scenario]]) -> int:
    longest = max((s.ticks for _, s in scenarios if _has_rows(campaign, s)), default=0)
    return max(1, ROWS_LIMIT // longest) if longest else max(len(scenarios), 1)


def _run_group(
    campaign: LoadedCampaign,
    group: list[tuple[int, Scenario]],
    values: dict[int, dict],
    result: ChunkResult,
) -> None:
    from hiltestbed.simulation import run_batch

    digests: list[TraceDigest] = []

    def digest(loop: Any) -> TraceDigest:
        digests.append(TraceDigest(loop))
        return digests[-1]

    keep = campaign.spec.keep
    trace: Any = True if _has_rows(campaign, group[0][1]) else digest
    try:
        runs = run_batch([scenario for _, scenario in group], trace=trace)
    # the rig rejects this scenario: the others of the group run without it
    except HiltestbedError as error:
        if len(group) == 1:
            case = group[0][0]
            result.rows.append(row(campaign.spec, case, values[case], None, str(error), None))
        else:
            for pair in group:
                _run_group(campaign, [pair], values, result)
        return
    for i, ((case, _), run) in enumerate(zip(group, runs, strict=True)):
        sha256 = trace_sha256(run.trace) if run.trace is not None else digests[0].sha256(i)
        result.rows.append(row(campaign.spec, case, values[case], run.summary, None, sha256))
        if keep != "summary":
            result.files |= _kept_files(case, run, recording=keep == "all")


def case_folder(case: int) -> str:
    """The folder of a case below `cases/`, zero-padded so that a listing is in case order."""
    return f"{case:08d}"


def _kept_files(case: int, run: Any, recording: bool) -> dict[str, bytes]:
    """The trace alone, or the whole run folder, as bytes: the worker may be on another machine."""
    from hiltestbed.run_folder.store import TRACE, write_run, write_trace

    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        if recording:
            write_run(run, folder, report=False)
        else:
            folder.mkdir()
            write_trace(run.trace, folder / TRACE)
        return {
            f"{case_folder(case)}/{file.relative_to(folder)}": file.read_bytes()
            for file in sorted(folder.rglob("*"))
            if file.is_file()
        }


class TraceDigest:
    """Replaces a Trace without holding more than a block of its rows: takes the same rows, and
    gives `sha256(i)` of run i instead of them.

    The hash covers every column except `t`, row by row in the order of the trace file, as
    little-endian float64. A run that ended early is hashed up to its last row.
    """

    def __init__(self, loop: Loop) -> None:
        n = len(loop.scenarios)
        self._trouble = loop.trouble  # not the loop itself: this would keep its models in memory
        self._hashes = [hashlib.sha256() for _ in range(n)]
        self._done = 0
        self.length = np.zeros(n, dtype=int)  # set by the simulation when it ends
        self.data = {
            group.name: np.zeros((BLOCK, n, len(group.parts)))
            for group in groups(loop.plant.units).values()
        }
        self.contact = np.zeros((BLOCK, n), dtype=bool)

    def filled(self, ticks: int) -> None:
        """Hash a full block; the first ``ticks`` rows are written."""
        if ticks - self._done == BLOCK:
            self._take(ticks)

    def _take(self, end: int) -> None:
        """Hash the rows from the last block's end to `end`."""
        count = end - self._done
        for i, digest in enumerate(self._hashes):
            rows = min(count, self._trouble[i][0] + 1 - self._done) if i in self._trouble else count
            if rows > 0:
                parts = [self.data[name][:rows, i] for name in GROUPS]
                digest.update(_matrix(parts, self.contact[:rows, i]))
        self._done = end

    def run(self, i: int) -> None:
        """None: the rows are not kept."""

    def sha256(self, i: int) -> str:
        """The hash of run i, in hexadecimal; valid once the loop has ended."""
        if self._done < self.length.max():
            self._take(int(self.length.max()))
        return self._hashes[i].hexdigest()


def _matrix(parts: list[Array], contact: Array) -> bytes:
    return np.column_stack([*parts, contact.astype(float)]).astype("<f8", copy=False).tobytes()


def trace_sha256(trace: RunTrace) -> str:
    """The same hash, of a stored trace."""
    return hashlib.sha256(_matrix([trace.data[name] for name in GROUPS], trace.contact)).hexdigest()
