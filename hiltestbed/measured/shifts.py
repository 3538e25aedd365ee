"""Channels that are some rows early or late in the record: an output that precedes its input, which
no rig can produce.

Three of the four links of the loop have a delay that is known to a fraction of a row: the numerical
model moves the pose by the force of the same row; a platform with ideal tracking reaches its
command one row later; and the noise of the sensor passes the compensation in the row in which it is
read. A shifted channel makes the link before it too late and the link after it too early by the
same number of rows.

With a late platform the contact is late as well: the force agrees in time with the recorded pose.
If the pose was stamped late, the force precedes it, which nothing between contact and sensor can
cause. Of a force that was stamped late, to which the loop reacts before it is on record, the
diagnosis has a cause of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.signal import savgol_filter

from hiltestbed.compensation.input import InputParameters
from hiltestbed.contact.parameters import believed_contacts, contact_rows
from hiltestbed.contact.sides import sides_of
from hiltestbed.effects.log import LogParameters
from hiltestbed.frames import Array
from hiltestbed.measured.noise import MAD_TO_SIGMA, OUTLIER_SIGMA
from hiltestbed.measured.ratio import CLEAR, REMAINDER, correlation
from hiltestbed.measured.record import LOGGER, Record
from hiltestbed.measured.remark import Remark, error
from hiltestbed.measured.survey import Survey
from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.platform.build import runs_of
from hiltestbed.replay import (
    Departing,
    Felt,
    follows_exactly,
    replay_compensation,
    replay_model,
    replay_wrench,
)
from hiltestbed.replay.compensation import needs
from hiltestbed.replay.wrench import Lane
from hiltestbed.scenario import Scenario
from hiltestbed.sensor.parameters import SensorParameters
from hiltestbed.signals import GROUPS

FURTHEST = 40  # largest shift that is searched [rows]
ECHO = 0.3  # correlation of the noise of two forces, above which it is the same noise
LEAD_LIMIT = 0.5  # [rows] least lead over the earliest possible response of a platform that counts
# rows; pose and force are smoothed in the same way, so that the fitted contact is consistent
SMOOTHING = 11
WRENCH = GROUPS["wrench_comp"].columns


def shifts(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Errors for outputs further ahead of their inputs than loggers stamp them; else notes."""
    if abs(record.sample_rate * scenario.tick - 1.0) > 1e-3:
        return  # the rows of the file are not ticks of the loop
    given = compensated(record, scenario)
    if _exchanged_forces(record, scenario, given):
        text = (
            "does not give wrench_comp by the scenario's compensation, but wrench_comp "
            "gives it: the two are exchanged"
        )
        fix = "exchange the columns of wrench_meas and wrench_comp"
        yield error("shift", record.run, "wrench_meas", text, fix)
        return
    ahead = _platform_lead(record, found, scenario)
    others = list(_out_of_order(record, found, scenario, given, ahead))
    leads = force_leads(record, found, scenario)
    if leads and (not others or (ahead is not None and abs(ahead + leads) < 1.0)):
        yield _led(record, leads, ahead, scenario)
    yield from others


def _out_of_order(
    record: Record, found: Survey, scenario: Scenario, given: Array | None, ahead: float | None
) -> Iterator[Remark]:
    """Remarks on outputs that precede their inputs, on the links with a known delay."""
    moved, tick = _model_lag(record, scenario), scenario.tick
    echo = _echo(record, given) if moved else None
    if moved and echo == -moved:
        why = "neither follows wrench_meas nor moves pose_cmd when it should"
        yield _shifted(record, "wrench_comp", -moved, tick, why)
    elif moved is not None and moved < 0 and echo in (0, None):
        by_pose = echo == 0 or ahead is None or ahead < 0
        channel, late = ("pose_cmd", moved) if by_pose else ("wrench_comp", -moved)
        yield _shifted(record, channel, late, tick, "pose_cmd moves before wrench_comp pushes it")
    if ahead is not None and ahead > 0:
        yield _ahead(record, ahead, moved, tick, found)


def _shifted(record: Record, channel: str, rows: float, tick: float, why: str) -> Remark:
    """Remark on a channel that is ``rows`` late in the record; early if negative."""
    when = f"{abs(rows):.3g} row{'s' if abs(rows) != 1 else ''} {'late' if rows > 0 else 'early'}"
    by = f"{-rows * tick:.6g} s"
    fix = f"move it by {by} before the export: all channels share the rows of one clock"
    return _remark(record, channel, f"is {when} in the record: {why}", fix, rows)


def _remark(record: Record, channel: str, text: str, fix: str, rows: float) -> Remark:
    found = error("shift", record.run, channel, text, fix)
    return found if abs(rows) > LOGGER else replace(found, severity="note")


