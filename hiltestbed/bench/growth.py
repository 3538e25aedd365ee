"""How the time and the memory of a campaign grow with the number of cases and of ticks: each point in a process of its own."""

from __future__ import annotations

import math
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from hiltestbed.report import Report

CHUNK = 64
CASES = ((64, 250), (128, 250), (256, 250), (512, 250), (1024, 250))  # (cases, ticks)
TICKS = ((64, 250), (64, 500), (64, 1000), (64, 2000), (64, 4000))


def growth(quick: bool = False) -> list[dict[str, Any]]:
    """Records of `cases`, `ticks`, `wall` [s] and `memory` [MB, at its peak], without what a process needs to start."""
    points = [CASES[0], CASES[2], TICKS[2]] if quick else list(dict.fromkeys((*CASES, *TICKS)))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        return [pool.submit(measured, cases, ticks).result() for cases, ticks in points]


def measured(cases: int, ticks: int) -> dict[str, Any]:
    """One point: chunks of a campaign whose scenario is the reference bumper, ended after `ticks`."""
    from hiltestbed.campaign.chunk import run_chunk
    from hiltestbed.campaign.schema import load_campaign
    from hiltestbed.gallery import shipped

    file = shipped("scenarios") / "campaigns" / "delay-stiffness.yaml"
    campaign = load_campaign(file, {"set.duration": ticks / 2000.0, "set.identification": {"kind": "none"}})
    run_chunk(campaign, range(2))  # compiles and loads what every process has to
    start = time.perf_counter()
    for first in range(0, cases, CHUNK):
        run_chunk(campaign, range(first, min(first + CHUNK, cases)))
    wall = time.perf_counter() - start
    return {"cases": cases, "ticks": ticks, "wall": wall, "memory": peak_memory()}


def peak_memory() -> float:
    """The most memory that this process has held [MB]. Linux gives a new process its parent's `ru_maxrss`, so not from there."""
    status = Path("/proc/self/status")
    if status.is_file():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM")) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2.0**20  # macOS counts bytes


def order(records: list[dict[str, Any]], key: str, other: str) -> float:
    """Exponent p of wall ~ key^p between the smallest and the largest of the records that agree in `other`."""
    line = sorted((r for r in records if r[other] == records[0][other]), key=lambda r: r[key])
    first, last = line[0], line[-1]
    return math.log(last["wall"] / first["wall"]) / math.log(last[key] / first[key]) if last[key] > first[key] else math.nan


def report_growth(report: Report, records: list[dict[str, Any]]) -> None:
    """A table of the points, and how the time goes with cases and with ticks."""
    report.heading("How a campaign grows")
    by_cases, by_ticks = order(records, "cases", "ticks"), order(records, "ticks", "cases")
    report.text(f"Time goes with cases^{by_cases:.2f} and with ticks^{by_ticks:.2f}; each point in a fresh process, in chunks of {CHUNK}.")
    rows = [[r["cases"], r["ticks"], f"{r['wall']:.2f}", f"{r['memory']:.0f}"] for r in records]
    report.table(["cases", "ticks each", "time [s]", "memory at its peak [MB]"], rows)
