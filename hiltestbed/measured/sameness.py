"""Channels that are copies of others, and channels that are constant where they should move."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.shifts import compensated
from hiltestbed.measured.survey import Survey
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

SAME_PART = 0.99  # part of the rows with equal numbers in two channels, above which one is a copy
# distinct values that a channel must have before another one can be its copy: at rest, coarsely
# quantised channels agree
NUMBERS = 4
TRAVEL = 20.0  # least range of a channel, in noise floors, for a copy of it to be significant
MOVES = 1e-4  # [m] least motion of the other pose: encoders have steps
DEEP = 1e-5  # [m] penetration, or deviation from uniform motion, above which a force is expected


def copies_and_constants(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for columns that do not contain measurements of their channel."""
    yield from _copied_groups(record, scenario)
    yield from _copied_axes(record)
    yield from _constants(record, found, scenario)


def _copied_groups(record: Record, scenario: Scenario) -> Iterator[Remark]:
    commanded = not scenario.rig.platform.physical  # bodies that move freely have no command
    pairs = (
        [("pose_act", "pose_cmd", "the reached pose is the commanded one in every row")]
        if commanded
        else []
    )
    given = compensated(record, scenario)
    if given is not None and not np.allclose(
        given, record.filled("wrench_meas"), rtol=1e-9, atol=1e-12
    ):
        pairs.append(
            (
                "wrench_comp",
                "wrench_meas",
                f"though the scenario compensates ({scenario.compensation.force.kind})",
            )
        )
    for copy, original, why in pairs:
        if not (record.has(copy) and record.has(original)):
            continue
        columns = [(f"{copy}.{p}", f"{original}.{p}") for p in GROUPS[copy].parts]
        moving = [
            (a, b)
            for a, b in columns
            if {a, b} <= set(record.columns()) and _range(record.column(b)) > 0.0
        ]
        if moving and all(_same(record.column(a), record.column(b)) for a, b in moving):
            text = f"is a copy of {original}: {why}; the link between them cannot be judged"
            yield Remark(
                "error",
                record.run,
                copy,
                text,
                f"map the right columns of {copy}, or leave them out",
                {},
                "copy",
            )


def _copied_axes(record: Record) -> Iterator[Remark]:
    """Errors for an axis with the numbers of another axis of its group."""
    names = [n for n in record.columns() if _range(record.column(n)) > 0.0]
    for group in {n.rpartition(".")[0] for n in names}:
        own = [n for n in names if n.startswith(group + ".")]
        for i, first in enumerate(own):
            for second in own[i + 1 :]:
                if _same(*_moving(record.column(first), record.column(second))):
                    text = f"has the numbers of {first} in every row: a copy"
                    yield Remark(
                        "error",
                        record.run,
                        second,
                        text,
                        f"map the right column of {second}, or leave it out",
                        {},
                        "copy",
                    )


def _constants(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for a pose that is constant while the other moves, and for a force that is constant
    during a penetration.
    """
    columns = set(record.columns())
    for name, other in (("pose_act", "pose_cmd"), ("pose_cmd", "pose_act")):
        for part in ("px", "py", "pz"):
            a, b = f"{name}.{part}", f"{other}.{part}"
            if (
                {a, b} <= columns
                and _range(record.column(a)) == 0.0
                and _range(record.column(b)) > max(MOVES, TRAVEL * _floor(found, b))
            ):
                text = (
                    f"is {_first(record.column(a)):.6g} in every row while {b} moves by "
                    f"{_range(record.column(b)):.3g} m"
                )
                yield Remark(
                    "error",
                    record.run,
                    a,
                    text,
                    f"map the right column of {a}, or leave it out",
                    {},
                    "constant",
                )
        if (
            {f"{name}.pz"} <= columns
            and f"{other}.pz" not in columns
            and _range(record.column(f"{name}.pz")) == 0.0
        ):
            travel = abs(scenario.approach.velocity[2]) * float(record.t[-1])
            if travel > DEEP:
                text = (
                    f"is {_first(record.column(f'{name}.pz')):.6g} in every row; the "
                    f"scenario moves by {travel:.3g} m"
                )
                yield Remark(
                    "error",
                    record.run,
                    f"{name}.pz",
                    text,
                    f"map the right column of {name}.pz",
                    {},
                    "constant",
                )
    deepest = max((c.penetration or 0.0 for c in found.contacts), default=0.0)
    for group in ("wrench_meas", "wrench_comp"):
        forces = [f"{group}.f{a}" for a in "xyz" if f"{group}.f{a}" in columns]
        if (
            forces
            and max(deepest, _bend(record)) > DEEP
            and all(_range(record.column(n)) == 0.0 for n in forces)
        ):
            text = (
                f"is constant in every row while the mechanisms penetrate by "
                f"{1e3 * deepest:.3g} mm and the motion is not uniform"
            )
            yield Remark(
                "error",
                record.run,
                f"{group}.fz",
                text,
                f"map the right columns of {group}, or leave them out",
                {},
                "constant",
            )


def _bend(record: Record) -> float:
    """[m] deviation of the motion from a straight line in time, which only a force can cause."""
    bends = [0.0]
    for name in (f"pose_cmd.p{a}" for a in "xyz"):
        if name in record.columns():
            values = record.column(name)
            known = np.isfinite(values)
            if known.sum() > 10:
                t = record.t[known]
                bends.append(
                    float(
                        np.abs(
                            values[known]
                            - np.polyval(np.polyfit(t - t[0], values[known], 1), t - t[0])
                        ).max()
                    )
                )
    return max(bends)


def _moving(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows in which one of the two is not at its most frequent value: at rest, coarsely
    quantised channels agree.
    """
    away = np.zeros(len(a), dtype=bool)
    for values in (a, b):
        known = values[np.isfinite(values)]
        numbers, counts = np.unique(known, return_counts=True)
        if len(numbers):
            away |= values != numbers[counts.argmax()]
    return a[away], b[away]


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    both = np.isfinite(a) & np.isfinite(b)
    return (
        both.sum() > 10
        and float(np.mean(a[both] == b[both])) >= SAME_PART
        and len(np.unique(a[both])) >= NUMBERS
    )


def _range(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if len(known) else 0.0


def _first(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known[0]) if len(known) else float("nan")


def _floor(found: Survey, name: str) -> float:
    return found.noise[name].white if name in found.noise else 0.0