def _ahead(record: Record, rows: float, moved: int | None, tick: float, found: Survey) -> Remark:
    if moved is not None and moved > 0 and abs(moved - rows) < 1.0:
        why = "the platform precedes it, and it follows its force too late"
        return _shifted(record, "pose_cmd", float(moved), tick, why)
    rough = [
        max(
            (n.white for name, n in found.noise.items() if name.startswith(f"{group}.p")), default=0
        )
        for group in ("pose_cmd", "pose_act")
    ]
    if abs(rows - 2.0) < LEAD_LIMIT and rough[0] > 3 * rough[1]:
        text = (
            "follows pose_act a row later and carries a sensor's noise, which pose_act "
            "does not: the two are exchanged"
        )
        fix = "exchange the columns of pose_cmd and pose_act"
        return error("shift", record.run, "pose_cmd", text, fix)
    text = (
        f"precedes the response to its command by {rows:.3g} rows: it is early in the "
        f"record, or exchanged with pose_cmd"
    )
    fix = (
        f"move it by {rows * tick:.6g} s before the export, or exchange the "
        f"columns of pose_cmd and pose_act"
    )
    return _remark(record, "pose_act", text, fix, rows)


def _led(record: Record, rows: int, lead: float | None, scenario: Scenario) -> Remark:
    """Remark on a force ``rows`` before the contact; the platform's ``lead`` tells which is off."""
    if lead is not None and abs(lead + rows) < 1.0:
        why = "wrench_meas shows the contact before it, and pose_cmd precedes it by as much"
        return _shifted(record, "pose_act", rows, scenario.tick, why)
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


def _model_lag(record: Record, scenario: Scenario) -> int | None:
    """Rows by which pose_cmd follows the force too late; None if unknown, 0 if it fits."""
    names = [*(f"pose_cmd.p{a}" for a in "xyz"), *WRENCH]
    if not all(record.has(n) and record.measured(n).all() for n in names):
        return None
    wrench = np.ascontiguousarray(record.data["wrench_comp"])
    both = np.stack([wrench, np.zeros_like(wrench)])
    start = approach_states([scenario.approach] * 2)
    nominal = stack([DynamicsParameters()] * 2)
    models = Departing([scenario.spacecraft] * 2, start, scenario.tick, nominal)
    poses = replay_model(models, both, np.arange(2))
    if not np.isfinite(poses).all() or record.ticks < 4 * FURTHEST:
        return None
    pushed = poses[0, :, :3] - poses[1, :, :3]
    shown = record.data["pose_cmd"][:, :3] - poses[1, :, :3]
    inner = slice(FURTHEST, record.ticks - FURTHEST)
    line = np.stack([np.ones_like(record.t[inner]), record.t[inner]], axis=1)
    lags = range(-FURTHEST, FURTHEST + 1)
    left = [_unexplained(line, (shown - np.roll(pushed, n, axis=0))[inner]) for n in lags]
    best, now = lags[int(np.argmin(left))], left[FURTHEST]
    if now < 1e-18 * max(1.0, float(np.sum(shown**2))):
        return 0
    return best if min(left) < REMAINDER * now and abs(best) < FURTHEST else 0


def _unexplained(basis: Array, values: Array) -> float:
    """Sum of squares of ``values`` (n,) or (n, m) minus their best fit by ``basis`` (n, k)."""
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    return float(np.sum((values - basis @ fit) ** 2))


def compensated(record: Record, scenario: Scenario, source: str = "wrench_meas") -> Array | None:
    """``(ticks, 6)`` believed compensation of a recorded wrench; None if it needs more inputs."""
    needed = needs(scenario.compensation, scenario.mechanism)
    if needed != {"wrench_meas"} or not record.whole(source):
        return None
    reading = np.ascontiguousarray(record.filled(source))[None]
    run = np.zeros(1, dtype=int)
    return replay_compensation([scenario], [InputParameters()], {}, reading, run)[0]


def _exchanged_forces(record: Record, scenario: Scenario, given: Array | None) -> bool:
    """Whether the compensation converts wrench_comp to wrench_meas, not the reverse."""
    crossed = compensated(record, scenario, "wrench_comp")
    if given is None or crossed is None:
        return False
    meas, comp = record.data["wrench_meas"], record.data["wrench_comp"]
    return float(np.sum((crossed - meas) ** 2)) < REMAINDER * float(np.sum((given - comp) ** 2))


