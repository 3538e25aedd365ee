"""The indices of HILDOCK-1: arrays in, numbers out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hiltestbed.bench.hildock.problem import (
    SPEED,
    START,
    TICK,
    TRACKS,
    Case,
    Course,
    in_order,
)

LAST = 40  # ticks over which the rebound speed is taken: 20 ms
INDICES = (
    "cor_log_error",
    "energy_generated",
    "peak_force_error",
    "contact_time_error",
    "tracking_error",
    "stiffness_error",
    "damping_error",
)


def rebound(course: Course) -> float | None:
    """Coefficient of restitution, or None where the mass has not left at the end."""
    if course.diverged or len(course.position) <= LAST or course.position[-1] > 0.0:
        return None
    e = (course.position[-1 - LAST] - course.position[-1]) / (LAST * TICK * SPEED)
    return e if e > 0.0 else None


def causal_bound(case: Case, ideal: Course) -> float:
    """Least error of the peak force of a first contact: until the first delayed force has arrived,
    no method can know that there is a contact, and the mass flies on freely.
    """
    force, k, touch = 0.0, 0, None
    while touch is None or k - case.delay / TICK <= touch - 1:
        # the force at tick k + 1, which the answer to tick k commands before anything is known
        k += 1
        x = START + k * TICK * SPEED
        touch = k if touch is None and x > 0.0 else touch
        force = max(force, case.force(x, SPEED))
    return max(0.0, force / max(ideal.force) - 1.0)


def indices(case: Case, course: Course, ideal: Course) -> dict[str, Any]:
    """The record of one case; an index that does not exist is None."""
    e, true = rebound(course), rebound(ideal)
    if true is None:
        raise ValueError(f"case {case.number}: the reference does not leave its contact")
    record: dict[str, Any] = {
        "case": case.number,
        "track": case.track,
        "frequency": case.frequency,
        "delay": case.delay,
        "delay_told": case.told,
        "damping_ratio": case.damping_ratio,
        "cor": e,
        "cor_reference": true,
        "peak_force_bound": causal_bound(case, ideal),
        **dict.fromkeys(INDICES),
    }
    if e is None:
        return record
    touched = sum(f > 0.0 for f in ideal.force)
    n = max(k for k, f in enumerate(ideal.force) if f > 0.0) + 1
    off = [a - b for a, b in zip(course.position[:n], ideal.position[:n], strict=True)]
    record |= {
        "cor_log_error": math.log(e / true),
        "energy_generated": e * e - true * true,
        "peak_force_error": max(course.force) / max(ideal.force) - 1.0,
        "contact_time_error": sum(f > 0.0 for f in course.force) / touched - 1.0,
        "tracking_error": math.sqrt(in_order(d * d for d in off) / n) / max(ideal.position),
    }
    if course.identified is not None and case.track not in ("hunt_crossley", "hard_stop"):
        k, c = course.identified
        record |= {
            "stiffness_error": k / case.stiffness - 1.0,
            "damping_error": c / case.damping - 1.0,
        }
    return record


def percentile_95(values: Sequence[float]) -> float:
    """The nearest rank: of n sorted values number ceil(0.95 n), counted from one."""
    return sorted(values)[math.ceil(0.95 * len(values)) - 1]


def by_track(records: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Track to its totals: `failed` cases without a rebound; worst and 95th percentile of the
    magnitude of each index; None where a case has none. Energy counts where it is made.
    """
    board = {}
    for track in TRACKS:
        mine = [r for r in records if r["track"] == track]
        row: dict[str, Any] = {"failed": sum(r["cor"] is None for r in mine)}
        for index in INDICES:
            found = [r[index] for r in mine]
            whole = bool(found) and None not in found
            size = [max(0.0, v) if index == "energy_generated" else abs(v) for v in found if whole]
            row[f"{index}_worst"] = max(size) if whole else None
            row[f"{index}_p95"] = percentile_95(size) if whole else None
        board[track] = row
    return board
