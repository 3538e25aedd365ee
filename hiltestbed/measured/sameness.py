"""Channels that are copies of others, and channels that are constant where they should move."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.ratio import CLEAR
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark, error
from hiltestbed.measured.shifts import compensated
from hiltestbed.measured.survey import Survey, extent
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

SAME_PART = 0.99  # part of the rows with equal numbers in two channels, above which one is a copy
# distinct values that a channel must have before another one can be its copy: at rest, coarsely
# quantised channels agree
NUMBERS = 4
MOVES = 1e-4  # [m] least motion of the other pose: encoders have steps
DEEP = 1e-5  # [m] penetration, or deviation from uniform motion, above which a force is expected


def copies_and_constants(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for columns that do not contain measurements of their channel."""
    yield from _copied_groups(record, scenario)
    yield from _copied_axes(record)
    yield from _constant_poses(record, found, scenario)
    yield from _constant_forces(record, found)


def _copied_groups(record: Record, scenario: Scenario) -> Iterator[Remark]:
    pairs = []
    if not scenario.rig.platform.physical:  # bodies that move freely have no command
        why = "the reached pose is the commanded one in every row"
        pairs.append(("pose_act", "pose_cmd", why))
    given = compensated(record, scenario)
    if given is not None:
        reading = record.filled("wrench_meas")
        if not np.allclose(given, reading, rtol=1e-9, atol=1e-12):
            why = f"though the scenario compensates ({scenario.compensation.force.kind})"
            pairs.append(("wrench_comp", "wrench_meas", why))
    for copy, original, why in pairs:
        columns = [(f"{copy}.{p}", f"{original}.{p}") for p in GROUPS[copy].parts]
        moving = [
            (record.column(a), record.column(b))
            for a, b in columns
            if record.has(a) and record.has(b) and extent(record.column(b)) > 0.0
        ]
        if moving and all(_same(a, b) for a, b in moving):
            text = f"is a copy of {original}: {why}; the link between them cannot be judged"
            fix = f"map the right columns of {copy}, or leave them out"
            yield error("copy", record.run, copy, text, fix)


def _copied_axes(record: Record) -> Iterator[Remark]:
    """Errors for an axis with the numbers of another axis of its group."""
    from scipy.stats import mode

    names = [n for n in record.columns() if extent(record.column(n)) > 0.0]
    for group in {n.rpartition(".")[0] for n in names}:
        for first, second in combinations([n for n in names if n.startswith(group + ".")], 2):
            a, b = record.column(first), record.column(second)
            # where one is not at its most frequent value: at rest coarse channels agree
            moving = (a != mode(a, nan_policy="omit").mode) | (b != mode(b, nan_policy="omit").mode)
            if _same(a[moving], b[moving]):
                text = f"has the numbers of {first} in every row: a copy"
                fix = f"map the right column of {second}, or leave it out"
                yield error("copy", record.run, second, text, fix)


def _constant_poses(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for a pose that is constant while the other, or the scenario, moves."""
    ranges = {name: extent(record.column(name)) for name in record.columns()}
    for name, other in (("pose_act", "pose_cmd"), ("pose_cmd", "pose_act")):
        for a, b in ((f"{name}.{part}", f"{other}.{part}") for part in ("px", "py", "pz")):
            if not (ranges.get(a) == 0.0 and b in ranges):
                continue
            if ranges[b] > max(MOVES, CLEAR * found.noise[b].white):
                text = f"is {_first(record, a)} in every row while {b} moves by {ranges[b]:.3g} m"
                fix = f"map the right column of {a}, or leave it out"
                yield error("constant", record.run, a, text, fix)
        a, travel = f"{name}.pz", abs(scenario.approach.velocity[2]) * float(record.t[-1])
        if ranges.get(a) == 0.0 and f"{other}.pz" not in ranges and travel > DEEP:
            text = f"is {_first(record, a)} in every row; the scenario moves by {travel:.3g} m"
            yield error("constant", record.run, a, text, f"map the right column of {a}")


def _constant_forces(record: Record, found: Survey) -> Iterator[Remark]:
    """Errors for a force that is constant during a penetration."""
    deepest = max((c.penetration or 0.0 for c in found.contacts), default=0.0)
    if max(deepest, _bend(record)) <= DEEP:
        return
    for group in ("wrench_meas", "wrench_comp"):
        forces = [n for n in (f"{group}.f{a}" for a in "xyz") if record.has(n)]
        if forces and all(extent(record.column(n)) == 0.0 for n in forces):
            text = (
                f"is constant in every row while the mechanisms penetrate by "
                f"{1e3 * deepest:.3g} mm and the motion is not uniform"
            )
            fix = f"map the right columns of {group}, or leave them out"
            yield error("constant", record.run, f"{group}.fz", text, fix)


def _bend(record: Record) -> float:
    """[m] deviation of the motion from a straight line in time, which only a force can cause."""
    bends = [0.0]
    for name in filter(record.has, (f"pose_cmd.p{a}" for a in "xyz")):
        values = record.column(name)
        known = np.isfinite(values)
        if known.sum() > 10:
            t, values = record.t[known], values[known]
            line = np.polyval(np.polyfit(t - t[0], values, 1), t - t[0])
            bends.append(float(np.abs(values - line).max()))
    return max(bends)


def _same(a: Array, b: Array) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    return (
        both.sum() > 10
        and float(np.mean(a[both] == b[both])) >= SAME_PART
        and len(np.unique(a[both])) >= NUMBERS
    )


def _first(record: Record, name: str) -> str:
    values = record.column(name)
    known = values[np.isfinite(values)]
    return f"{known[0] if len(known) else np.nan:.6g}"
