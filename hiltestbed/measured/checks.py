"""The check of measured data before a diagnosis: every finding with its numbers and a proposed fix.
Here: what a dataset lacks, and channels that are clipped at a limit or quantised.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array
from hiltestbed.measured.plausible import contradictions
from hiltestbed.measured.record import Record, place, stretches
from hiltestbed.measured.remark import Remark, loss, note
from hiltestbed.measured.survey import Survey, baseline, extent, look, remarks_on
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

NEEDED = ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp")
FLAT = 4  # successive equal samples at an extreme value, at least, for clipping to be considered
CORNER = 6.0  # quanta; the rounded top of a smooth signal gives 3, see `_is_corner`
# of the range: least distance of a limit from the free level, since a force of zero between
# contacts is no limit
AWAY = 0.2
# [m], [N], [N m]: below any sensor's resolution; a simulated channel that should be zero may
# contain it
ROUND_OFF = 1e-9
# samples per step over the range, above which a note is given: a CSV file with six digits has
# steps, too
STEPS = 4


def check_run(record: Record, scenario: Scenario) -> tuple[Record, Survey, list[Remark]]:
    """The record with its clipped samples marked, its survey, and all remarks on it."""
    found = look(record, scenario)
    clipped, remarks = clipped_samples(record, found)
    remarks += contradictions(record, found, scenario)
    remarks += quantisation(record)
    wrong = any(remark.severity == "error" for remark in remarks)
    remarks += [] if wrong else remarks_on(record, found, scenario)
    if record.ticks > scenario.ticks * 1.01 + 1:
        text = f"lasts {record.t[-1]:.6g} s, longer than the scenario's {scenario.duration:.6g} s"
        remarks.append(note(record.run, "t", text, duration=float(record.t[-1])))
    return replace(record, clipped=clipped), found, remarks


def check_dataset(
    records: Sequence[Record], names: Sequence[str], links: Mapping[str, tuple[str, ...]]
) -> list[Remark]:
    """Remarks on links without input or output and on missing axes; ``names``: of the runs."""
    remarks = []
    for group in NEEDED:
        have = [record for record in records if record.has(group)]
        without = [record.run for record in records if not record.has(group)]
        cut = [link for link, ends in links.items() if group in ends]
        if without:
            where = f"not in {', '.join(names[run] for run in without)}" if have else "in no run"
            text = (
                f"was measured {where}: the link{'s' if len(cut) > 1 else ''} "
                f"{' and '.join(cut)} cannot be judged there"
            )
            remarks.append(loss(None, group, text, runs=len(without)))
        columns = zip(GROUPS[group].columns, GROUPS[group].parts, strict=True)
        parts = [part for column, part in columns if any(column in r.absent for r in have)]
        if parts:
            text = f"lacks {', '.join(parts)} in some or all runs; they are taken as absent"
            remarks.append(loss(None, group, text, axes=len(parts)))
    return remarks


def clipped_samples(
    record: Record, found: Survey
) -> tuple[dict[str, NDArray[np.bool_]], list[Remark]]:
    """Group to ``(ticks, parts)``: samples at a limit; and a remark on each such channel."""
    clipped = {group: np.zeros_like(valid) for group, valid in record.valid.items()}
    remarks = []
    for name in record.columns():
        group, part = place(name)
        if group != "pose_act" and not group.startswith("wrench"):
            continue
        values = record.column(name)
        mask = _at_limit(values, baseline(record, found, name), record.steps.get(name, 0.0))
        if group == "pose_act":
            mask &= _held_back(record, part, values)
        if mask.any():
            clipped[group][:, part] = mask
            levels = ", ".join(f"{level:.6g}" for level in np.unique(values[mask]))
            count, limit = int(mask.sum()), float(values[mask][0])
            text = (
                f"is at its limit ({levels}) in {count} samples, which it reaches with a "
                f"corner: clipped; larger values are lost"
            )
            fix = "raise the range of the channel, or run slower"
            remarks.append(loss(record.run, name, text, fix, samples=count, limit=limit))
    return clipped, remarks


def _at_limit(values: Array, level: float, quantum: float) -> NDArray[np.bool_]:
    """Samples in flat stretches at the highest or lowest value that begin with a corner."""
    mask = np.zeros(len(values), dtype=bool)
    span = extent(values)
    if span < ROUND_OFF:
        return mask
    for extreme in (np.nanmax(values), np.nanmin(values)):
        if abs(extreme - level) <= AWAY * span:
            continue
        for start, end in stretches(values == extreme):
            if end - start >= FLAT and _is_corner(values, start, end, quantum):
                mask[start:end] = True
    return mask


def _held_back(record: Record, part: int, values: Array) -> NDArray[np.bool_]:
    """Samples of a pose short of its command: one that rests at its command is at no limit."""
    if not record.has("pose_cmd") or part > 2:
        return np.zeros(len(values), dtype=bool)
    least = 0.05 * np.nanmax(values - np.nanmin(values))
    with np.errstate(invalid="ignore"):
        return np.abs(record.data["pose_cmd"][:, part] - values) > least


def _is_corner(values: Array, start: int, end: int, quantum: float) -> bool:
    """Whether the signal enters the flat stretch too steeply for a rounded top.

    A parabola a t^2/2 quantised in steps of q stays on the last step for T = sqrt(2 q/a) on either
    side of its top, and falls by a (2 T)^2/2 - q = 3 q during the next T, however wide the top. A
    clipped signal has no such bound.
    """
    half = max(2, (end - start) // 2)
    falls = [abs(values[start] - values[start - half])] if start >= half else []
    falls += [abs(values[end - 1] - values[end - 1 + half])] if end - 1 + half < len(values) else []
    falls = [fall for fall in falls if np.isfinite(fall)]
    return bool(falls) and min(falls) > CORNER * quantum


def quantisation(record: Record) -> list[Remark]:
    """A note on each quantised channel."""
    remarks = []
    for name, step in record.steps.items():
        values = record.column(name)
        if np.isfinite(values).sum() * step >= STEPS * np.ptp(values[record.measured(name)]):
            text = (
                f"comes in steps of {step:.4g}: a noise of {step / np.sqrt(12):.3g} (1 "
                f"sigma) at best"
            )
            remarks.append(note(record.run, name, text, step=step))
    return remarks
