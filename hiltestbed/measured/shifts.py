"""Channels that are some rows early or late in the record: an output that precedes its input, which
no rig can produce.

Three of the four links of the loop have a delay that is known to a fraction of a row: the numerical
model moves the pose by the force of the same row; a platform with ideal tracking reaches its
command one row later; and the noise of the sensor passes the compensation in the row in which it is
read. A shifted channel makes the link before it too late and the link after it too early by the
same number of rows.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import correlate

from hiltestbed.compensation.input import InputParameters
from hiltestbed.frames import Array
from hiltestbed.measured.late import force_leads
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.survey import Survey
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, follows_exactly, replay_compensation, replay_model
from hiltestbed.replay.compensation import needs
from hiltestbed.scenario import Scenario

FURTHEST = 40  # largest shift that is searched [rows]
REMAINDER = 0.1  # part of the misfit that may remain once the shift is removed
EXCHANGED = 0.02  # part of the misfit that remains if two forces are exchanged
ECHO = 0.3  # correlation of the noise of two forces, above which it is the same noise
# rows; smaller shifts give a note: loggers stamp each channel up to a row early or late
LOGGER = 2.25
LEAD_LIMIT = 0.5  # [rows] least lead over the earliest possible response of a platform that counts
CLEAR = 20.0  # least motion of the pose within a row, over all rows together, in noise floors


def shifts(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for an output that precedes its input by more than a logger's stamping can explain;
    notes for smaller shifts.
    """
    if abs(record.sample_rate * scenario.tick - 1.0) > 1e-3:
        return  # the rows of the file are not ticks of the loop
    given = compensated(record, scenario)
    if _exchanged_forces(record, scenario, given):
        text = (
            "does not give wrench_comp by the scenario's compensation, but wrench_comp "
            "gives it: the two are exchanged"
        )
        yield Remark(
            "error",
            record.run,
            "wrench_meas",
            text,
            "exchange the columns of wrench_meas and wrench_comp",
            {},
            "shift",
        )
        return
    others = list(_out_of_order(record, found, scenario, given))
    leads, ahead = force_leads(record, found, scenario), _platform_lead(record, found, scenario)
    if leads and (not others or (ahead is not None and abs(ahead + leads) < 1.0)):
        yield _led(record, leads, ahead, scenario)
    yield from others


def _out_of_order(
    record: Record, found: Survey, scenario: Scenario, given: Array | None
) -> Iterator[Remark]:
    """Remarks on outputs that precede their inputs, on the links with a known delay."""
    moved = _model_lag(record, scenario)
    echo = _echo(record, given)
    ahead = _platform_lead(record, found, scenario)
    if moved is not None and moved != 0 and echo == -moved:
        yield _shifted(
            record,
            "wrench_comp",
            -moved,
            scenario,
            "neither follows wrench_meas nor moves pose_cmd when it should",
        )
    elif moved is not None and moved < 0 and echo in (0, None):
        channel = "pose_cmd" if echo == 0 or ahead is None or ahead < 0 else "wrench_comp"
        yield _shifted(
            record,
            channel,
            moved if channel == "pose_cmd" else -moved,
            scenario,
            "pose_cmd moves before wrench_comp pushes it",
        )
    elif moved == 0 and echo is not None and echo > 0:
        yield _shifted(
            record,
            "wrench_meas",
            -echo,
            scenario,
            f"its noise shows in wrench_comp {echo} rows later",
        )
    elif moved == 0 and echo is not None and echo < 0:
        yield _answered(record, -echo, scenario, "its noise shows in wrench_comp before it")
    elif (
        not record.has("wrench_comp")
        and given is not None
        and (answered := _model_lag(record, scenario, given) or 0) < 0
    ):
        yield _answered(
            record,
            -answered,
            scenario,
            "pose_cmd moves before the believed compensation of it pushes",
        )
    if ahead is not None and ahead > 0:
        yield _ahead(record, ahead, moved, scenario, found)


def _shifted(record: Record, channel: str, rows: float, scenario: Scenario, why: str) -> Remark:
    """Remark on a channel that is ``rows`` late in the record; early if negative."""
    when = f"{abs(rows):.3g} row{'s' if abs(rows) != 1 else ''} {'late' if rows > 0 else 'early'}"
    seconds = -rows * scenario.tick
    fix = f"move it by {seconds:.6g} s before the export: all channels share the rows of one clock"
    return _remark(record, channel, f"is {when} in the record: {why}", fix, rows)


