"""Survey of a run: noise floor before the first touch, contacts, and excited axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltestbed.contact.sides import sides_of
from hiltestbed.frames import Array
from hiltestbed.measured.noise import FREE_MINIMUM, MOVED, Noise, noise_of, white_noise
from hiltestbed.measured.record import Record, stretches
from hiltestbed.measured.remark import Remark, loss, note
from hiltestbed.scenario import Scenario

ONSET = 8.0  # sigma, for ONSET_TICKS successive ticks: the force has left its noise floor
ONSET_TICKS = 4
FORCES = ("wrench_meas.fz", "wrench_meas.fx", "wrench_meas.fy")
Spans = list[tuple[int, int]]  # first tick of each, and the one after its last


@dataclass(frozen=True)
class ContactSpan:
    """One contact: ticks ``start`` to ``end`` (exclusive), its peaks along z, and the largest force
    along any of the axes that show it; None for a figure without its channel.
    """

    start: int
    end: int
    peak_force: float | None
    penetration: float | None
    speed: float | None
    pressed: float | None


@dataclass(frozen=True)
class Survey:
    """Survey of one run.

    Attributes:
        free: ticks before the first touch.
        noise: column to its noise.
        contacts: in order; a latched contact lasts to the end, even if the force passes through
            zero.
        excited: columns with a range of more than MOVED sigma.
    """

    free: int
    noise: dict[str, Noise]
    contacts: tuple[ContactSpan, ...]
    excited: tuple[str, ...]

    def touching(self, rows: int, late: int, least: float = 0.0) -> np.ndarray:
        """``(rows,)`` bool: in a contact of at least ``least`` [N], or the sensor, ``late`` [ticks]
        behind, still shows it.
        """
        out = np.zeros(rows, dtype=bool)
        for c in self.contacts:
            if c.pressed is None or c.pressed >= least:
                out[max(0, c.start - 2) : c.end + late + 3] = True
        return out


def look(record: Record, scenario: Scenario) -> Survey:
    """Noise, contacts and excitation of a record."""
    latched, flat = scenario.mechanism.captured, scenario.mechanism.flat
    depth = penetration(record)
    # parts that swing are also pressed laterally
    felt = FORCES[:1] if sides_of(scenario.mechanism).rigid else FORCES
    felt = tuple(name for name in felt if record.has(name))
    free = 0 if latched else _free_ticks(record, depth, felt)
    noise = {
        n: noise_of(record.column(n), free, record.steps.get(n, 0.0), n.startswith("pose"))
        for n in record.columns()
    }
    spans = [(0, record.ticks)] if latched else []
    # each finds what the other misses: a tilted port meets a plane early
    for by_pose in (flat, not flat):
        spans = spans or _spans(record, depth if by_pose else None, noise, felt)
    spans = _held(spans, record, depth, scenario)
    contacts = tuple(_contact(record, span, depth, scenario, felt) for span in spans)
    excited = tuple(
        name
        for name in record.columns()
        if extent(record.column(name)) > MOVED * max(noise[name].white, 1e-300)
    )
    return Survey(free, noise, contacts, excited)


def penetration(record: Record) -> Array | None:
    """``(ticks,)`` reached pz [m], or commanded; NaN in gaps, None without either."""
    name = _depth_name(record)
    return record.column(name) if record.has(name) else None


def _depth_name(record: Record) -> str:
    return "pose_act.pz" if record.has("pose_act.pz") else "pose_cmd.pz"


def remarks_on(record: Record, found: Survey, scenario: Scenario) -> list[Remark]:
    """Remarks on runs without contact, and on contacts in which pose and force disagree."""
    run, depth, force = record.run, penetration(record), record.has("wrench_meas.fz")
    if scenario.mechanism.captured or (depth is None and not force):
        return []
    if not found.contacts:
        deepest = "" if depth is None else f" (pz reaches {np.nanmax(depth):.4g} m)"
        text = f"has no contact{deepest}; contact, sensor and compensation cannot be judged from it"
        return [loss(run, "", text)]
    if not force or depth is None:
        return []
    peak = max(abs(c.peak_force or 0.0) for c in found.contacts)
    floor = found.noise["wrench_meas.fz"].white
    if peak > MOVED * floor:
        return []
    deepest = max(c.penetration or 0.0 for c in found.contacts)
    text = (
        f"stays within {peak:.3g} N (noise {floor:.3g} N) while the mechanisms "
        f"penetrate by {1e3 * deepest:.3g} mm"
    )
    fix = "check that the sensor was on and its column is the right one"
    return [note(run, "wrench_meas.fz", text, fix)]


def from_baseline(record: Record, found: Survey, name: str) -> Array:
    """``(ticks,)`` of a column, from its level before the first touch."""
    return record.column(name) - baseline(record, found, name)


def baseline(record: Record, found: Survey, name: str) -> float:
    """Median of a column before the first touch; 0 if there are too few samples."""
    free = record.column(name)[: found.free]
    free = free[np.isfinite(free)]
    return float(np.median(free)) if len(free) >= FREE_MINIMUM else 0.0


def _free_ticks(record: Record, depth: Array | None, felt: tuple[str, ...]) -> int:
    """Ticks before the first touch, by the pose or the forces ``felt``, whichever is first."""
    ends = [record.ticks]
    if depth is not None:
        ends += np.flatnonzero(depth > 0)[:1].tolist()
    for name in felt:
        force = _bridged(record.column(name))
        still = _still(force)
        sigma = max(white_noise(still), float(np.std(still)))
        out = np.abs(force - np.median(still)) > ONSET * sigma
        if len(out) >= ONSET_TICKS:
            lasting = np.lib.stride_tricks.sliding_window_view(out, ONSET_TICKS).all(axis=1)
            ends += np.flatnonzero(lasting)[:1].tolist()
    return max(0, int(min(ends)) - 2)


def _still(force: Array) -> Array:
    """The first rows; if they must contain a touch, the quietest stretch of that length."""
    rows = 2 * FREE_MINIMUM
    first = force[:rows]
    if len(force) < 2 * rows:
        return first
    parts = force[: len(force) // rows * rows].reshape(-1, rows)
    quietest = parts[np.std(parts, axis=1).argmin()]
    return quietest if np.std(first) > ONSET * np.std(quietest) > 0.0 else first


def _spans(
    record: Record, depth: Array | None, noise: dict[str, Noise], felt: tuple[str, ...]
) -> Spans:
    """Each contact: pz > 0 if ``depth`` is given, else one of the forces above its noise floor."""
    if depth is not None:
        return _above(_bridged(depth), 0.0, 5 * noise[_depth_name(record)].white)
    if not felt:
        return []
    forces = [np.abs(_bridged(record.column(n))) / max(noise[n].rms, 1e-12) for n in felt]
    spans = _above(np.max(forces, axis=0), 2.0, ONSET)
    return [(start, end) for start, end in spans if end - start >= ONSET_TICKS]


def _held(spans: Spans, record: Record, depth: Array | None, scenario: Scenario) -> Spans:
    """The spans, with the final ones within the range of a latch merged into one: the depth at
    which it closes, plus the deflection of its springs, which oscillate under the load.
    """
    latch = scenario.mechanism.latch
    if latch is None or depth is None or not spans:
        return spans
    reached = _bridged(depth)
    way = np.ptp(reached[-FREE_MINIMUM:]) / max(1, min(FREE_MINIMUM, record.ticks) - 1)
    if way * scenario.rate > latch.speed:
        return spans
    force = (
        np.nanmax(np.abs(record.data["wrench_meas"][:, :3])) if record.has("wrench_meas") else 0.0
    )
    give = 2.0 * force / scenario.mechanism.contact.stiffness
    outside = np.flatnonzero(reached < -latch.depth - give)
    closed = int(outside[-1]) + 1 if len(outside) else 0
    later = [start for start, end in spans if end > closed]
    return [*(s for s in spans if s[1] <= closed), (later[0], record.ticks)] if later else spans


def _above(values: Array, low: float, high: float) -> Spans:
    """Stretches above ``low`` that exceed ``high`` at some point."""
    return [(a, b) for a, b in stretches(values > low) if values[a:b].max() > high]


def _contact(
    record: Record,
    span: tuple[int, int],
    depth: Array | None,
    scenario: Scenario,
    felt: tuple[str, ...],
) -> ContactSpan:
    (start, end), late = span, round(scenario.sensor.delay * scenario.rate)
    speed = deepest = None
    forces: dict[str, float] = {}
    for name in felt:
        part = record.column(name)[start : end + late + 1]
        part = part[np.isfinite(part)]
        if len(part):
            forces[name] = float(part[np.abs(part).argmax()])
    if depth is not None:
        inside = depth[start:end]
        deepest = float(np.nanmax(inside)) if np.isfinite(inside).any() else None
        before = np.flatnonzero(np.isfinite(depth[:start]))[-FREE_MINIMUM:]
        if len(before) > 4:
            speed = float(np.polyfit(record.t[before] - record.t[start], depth[before], 1)[0])
    largest = max(map(abs, forces.values()), default=None)
    return ContactSpan(start, end, forces.get(FORCES[0]), deepest, speed, largest)


def _bridged(values: Array) -> Array:
    """``values`` with missing ones interpolated: of a slow log most ticks are missing."""
    known = np.isfinite(values)
    if known.all() or not known.any():
        return np.nan_to_num(values)
    rows = np.arange(len(values))
    return np.interp(rows, rows[known], values[known])


def extent(values: Array) -> float:
    """Largest minus least of the known ``values``; 0 without any."""
    known = values[np.isfinite(values)]
    return float(np.ptp(known)) if len(known) else 0.0