def _echo(record: Record, given: Array | None) -> int | None:
    """Rows by which the noise of ``given`` is later in wrench_comp; None: not in both."""
    best: tuple[float, int | None] = ECHO, None
    for j, name in enumerate(WRENCH[:3]):
        if given is None or not record.has(name) or not record.measured(name).all():
            continue
        third = np.diff([given[:, j], record.column(name)], 3)
        most = OUTLIER_SIGMA * MAD_TO_SIGMA * np.median(np.abs(third), axis=1, keepdims=True)
        a, b = np.clip(third, -most, most)
        if not (a.any() and b.any()) or len(a) < 4 * FURTHEST:
            continue
        rows = len(a) - 2 * FURTHEST
        parts = ((n - FURTHEST, b[n : n + rows]) for n in range(2 * FURTHEST + 1))
        found = [(abs(correlation(a[FURTHEST:-FURTHEST], part)), lag) for lag, part in parts]
        best = max(best, *found, key=lambda pair: pair[0])
    return best[1]


def _platform_lead(record: Record, found: Survey, scenario: Scenario) -> float | None:
    """Rows by which the pose precedes the row after its command; None if that is not told."""
    if not follows_exactly(scenario.rig, scenario.compensation):
        return None
    above = below = 0.0
    for part in ("px", "py", "pz"):
        names = (f"pose_cmd.{part}", f"pose_act.{part}")
        if not all(record.has(n) for n in names):
            continue
        command, reached = (record.column(n) for n in names)
        rate = np.gradient(command)
        known = np.isfinite(rate) & np.isfinite(reached)
        if known.sum() < 50:
            continue
        turn, size, behind = (v[known] for v in (rate, command, command - reached))
        turn, size = turn - turn.mean(), size - size.mean()
        square = max(float(size @ size), 1e-300)
        turn = turn - size * (turn @ size) / square  # removes a difference in scale
        weight = float(turn @ turn)
        if weight == 0.0:
            continue
        rows = float(turn @ behind) / weight
        left = behind - behind.mean() - rows * turn - size * (behind @ size) / square
        variance = max(float(np.mean(left**2)), found.noise[names[1]].white ** 2, 1e-24)
        above += rows * weight / variance
        below += weight / variance
    if below < CLEAR**2:
        return None
    lead = 1.0 - above / below
    return lead if abs(lead) > LEAD_LIMIT + 5 / np.sqrt(below) else 0.0


def force_leads(record: Record, found: Survey, scenario: Scenario) -> int:
    """Whole rows by which the contact in wrench_meas precedes that of the recorded pose; 0 if it
    does not, or if it cannot be determined.

    Stiffness and damping are fitted: more damping also makes the force lead, but not before the
    touch.
    """
    if not (found.contacts and record.whole("pose_act") and record.has("wrench_meas.fz")):
        return 0
    if not sides_of(scenario.mechanism).rigid or record.ticks < 4 * FURTHEST:
        return 0
    spring, both = believed_reading(record, scenario)
    parts = [i for i, part in enumerate(("fx", "fy", "fz")) if record.has(f"wrench_meas.{part}")]
    shown = _smooth(np.nan_to_num(record.data["wrench_meas"][:, parts]))
    shown = shown - np.median(shown[: max(found.free, 1)], axis=0)
    columns = np.stack([_smooth(spring[:, parts]), _smooth((both - spring)[:, parts])])
    rows = record.ticks - FURTHEST
    left = [
        _unexplained(columns[:, lag : lag + rows].reshape(2, -1).T, shown[:rows].ravel())
        for lag in range(FURTHEST)
    ]
    best = int(np.argmin(left))
    noise = max(found.noise["wrench_meas.fz"].white, 1e-9)
    worth = left[0] - left[best] > (CLEAR * noise) ** 2
    return best if worth and left[best] < REMAINDER * left[0] and best < FURTHEST - 1 else 0


def _smooth(values: Array) -> Array:
    return np.asarray(savgol_filter(values, SMOOTHING, 2, axis=0))


def believed_reading(record: Record, scenario: Scenario) -> tuple[Array, Array]:
    """The believed sensor's reading of the recorded pose, (ticks, 6): undamped, and damped."""
    mechanism, path = scenario.mechanism, record.filled("pose_act")
    path[:, :3] = _smooth(path[:, :3])
    start = approach_states([scenario.approach])
    felt = Felt.along([mechanism], start, runs_of([scenario]), path[None])
    damped = [
        replace(c, damping=c.damping or c.stiffness * scenario.tick)
        for c in believed_contacts(mechanism)
    ]
    undamped = [replace(c, damping=0.0) for c in damped]
    sensor, rules = SensorParameters.believed(scenario.sensor), sides_of(mechanism).rules
    rows = (contact_rows(c, rules, mechanism.captured) for c in (undamped, damped))
    lanes = [Lane(0, contacts, sensor, LogParameters()) for contacts in rows]
    spring, both = replay_wrench(felt, lanes)
    return spring, both
