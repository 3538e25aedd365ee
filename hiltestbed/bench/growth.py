"""Scaling of a campaign's time and memory with the number of cases and of ticks: each point in a
separate process.
"""

from __future__ import annotations

import math
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from hiltestbed.report.page import Report

CHUNK = 64
CASES = ((64, 250), (128, 250), (256, 250), (512, 250), (1024, 250))  # (cases, ticks)
TICKS = ((64, 250), (64, 500), (64, 1000), (64, 2000), (64, 4000))


def growth(quick: bool = False) -> list[dict[str, Any]]:
    """Records of `cases`, `ticks`, `wall` [s] without the start of the process, and `memory` [MB,
    at its peak].
    """
    points = [CASES[0], CASES[2], TICKS[2]] if quick else list(dict.fromkeys((*CASES, *TICKS)))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        return [pool.submit(measured, cases, ticks).result() for cases, ticks in points]


def measured(cases: int, ticks: int) -> dict[str, Any]:
    """One point: a campaign with the reference bumper, ended after `ticks`, in chunks."""
    from hiltestbed.campaign.chunk import run_chunk
    from hiltestbed.campaign.schema import load_campaign
    from hiltestbed.config.gallery import shipped

    file = shipped("scenarios") / "campaigns" / "delay-stiffness.yaml"
    campaign = load_campaign(
        file, {"set.duration": ticks / 2000.0, "set.identification": {"kind": "none"}}
    )
    run_chunk(campaign, range(2))  # not timed: compiles and loads what every process needs
    start = time.perf_counter()
    for first in range(0, cases, CHUNK):
        run_chunk(campaign, range(first, min(first + CHUNK, cases)))
    wall = time.perf_counter() - start
    return {"cases": cases, "ticks": ticks, "wall": wall, "memory": peak_memory()}


def peak_memory() -> float:
    """Peak memory of this process [MB]. On Linux not from `ru_maxrss`, which a new process inherits
    from its parent.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        return (
            next(
                int(line.split()[1])
                for line in status.read_text().splitlines()
                if line.startswith("VmHWM")
            )
            / 1024.0
        )
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2.0**20  # macOS counts bytes


def order(records: list[dict[str, Any]], key: str, other: str) -> float:
    """Exponent p of wall ~ key^p between the smallest and the largest of the records with equal
    `other`.
    """
    line = sorted((r for r in records if r[other] == records[0][other]), key=lambda r: r[key])
    first, last = line[0], line[-1]
    return (
        math.log(last["wall"] / first["wall"]) / math.log(last[key] / first[key])
        if last[key] > first[key]
        else math.nan
    )


def report_growth(report: Report, records: list[dict[str, Any]]) -> None:
    """Add a table of the points, and the growth exponents of the time with cases and ticks."""
    report.heading("Scaling of a campaign")
    by_cases, by_ticks = order(records, "cases", "ticks"), order(records, "ticks", "cases")
    report.text(
        f"Time grows as cases^{by_cases:.2f} and as ticks^{by_ticks:.2f}; each point in a fresh "
        f"process, in chunks of {CHUNK}."
    )
    rows = [[r["cases"], r["ticks"], f"{r['wall']:.2f}", f"{r['memory']:.0f}"] for r in records]
    report.table(["cases", "ticks each", "time [s]", "peak memory [MB]"], rows)
