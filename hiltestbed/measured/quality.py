"""Channels that are clipped at a limit, and channels that are quantised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array
from hiltestbed.measured.record import Record, place
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.survey import Survey, baseline

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


def clipped_samples(
    record: Record, found: Survey
) -> tuple[dict[str, NDArray[np.bool_]], list[Remark]]:
    """Group to ``(ticks, parts)``: which samples are at a limit; and a remark on each such
    channel.
    """
    clipped = {group: np.zeros_like(valid) for group, valid in record.valid.items()}
    remarks = []
    for name in record.columns():
        group, part = place(name)
        values = record.column(name)
        mask = _at_limit(values, baseline(record, found, name), record.steps.get(name, 0.0))
        if group == "pose_act":
            mask &= _held_back(record, part, values)
        elif not group.startswith("wrench"):
            continue
        if mask.any():
            clipped[group][:, part] = mask
            remarks.append(_clipped(record.run, name, values[mask]))
    return clipped, remarks


def _clipped(run: int, name: str, values: Array) -> Remark:
    levels = ", ".join(f"{level:.6g}" for level in np.unique(values))
    text = (
        f"is at its limit ({levels}) in {len(values)} samples, which it reaches with a "
        f"corner: clipped; larger values are lost"
    )
    evidence = {"samples": len(values), "limit": float(values[0])}
    return Remark(
        "loss", run, name, text, "raise the range of the channel, or run slower", evidence
    )


def _at_limit(values: Array, level: float, quantum: float) -> NDArray[np.bool_]:
    """Samples in flat stretches at the highest or lowest value that begin with a corner."""
    mask = np.zeros(len(values), dtype=bool)
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    if span < ROUND_OFF:
        return mask
    for extreme in (known.max(), known.min()):
        if abs(extreme - level) <= AWAY * span:
            continue
        edges = np.flatnonzero(np.diff(np.r_[False, values == extreme, False]))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            if end - start >= FLAT and _is_corner(values, int(start), int(end), quantum):
                mask[start:end] = True
    return mask


def _held_back(record: Record, part: int, values: Array) -> NDArray[np.bool_]:
    """Samples of a pose whose command goes beyond them: a pose that rests at its command is not at
    a limit.
    """
    if "pose_cmd" not in record.data or part > 2:
        return np.zeros(len(values), dtype=bool)
    with np.errstate(invalid="ignore"):
        return np.abs(record.data["pose_cmd"][:, part] - values) > 0.05 * np.nanmax(
            values - np.nanmin(values)
        )


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
        if np.isfinite(record.column(name)).sum() * step >= STEPS * np.ptp(
            record.column(name)[record.measured(name)]
        ):
            text = (
                f"comes in steps of {step:.4g}: a noise of {step / np.sqrt(12):.3g} (1 "
                f"sigma) at best"
            )
            remarks.append(Remark("note", record.run, name, text, "", {"step": step}))
    return remarks
