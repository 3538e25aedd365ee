"""A campaign from its file to its results folder; run again, it resumes where it stopped."""

from __future__ import annotations

import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.build import runnable_from
from hiltestbed.campaign import engines
from hiltestbed.campaign.cases import case_values, structural_keys
from hiltestbed.campaign.schema import LoadedCampaign, load_campaign
from hiltestbed.campaign.store import CASES, LOCK, Store, read_about, refuse_another
from hiltestbed.config.yaml_source import key_path
from hiltestbed.errors import InputError, of_extra
from hiltestbed.run_folder.folders import html_table, parquet_table, safe_name
from hiltestbed.scenario import Scenario
from hiltestbed.scenario.idle import idle_keys

CHUNK_LIMIT = 1024
LOOKED_AT = 16  # cases of a campaign that are checked for varied keys without effect
# cases done, cases in total, number of cases per status
Progress = Callable[[int, int, Mapping[str, int]], None]


@dataclass(frozen=True, repr=False)
class Sweep:
    """A campaign's results: the folder, and the content of campaign.json."""

    folder: Path
    about: dict[str, Any]

    def __repr__(self) -> str:
        return (
            f"Sweep({self.about['name']}: {self.about['cases']} cases, "
            f"{self.about['status']}, in {self.folder})"
        )

    def _repr_html_(self) -> str:
        rows = [
            ("cases", self.about["cases"]),
            *self.about.get("counts", {}).items(),
            ("folder", self.folder),
        ]
        return html_table(f"{self.about['name']}: {self.about['status']}", (), rows)

    def to_pandas(self) -> Any:
        """cases.parquet as a pandas DataFrame, one row per case. Raises MissingExtra."""
        of_extra("pandas", "to_pandas()", "pandas")
        return self.cases().to_pandas()

    def cases(self):
        """cases.parquet as a pyarrow table, one row a case in case order."""
        return parquet_table(self.folder / CASES)


def sweep(
    campaign: LoadedCampaign | str | Path,
    out: str | Path | None = None,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    chunk: int = 64,
    progress: Progress | None = None,
) -> Sweep:
    """Runs every case that `out` (left out: results/NAME) does not contain yet, then writes
    cases.parquet, report.html and campaign.json.

    Raises InputError for a bad campaign, a folder that belongs to something else, or a scheduler
    that does not answer.
    """
    if not isinstance(campaign, LoadedCampaign):
        campaign = load_campaign(campaign)
    if not 1 <= chunk <= CHUNK_LIMIT:
        raise InputError(f"--chunk {chunk}: is out of range; allowed are 1 to {CHUNK_LIMIT} cases")
    if workers < 1:
        raise InputError(f"--workers {workers}: is out of range; allowed is 1 or more")
    folder = Path(out) if out is not None else default_folder(campaign)
    refuse_another(folder, campaign)
    if (folder / CASES).is_file() and read_about(folder).get("status") == "complete":
        return read_sweep(folder)
    engine, name = engines.serial, "this process"
    if scheduler:
        engine, name = engines.dask(scheduler), scheduler
    elif workers > 1:
        engine, name = partial(engines.processes, workers), f"{workers} processes"
    with Store.opened(folder, campaign) as store:
        counts = _run(store, engine, chunk, progress)
        _finish(store, name, chunk, *counts)
    return read_sweep(folder)


def default_folder(campaign: LoadedCampaign) -> Path:
    """results/NAME, the same each time the campaign is run, so that it resumes where it stopped."""
    return Path("results") / safe_name(campaign.spec.name or campaign.path.stem)


def _run(
    store: Store, engine: engines.Engine, chunk: int, progress: Progress | None
) -> tuple[int, float]:
    """Runs the remaining cases; returns their number and the wall time [s]."""
    done = store.done()
    missing = int(done.size - done.sum())
    start = time.perf_counter()
    statuses: Counter[str] = Counter()
    finished = 0
    chunks = planned_chunks(store.campaign, np.flatnonzero(~done), chunk)
    with closing(engine(store.campaign, chunks)) as results:
        for result in results:
            store.add(result)
            finished += len(result.cases)
            statuses.update(cells["status"] for cells in result.rows)
            if progress:
                progress(done.size - missing + finished, done.size, statuses)
    return missing, time.perf_counter() - start


def planned_chunks(
    campaign: LoadedCampaign, cases: np.ndarray, size: int
) -> Iterator[tuple[int, ...]]:
    """The cases divided into chunks, cases of one structure together and in order."""
    keys = structural_keys(campaign)
    if not keys:
        for start in range(0, len(cases), size):
            yield tuple(int(n) for n in cases[start : start + size])
        return
    open_chunks: dict[str, list[int]] = {}
    for start in range(0, len(cases), 1024):
        block = [int(n) for n in cases[start : start + 1024]]
        for case, values in zip(block, case_values(campaign.spec, block), strict=True):
            kind = repr([values[key] for key in keys])
            group = open_chunks.setdefault(kind, [])
            group.append(case)
            if len(group) == size:
                yield tuple(open_chunks.pop(kind))
    yield from (tuple(group) for group in open_chunks.values())


def _finish(store: Store, engine: str, chunk: int, ran: int, wall: float) -> None:
    """Writes cases.parquet, then the report, then campaign.json; deletes the chunks last."""
    from hiltestbed.campaign.report import write_report

    walls = store.walls()
    store.merge()
    write_report(store.folder, store.campaign)
    statuses = parquet_table(store.folder / CASES, ["status"])["status"].value_counts().to_pylist()
    counts = {entry["values"]: entry["counts"] for entry in statuses}
    spent = {"last_session": wall, "last_session_cases": ran}
    spent |= {"work": sum(entry["wall"] for entry in walls), "chunks": walls}
    about = {"status": "complete", "counts": counts, "engine": engine, "chunk": chunk}
    store.write_about(about | {"wall": spent})
    shutil.rmtree(store.chunks, ignore_errors=True)  # cases.parquet has their rows
    (store.folder / LOCK).unlink(missing_ok=True)


def case_scenario(
    campaign: LoadedCampaign, case: int, overrides: Mapping[str, Any] | None = None
) -> Scenario:
    """The scenario of case number `case`, with keys overridden. Raises InputError if there is no
    such case or its scenario is invalid.
    """
    if not 0 <= case < campaign.spec.cases:
        raise InputError(
            f"--case {case}: is no case of {campaign.path}; allowed are 0 to "
            f"{campaign.spec.cases - 1}"
        )
    return runnable_from(campaign.source.with_set(case_values(campaign.spec, [case])[0]), overrides)


def varied_in_vain(campaign: LoadedCampaign) -> tuple[str, ...]:
    """A sentence for each varied key that has no effect in any of up to :data:`LOOKED_AT` cases."""
    last = campaign.spec.cases - 1
    paths = {key: tuple(map(str, key_path(key))) for key in campaign.spec.vary}
    found: dict[str, str] | None = None
    for case in sorted({round(i * last / (LOOKED_AT - 1)) for i in range(LOOKED_AT)}):
        idle = [(tuple(map(str, p)), why) for p, why in idle_keys(case_scenario(campaign, case))]
        pairs = product(paths.items(), idle)
        here = {key: why for (key, path), (a, why) in pairs if path[: len(a)] == a}
        found = here if found is None else {k: why for k, why in found.items() if k in here}
    return tuple(f"vary.{key}: has no effect: {why}" for key, why in (found or {}).items())


def read_sweep(folder: str | Path) -> Sweep:
    """The results in a campaign's folder. Raises InputError if the folder is not one."""
    return Sweep(Path(folder), read_about(Path(folder)))