def _remark(record: Record, channel: str, text: str, fix: str, rows: float) -> Remark:
    return Remark(
        "error" if abs(rows) > LOGGER else "note",
        record.run,
        channel,
        text,
        fix,
        {"rows": float(rows)},
        "shift",
    )


def _ahead(
    record: Record, rows: float, moved: int | None, scenario: Scenario, found: Survey
) -> Remark:
    if moved is not None and moved > 0 and abs(moved - rows) < 1.0:
        return _shifted(
            record,
            "pose_cmd",
            float(moved),
            scenario,
            "the platform precedes it, and it follows its force too late",
        )
    if abs(rows - 2.0) < LEAD_LIMIT and _rough(found, "pose_cmd") > 3 * _rough(found, "pose_act"):
        text = (
            "follows pose_act a row later and carries a sensor's noise, which pose_act "
            "does not: the two are exchanged"
        )
        return Remark(
            "error",
            record.run,
            "pose_cmd",
            text,
            "exchange the columns of pose_cmd and pose_act",
            {"rows": rows},
            "shift",
        )
    text = (
        f"precedes the response to its command by {rows:.3g} rows: it is early in the "
        f"record, or exchanged with pose_cmd"
    )
    fix = (
        f"move it by {rows * scenario.tick:.6g} s before the export, or exchange the "
        f"columns of pose_cmd and pose_act"
    )
    return _remark(record, "pose_act", text, fix, rows)


def _answered(record: Record, rows: int, scenario: Scenario, why: str) -> Remark:
    """A note, not an error: the diagnosis has an effect for a force that is late only in the
    record.
    """
    text = (
        f"has its effect {rows} rows before it is in the record, since {why}: the record "
        f"is late, not the loop"
    )
    fix = (
        f"move it by {-rows * scenario.tick:.6g} s before the export; otherwise the "
        f"diagnosis may name log.skew or a late sensor"
    )
    return Remark("note", record.run, "wrench_meas", text, fix, {"rows": float(rows)}, "shift")


def _led(record: Record, rows: int, lead: float | None, scenario: Scenario) -> Remark:
    """Remark on a force ``rows`` before the contact of the recorded pose; the platform's ``lead``
    shows which of the two was shifted.
    """
    if lead is not None and abs(lead + rows) < 1.0:
        return _shifted(
            record,
            "pose_act",
            rows,
            scenario,
            "wrench_meas shows the contact before it, and pose_cmd precedes it by as much",
        )
    text = (
        f"shows the contact {rows} rows before pose_act does: one of the two was "
        f"shifted, or the sensor is faster than sensor.delay"
    )
    by = rows * scenario.tick
    fix = (
        f"move pose_act by {-by:.6g} s or wrench_meas by {by:.6g} s before the export, or "
        f"correct sensor.delay"
    )
    return _remark(record, "wrench_meas", text, fix, rows)


def _rough(found: Survey, group: str) -> float:
    return max(
        (
            found.noise[n].white
            for n in (f"{group}.px", f"{group}.py", f"{group}.pz")
            if n in found.noise
        ),
        default=0.0,
    )


def _model_lag(record: Record, scenario: Scenario, given: Array | None = None) -> int | None:
    """Whole rows by which pose_cmd responds late to the force (negative: early); None if it cannot
    be determined, 0 if it fits unchanged.

    given: (ticks, 6) used instead of the recorded wrench_comp.
    """
    names = [f"pose_cmd.p{a}" for a in "xyz"]
    names += (
        [f"wrench_comp.{p}" for p in ("fx", "fy", "fz", "tx", "ty", "tz")] if given is None else []
    )
    if not set(names) <= set(record.columns()) or not all(record.measured(n).all() for n in names):
        return None
    wrench = np.ascontiguousarray(record.data["wrench_comp"] if given is None else given)
    both = np.stack([wrench, np.zeros_like(wrench)])
    poses = replay_model(
        Departing([scenario] * 2, stack([DynamicsParameters()] * 2)), both, np.arange(2)
    )
    if not np.isfinite(poses).all() or record.ticks < 4 * FURTHEST:
        return None
    pushed = poses[0, :, :3] - poses[1, :, :3]
    shown = record.data["pose_cmd"][:, :3] - poses[1, :, :3]
    inner = slice(FURTHEST, record.ticks - FURTHEST)
    t = record.t[inner]
    left = np.array(
        [
            _misfit(t, shown[inner], pushed[FURTHEST - n : record.ticks - FURTHEST - n])
            for n in range(-FURTHEST, FURTHEST + 1)
        ]
    )
    best = int(np.argmin(left)) - FURTHEST
    now = left[FURTHEST]
    if now < 1e-18 * max(1.0, float(np.sum(shown**2))) or best == 0:
        return 0
    if left.min() < REMAINDER * now and abs(best) < FURTHEST:
        return best
    return 0


