"""The cases of a campaign: the values of case number N, a function of the campaign and N alone, and
which cases can run in lockstep: those whose scenarios differ only in numbers. One chunk of cases,
from case numbers to table rows, is what a worker runs, here or elsewhere.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.build import runnable_from
from hiltestbed.campaign.columns import row
from hiltestbed.campaign.schema import Campaign, Grid, LoadedCampaign, Sobol
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.signals import GROUPS, RunTrace, groups

if TYPE_CHECKING:
    from hiltestbed.loop import Loop

_POINT, _SEED = 0, 1  # independent random streams of one case
# do not affect the structure; the number of ticks does
_FREE = ("name", "description", "seed", "duration")
_KEPT = ("rate", "physics_rate")
BLOCK = 128  # rows between two updates of the hashes: 64 runs take 5 MB
ROWS_LIMIT = 400_000  # rows of trace in memory at a time (0.25 GB), if traces are kept


def case_values(campaign: Campaign, cases: Sequence[int]) -> list[dict[str, Any]]:
    """For each case, dotted key to value; `seed` is spawned from design.seed unless it varies."""
    if isinstance(campaign.design, Grid):
        rows = _grid(campaign, cases)
    else:
        drawn = _sobol if isinstance(campaign.design, Sobol) else _random
        varied = campaign.vary.values()
        rows = [
            [variation.at(float(u)) for variation, u in zip(varied, quantiles, strict=True)]
            for quantiles in drawn(campaign, cases)
        ]
    return [
        {"seed": case_seed(campaign.design.seed, n)} | dict(zip(campaign.vary, row, strict=True))
        for n, row in zip(cases, rows, strict=True)
    ]


def case_seed(seed: int, case: int) -> int:
    """The seed of one case, in [0, 2^63): independent of the number of cases."""
    return int(_stream(seed, case, _SEED).generate_state(1, np.uint64)[0] >> np.uint64(1))


def _stream(seed: int, case: int, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(case, purpose))


def _grid(campaign: Campaign, cases: Sequence[int]) -> list[list[Any]]:
    """The last key varies fastest."""
    axes = [variation.grid() for variation in campaign.vary.values()]
    places = np.unravel_index(np.asarray(cases, dtype=np.int64), [len(axis) for axis in axes])
    chosen = [[axis[i] for i in place] for axis, place in zip(axes, places, strict=True)]
    return [list(row) for row in zip(*chosen, strict=True)]


def _random(campaign: Campaign, cases: Sequence[int]) -> list[np.ndarray]:
    return [
        np.random.default_rng(_stream(campaign.design.seed, n, _POINT)).random(len(campaign.vary))
        for n in cases
    ]


def _sobol(campaign: Campaign, cases: Sequence[int]) -> list[np.ndarray]:
    """The requested points of one scrambled sequence."""
    from scipy.stats import qmc

    rng = np.random.default_rng(campaign.design.seed)
    engine = qmc.Sobol(len(campaign.vary), scramble=True, rng=rng)
    drawn: dict[int, np.ndarray] = {}
    position = 0
    for n in sorted(set(cases)):
        if n > position:
            engine.fast_forward(n - position)
        drawn[n], position = engine.random(1)[0], n + 1
    return [drawn[n] for n in cases]


def skeleton(scenario: Scenario) -> str:
    """The scenario without its numbers: kinds, methods, optional parts, rates, number of ticks."""
    from hiltestbed.platform.build import alike  # MuJoCo, which reading a campaign does not need

    data = {
        key: value if key in _KEPT else _bare(value)
        for key, value in resolved(scenario).items()
        if key not in _FREE
    }
    contact = scenario.mechanism.contact
    platform = str(alike(scenario))  # numbers that its model depends on
    return json.dumps([scenario.ticks, contact.friction > 0, platform, data], sort_keys=True)


def _bare(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _bare(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_bare(item) for item in value]
    return "number" if isinstance(value, int | float) and not isinstance(value, bool) else value


def lockstep_groups(
    scenarios: Sequence[tuple[int, Scenario]], size: int
) -> list[list[tuple[int, Scenario]]]:
    """(case, scenario) pairs in groups of one skeleton, at most `size` members, in case order."""
    groups: dict[str, list[tuple[int, Scenario]]] = {}
    for pair in scenarios:
        groups.setdefault(skeleton(pair[1]), []).append(pair)
    return [
        group[start : start + size]
        for group in groups.values()
        for start in range(0, len(group), size)
    ]


def structural_keys(campaign: LoadedCampaign) -> list[str]:
    """The varied keys that change the skeleton, found by setting each listed value alone."""
    structural = []
    for key, variation in campaign.spec.vary.items():
        found = set()
        for value in variation.values or ():
            with suppress(InputError):
                found.add(skeleton(runnable_from(campaign.source, {key: value})))
        if len(found) > 1:
            structural.append(key)
    return structural


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
            scenarios.append((case, runnable_from(campaign.source, values[case])))
        except InputError as error:
            result.rows.append(row(campaign.spec, case, values[case], None, str(error), None))
    longest = max((s.ticks for _, s in scenarios if _has_rows(campaign, s)), default=0)
    size = ROWS_LIMIT // longest if longest else len(scenarios)
    for group in lockstep_groups(scenarios, max(size, 1)):
        _run_group(campaign, group, values, result)
    result.wall = time.perf_counter() - start
    return result


def _has_rows(campaign: LoadedCampaign, scenario: Scenario) -> bool:
    """Whether rows of the trace are needed: kept, or because `log.*` effects act on the record."""
    on_record = any(effect.link == "log" for effect in scenario.effects)
    return campaign.spec.keep != "summary" or on_record


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
            f"{case:08d}/{file.relative_to(folder)}": file.read_bytes()
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
