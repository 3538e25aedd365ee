"""One chunk of cases: from case numbers to table rows. A worker runs this, on this machine or on
another.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltestbed.campaign.columns import row
from hiltestbed.campaign.designs import case_values
from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.campaign.structure import lockstep_groups
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.scenario import Scenario, scenario_from

ROWS_LIMIT = 400_000  # rows of trace in memory at a time (0.25 GB), if traces are kept


@dataclass
class ChunkResult:
    """Result of a chunk: one row per case, the files that are kept (path below `cases/`, to bytes),
    the wall time [s].
    """

    cases: tuple[int, ...]
    rows: list[dict[str, Any]]
    files: dict[str, bytes] = field(default_factory=dict)
    wall: float = 0.0


def run_chunk(campaign: LoadedCampaign, cases: Sequence[int]) -> ChunkResult:
    """Runs the cases, those of the same structure in lockstep. The row of a case that cannot be run
    has the reason.
    """
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
    """Whether the rows of the trace are needed: to keep them, or because `log.*` effects act on the
    complete record.
    """
    return campaign.spec.keep != "summary" or any(
        effect.link == "log" for effect in scenario.effects
    )


def _group_size(campaign: LoadedCampaign, scenarios: list[tuple[int, Scenario]]) -> int:
    longest = max(
        (scenario.ticks for _, scenario in scenarios if _has_rows(campaign, scenario)), default=0
    )
    return max(1, ROWS_LIMIT // longest) if longest else max(len(scenarios), 1)


def _run_group(
    campaign: LoadedCampaign,
    group: list[tuple[int, Scenario]],
    values: dict[int, dict],
    result: ChunkResult,
) -> None:
    from hiltestbed.campaign.digest import TraceDigest, trace_sha256
    from hiltestbed.simulation import run_batch

    digests: list[TraceDigest] = []

    def digest(loop: Any) -> TraceDigest:
        digests.append(TraceDigest(loop))
        return digests[-1]

    keep = campaign.spec.keep
    try:
        runs = run_batch(
            [scenario for _, scenario in group],
            trace=True if _has_rows(campaign, group[0][1]) else digest,
        )
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
