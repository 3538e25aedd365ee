"""Stiffness and damping from one contact: every method of identification over frequency, delay,
damping ratio and noise.

The loop runs with the resynchronised prediction, so that each method is applied to the same
contact. Reported are relative errors, the median over seeds, with the 95 % spread, and the share of
seeds whose reported 95 % interval contains the true value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hiltestbed.bench.contacts import BenchRuns, Contact, bounce, grid
from hiltestbed.bench.identification_report import identification_report
from hiltestbed.bench.result import BenchResult

Progress = Callable[[int, int], None]
THREADS = 2
FORCE = {"kind": "resynchronised"}
METHODS: dict[str, dict[str, Any]] = {
    "rls": {"kind": "rls"},
    "rls_raw": {"kind": "rls_raw"},
    "rls_lead": {"kind": "rls_lead"},
    "kalman": {"kind": "kalman"},
    "hunt_crossley": {"kind": "hunt_crossley"},
    "instrumental": {"kind": "instrumental"},
    "rls_delay_estimated": {"kind": "rls", "delay": "estimate"},
}
NOISES = (0.001, 0.002, 0.005, 0.02)  # of the peak force
NORMAL_95 = 1.96
AXIAL = 2
CALIBRATION = Contact(4.0, 0.01, 0.05)


def identification(quick: bool = False, progress: Progress | None = None) -> BenchResult:
    """All methods on the whole grid at 0.2 % noise, and on its corners at other noise levels;
    ``quick``: only corners at 0.2 % noise.
    """
    seeds = 4 if quick else 16
    noises = (0.002,) if quick else NOISES
    at = [(m, n) for m in METHODS for n in noises]
    small = grid((1.0, 8.0), (0.002, 0.020), damping_ratios=(0.02, 0.2))
    contacts = [small if quick or noise != 0.002 else grid() for _, noise in at]
    intervals_of = 100 if quick else 400
    work = sum(len(c) * seeds for c in contacts) + intervals_of  # bounces
    records: list[dict[str, Any]] = []
    done = 0
    for (method, noise), grid_of in zip(at, contacts, strict=True):
        if progress:
            progress(done, work)
        records += measure(method, grid_of, noise, seeds)
        done += len(grid_of) * seeds
    intervals = interval_coverage(intervals_of)
    if progress:
        progress(work, work)
    board = leaderboard(records)
    summary = {"leaderboard": board, "intervals": intervals, "best": board[0]["method"]}
    lines = [
        (
            row["method"],
            f"k within {_percent(row['stiffness_error'])}, c within "
            f"{_percent(row['damping_error'])}",
        )
        for row in board
    ]
    lines.append(
        (
            "95 % intervals that contain k, c",
            f"{100 * intervals['stiffness']:.1f} %, {100 * intervals['damping']:.1f} %",
        )
    )
    return BenchResult(
        "identification", records, summary, identification_report(records, summary), lines
    )


def measure(
    method: str, contacts: Sequence[Contact], noise: float, seeds: int
) -> list[dict[str, Any]]:
    """One record per contact: median and 95 % spread over the seeds."""
    # the nominal delay is then 20 % off the one to be estimated
    off = METHODS[method].get("delay") == "estimate"
    runs = [
        _again(c, noise, seed, "off" if off else "exact") for c in contacts for seed in range(seeds)
    ]
    result = bounce([c.scenario(FORCE, METHODS[method]) for c in runs], THREADS)
    stiffness, damping = _axial(result)
    records = []
    for i, contact in enumerate(contacts):
        mine = slice(i * seeds, (i + 1) * seeds)
        record: dict[str, Any] = {
            "method": method,
            "frequency": contact.frequency,
            "delay": contact.delay,
            "damping_ratio": contact.damping_ratio,
            "noise": noise,
        }
        record |= _spread("stiffness", stiffness[mine] / contact.stiffness - 1.0)
        record |= _spread("damping", damping[mine] / contact.damping - 1.0)
        if off:
            delay = result.loop.identification.source.delay[mine]  # type: ignore[union-attr]
            record |= {"delay_error": float(np.abs(delay - contact.delay).max())}
        records.append(record)
    return records


def _again(contact: Contact, noise: float, seed: int, knowledge: str) -> Contact:
    return Contact(
        contact.frequency, contact.delay, contact.damping_ratio, knowledge, noise=noise, seed=seed
    )


def _axial(result: BenchRuns) -> tuple[np.ndarray, np.ndarray]:
    estimate = result.loop.identification
    if estimate is None:
        raise ValueError("the benchmark needs an identification")
    return estimate.stiffness[:, AXIAL].copy(), estimate.damping[:, AXIAL].copy()


def _spread(name: str, errors: np.ndarray) -> dict[str, Any]:
    """Median and 95 % spread of the errors; None if a seed gave no estimate."""
    if not np.isfinite(errors).all():
        return {f"{name}_error": None, f"{name}_spread": None}
    low, high = np.quantile(errors, [0.025, 0.975])
    return {f"{name}_error": float(np.median(errors)), f"{name}_spread": [float(low), float(high)]}


def interval_coverage(seeds: int) -> dict[str, float]:
    """Share of seeds whose 95 % interval of k, and of c, contains the true value."""
    runs = [_again(CALIBRATION, CALIBRATION.noise, seed, "exact") for seed in range(seeds)]
    result = bounce([c.scenario(FORCE, METHODS["rls"]) for c in runs], THREADS)
    estimate = result.loop.identification
    held = {}
    for name, truth in (("stiffness", CALIBRATION.stiffness), ("damping", CALIBRATION.damping)):
        value, sd = getattr(estimate, name)[:, AXIAL], getattr(estimate, f"{name}_sd")[:, AXIAL]
        held[name] = float(np.mean(np.abs(value - truth) <= NORMAL_95 * sd))
    return held | {"seeds": float(seeds)}


def leaderboard(records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per method, by its largest error of c at 0.2 % noise; methods that gave no estimate
    in some contact rank last.
    """
    rows = []
    for method in dict.fromkeys(r["method"] for r in records):
        mine = [r for r in records if r["method"] == method and r["noise"] == 0.002]
        row: dict[str, Any] = {"method": method}
        for name in ("stiffness_error", "damping_error"):
            values = [r[name] for r in mine if r[name] is not None]
            row[name] = max(abs(v) for v in values) if values else None
            row[f"{name}_missing"] = len(mine) - len(values)
        if any("delay_error" in r for r in mine):
            row["delay_error"] = max(r["delay_error"] for r in mine)
        rows.append(row)
    return sorted(
        rows,
        key=lambda r: (
            r["damping_error_missing"],
            np.inf if r["damping_error"] is None else r["damping_error"],
        ),
    )


def _percent(value: float | None) -> str:
    return "no estimate" if value is None else f"{100 * value:.2f} %"