def _misfit(t: Array, shown: Array, pushed: Array) -> float:
    """Sum of squares of ``shown`` (rows, 3) minus ``pushed`` and a straight line."""
    basis = np.stack([np.ones_like(t), t - t.mean()], axis=1)
    rest = shown - pushed
    rest = rest - basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
    return float(np.sum(rest**2))


def compensated(record: Record, scenario: Scenario, source: str = "wrench_meas") -> Array | None:
    """``(ticks, 6)`` output of the believed compensation for a recorded wrench; None if it needs
    other inputs or rows are missing.
    """
    if needs(scenario) != {"wrench_meas"} or not record.whole(source):
        return None
    reading = np.ascontiguousarray(record.filled(source))[None]
    return replay_compensation(
        [scenario], [InputParameters()], {}, reading, np.zeros(1, dtype=int)
    )[0]


def _exchanged_forces(record: Record, scenario: Scenario, given: Array | None) -> bool:
    """Whether the believed compensation converts wrench_comp to wrench_meas, and not the
    reverse.
    """
    crossed = compensated(record, scenario, "wrench_comp")
    if given is None or crossed is None:
        return False
    meas, comp = record.data["wrench_meas"], record.data["wrench_comp"]
    return float(np.sum((crossed - meas) ** 2)) < EXCHANGED * float(np.sum((given - comp) ** 2))


def _echo(record: Record, given: Array | None) -> int | None:
    """Rows by which the noise of the computed compensated wrench is later in wrench_comp (negative:
    earlier); None: not in both.
    """
    columns, best = set(record.columns()), None
    for j, name in enumerate(f"wrench_comp.{axis}" for axis in ("fx", "fy", "fz")):
        if given is None or name not in columns or not record.measured(name).all():
            continue
        a, b = np.diff(given[:, j], 3), np.diff(record.column(name), 3)
        a, b = (
            np.clip(v, *(np.array([-4.0, 4.0]) * 1.4826 * np.median(np.abs(v)))) for v in (a, b)
        )
        if not (a.any() and b.any()) or len(a) < 4 * FURTHEST:
            continue
        scores = _correlated(a[FURTHEST:-FURTHEST], b)
        top = int(np.argmax(np.abs(scores)))
        if abs(scores[top]) > ECHO and (best is None or abs(scores[top]) > best[1]):
            best = (top - FURTHEST, abs(scores[top]))
    return None if best is None else best[0]


def _correlated(a: Array, b: Array) -> Array:
    """Correlation of ``a`` (n,) with each window of length n of ``b`` (n + 2 FURTHEST,), from the
    first on.
    """
    total = np.concatenate([[0.0], np.cumsum(b * b)])
    size = np.sqrt((a @ a) * (total[len(a) :] - total[: -len(a)]))
    product = correlate(b, a, mode="valid", method="fft")
    return np.divide(product, size, out=np.zeros_like(product), where=size > 0.0)


def _platform_lead(record: Record, found: Survey, scenario: Scenario) -> float | None:
    """Rows by which the pose is earlier than one row after its command; negative: later; None if it
    cannot be determined.
    """
    if not follows_exactly(scenario):
        return None
    above = below = 0.0
    for part in ("px", "py", "pz"):
        names = (f"pose_cmd.{part}", f"pose_act.{part}")
        if not set(names) <= set(record.columns()):
            continue
        command, reached = (record.column(n) for n in names)
        rate = np.gradient(command)
        known = np.isfinite(rate) & np.isfinite(reached)
        if known.sum() < 50:
            continue
        turn, size = rate[known] - rate[known].mean(), command[known] - command[known].mean()
        # removes a difference in scale
        turn = turn - size * (turn @ size) / max(float(size @ size), 1e-300)
        behind = (command - reached)[known]
        square = float(turn @ turn)
        if square == 0.0:
            continue
        rows = float(turn @ behind) / square
        left = (
            behind
            - behind.mean()
            - rows * turn
            - size * (behind @ size) / max(float(size @ size), 1e-300)
        )
        variance = max(float(np.mean(left**2)), found.noise[names[1]].white ** 2, 1e-24)
        above += rows * square / variance
        below += square / variance
    if below < CLEAR**2:
        return None
    lead = 1.0 - above / below
    return lead if abs(lead) > LEAD_LIMIT + 5 / np.sqrt(below) else 0.0
