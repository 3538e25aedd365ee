"""Detection of units, signs and orders that contradict the physics of the scenario. Nothing is
corrected.

The pose is compared with gap and approach velocity, the attitude with the start attitude, and force
and pose with each other by the momentum balance. If the recorded bodies do not float freely, the
force is compared with what the believed sensor would read of the believed contact along the pose:
effects change that by a factor of a few, so that only an order of magnitude is known.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hiltestbed.contact.sides import sides_of
from hiltestbed.frames import Array, quat_from_attitude_deg
from hiltestbed.measured.momentum import balances, centred, imbalances
from hiltestbed.measured.noise import FREE_MINIMUM
from hiltestbed.measured.ratio import (
    AGREE,
    CLEAR,
    REVERSED,
    UNIT_FACTOR,
    correlation,
    factor_text,
    likely_scale,
    scale_fix,
    share,
)
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark, error
from hiltestbed.measured.sameness import copies_and_constants
from hiltestbed.measured.shifts import believed_reading, shifts
from hiltestbed.measured.start import starts_at_fault
from hiltestbed.measured.survey import Survey, extent, from_baseline
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

QUAT_NORM = 0.01  # largest error of a quaternion's length: two digits
TURNED_DEG = 30.0  # the platform rotates by 10 deg at most
LEVER_LIMIT = 20.0  # [m] torque over force: no rig is that large
# of the approach speed: largest change by the force in the first rows that counts as free flight
UNDRIVEN = 0.01


def contradictions(record: Record, found: Survey, scenario: Scenario) -> list[Remark]:
    """Errors for contradictions, notes for what is merely unusual."""
    if _is_driven(record, scenario):
        text = (
            "holds only a position and a force that drives it from the start: it is of one "
            "axis of a machine and not of a rig"
        )
        return [error("", record.run, "", text, "describe it by a dataset with `axis: drive`")]
    return [
        *starts_at_fault(record, found, scenario),
        *_attitudes(record, scenario),
        *copies_and_constants(record, found, scenario),
        *_forces(record, found, scenario),
        *_torques(record, found),
        *_arms(record, found, scenario),
    ]


def _is_driven(record: Record, scenario: Scenario) -> bool:
    """Whether the record has one position only, and a force that drives it from the start."""
    place, force = "pose_cmd.pz", "wrench_comp.fz"
    if not (record.has(place) and record.has(force) and centred(scenario)):
        return False
    if record.has("pose_act") or record.has("wrench_meas"):
        return False
    groups = {*GROUPS["pose_cmd"].columns, *GROUPS["wrench_comp"].columns} - {place, force}
    if any(extent(record.column(name)) for name in groups if record.has(name)):
        return False
    speed, craft = abs(scenario.approach.velocity[2]), scenario.spacecraft
    chaser, target = craft.chaser.mass, craft.target.mass
    pushed = np.abs(record.filled("wrench_comp")[:FREE_MINIMUM, 2])
    impulse = float(np.sum(pushed)) * scenario.tick
    free = speed > 0.0 and impulse * (chaser + target) / (chaser * target) < UNDRIVEN * speed
    return not free


def _forces(record: Record, found: Survey, scenario: Scenario) -> list[Remark]:
    """Remarks on the forces: by momentum if the bodies float freely, else by the contact law."""
    pairs = balances(record, scenario)
    if pairs:
        wrong = list(imbalances(record, found, scenario, pairs))
        return wrong or list(shifts(record, found, scenario))
    return list(_driven_forces(record, found, scenario))


def _attitudes(record: Record, scenario: Scenario) -> Iterator[Remark]:
    expected = quat_from_attitude_deg(scenario.approach.attitude_deg)
    for group in ("pose_cmd", "pose_act"):
        q = record.data[group][:, 3:] if record.has(group) else np.zeros((0, 4))
        q = q[np.isfinite(q).all(axis=1)]
        if not len(q):
            continue
        off = float(np.abs(np.linalg.norm(q, axis=1) - 1).max())
        name = f"{group}.q*"
        if off > QUAT_NORM:
            text = (
                f"is no unit quaternion: its length is off by up to {off:.3g}; allowed "
                f"is {QUAT_NORM:g}"
            )
            fix = "check scale and columns of qx, qy, qz, qw"
            yield error("attitude", record.run, name, text, fix)
            continue
        yield from _order(record.run, group, q[:50], expected)


def _order(run: int, group: str, q: Array, expected: Array) -> Iterator[Remark]:
    """Remark on a start attitude far from the scenario's, and the order that would match it."""
    name, given = f"{group}.q*", _angle_deg(q, expected)
    w_first = _angle_deg(q[:, [1, 2, 3, 0]], expected)
    conjugate = _angle_deg(q * [-1, -1, -1, 1], expected)
    for wrong, seen, fix in (
        (
            given > TURNED_DEG and w_first < 0.5 * TURNED_DEG,
            f", {w_first:.1f} deg when read w first: the order is w, x, y, z",
            f"exchange the columns under channels: {group}.qw takes that of qx, qx that of qy, qy "
            f"that of qz, qz that of qw",
        ),
        (
            given > TURNED_DEG,
            "; the platform rotates by 10 deg at most",
            "check frames, columns and the unit of angles, or set approach.attitude_deg",
        ),
        (
            given > 1.0 and conjugate < 0.2 * given,
            f", {conjugate:.1f} deg when inverted: it is P in A",
            "give the scale -1 to its qx, qy and qz",
        ),
    ):
        if wrong:
            text = f"starts {given:.1f} deg from the scenario's attitude{seen}"
            yield error("attitude", run, name, text, fix)
            return


def _angle_deg(q: Array, expected: Array) -> float:
    """Median angle [deg] between quaternions ``(rows, 4)`` and one."""
    dot = np.abs(q @ expected) / np.linalg.norm(q, axis=1)
    return float(np.degrees(2 * np.median(np.arccos(np.clip(dot, 0.0, 1.0)))))


def _driven_forces(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Remarks on forces of driven bodies, by the believed contact and by each other."""
    known = found.contacts and record.has("pose_act") and sides_of(scenario.mechanism).rigid
    made = believed_reading(record, scenario)[1][:, 2] if known else None
    for axis in GROUPS["wrench_comp"].parts:
        meas, comp = names = f"wrench_meas.{axis}", f"wrench_comp.{axis}"
        if made is not None and axis == "fz":
            for name in filter(record.has, names):
                yield from _opposed(record, found, name, made, "the force of the believed contact")
                yield from _other_axis(record, found, name, made)
        elif record.has(meas) and record.has(comp) and _moves(record, found, meas):
            yield from _opposed(record, found, comp, from_baseline(record, found, meas), meas)


def _moves(record: Record, found: Survey, name: str) -> bool:
    return _peak(record, found, name) > CLEAR * found.noise[name].rms


def _opposed(
    record: Record, found: Survey, name: str, made: Array, source: str
) -> Iterator[Remark]:
    """Errors for a column of the other sign than ``made`` (ticks,), or of another magnitude."""
    shown, run = from_baseline(record, found, name), record.run
    both = np.isfinite(shown) & np.isfinite(made)
    size, peak = (float(np.abs(v[both]).max(initial=0.0)) for v in (made, shown))
    if not size or peak <= CLEAR * found.noise[name].rms:
        return
    together, ratio = correlation(made, shown), peak / size
    if together < REVERSED:
        text = f"is opposite to {source} (correlation {together:.2f}): a sign is reversed"
        yield error("sign", run, name, text, scale_fix(name, -1.0))
    if not 1 / UNIT_FACTOR < ratio < UNIT_FACTOR:
        text = f"peaks at {peak:.4g} where {source} peaks at {size:.4g}: {factor_text(ratio, 'N')}"
        yield error("unit", run, name, text, scale_fix(name, likely_scale(ratio, "N")))


def _other_axis(record: Record, found: Survey, name: str, made: Array) -> Iterator[Remark]:
    """Errors for a lateral force that shows what ``made`` (ticks,) should be on ``name``."""
    for other in (f"{name[:-1]}{axis}" for axis in "xy"):
        if not record.has(other) or _peak(record, found, name) > 0.1 * _peak(record, found, other):
            continue
        if share(made, from_baseline(record, found, other)):
            text = f"stays in its noise while {other} shows the contact: the axes are swapped"
            fix = f"exchange the columns of {name} and {other}"
            yield error("axes", record.run, name, text, fix)


def _peak(record: Record, found: Survey, name: str) -> float:
    return float(np.nanmax(np.abs(from_baseline(record, found, name))))


def _torques(record: Record, found: Survey) -> Iterator[Remark]:
    """Remarks on torques that would need a lever arm longer than any rig."""
    for group in ("wrench_meas", "wrench_comp"):
        names = [n for n in record.columns() if n.startswith(group + ".")]
        peaks = {n: _peak(record, found, n) for n in names}
        forces = [peak for name, peak in peaks.items() if name[-2] == "f"]
        largest = max(forces, default=0.0)
        if len(forces) < 3 or largest == 0.0:
            continue
        for name, peak in peaks.items():
            least = max(CLEAR * found.noise[name].rms, LEVER_LIMIT * largest)
            if name[-2] == "t" and peak > least:
                text = (
                    f"peaks at {peak:.4g} N m against {largest:.4g} N of force: a lever "
                    f"arm of {peak / largest:.3g} m, another unit?"
                )
                fix = scale_fix(name, 1e-3)
                yield error("lever", record.run, name, text, fix)


def _arms(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Remarks on torques of an off-axis contact with a plane: tx = y fz, ty = -x fz."""
    columns = set(record.columns())
    places = [p for p in ("pose_act", "pose_cmd") if {f"{p}.px", f"{p}.py"} <= columns]
    if not places or scenario.mechanism.captured or not scenario.mechanism.flat:
        return
    x, y = record.data[places[0]][:, :2].T
    for group in ("wrench_meas", "wrench_comp"):
        names = [f"{group}.{axis}" for axis in ("fz", "tx", "ty")]
        if not set(names) <= columns:
            continue
        force, *torques = (from_baseline(record, found, name) for name in names)
        made = y * force, -x * force
        if np.nanmax(force) < -np.nanmin(force) or any(
            np.nanmax(np.abs(m)) < CLEAR * found.noise[name].rms
            for m, name in zip(made, names[1:], strict=True)
        ):
            continue
        own = [share(m, t) for m, t in zip(made, torques, strict=True)]
        crossed = [abs(share(m, t)) for m, t in zip(made[::-1], torques, strict=True)]
        if all(-AGREE < r < -1 / AGREE for r in own):
            for name, ratio in zip(names[1:], own, strict=True):
                text = (
                    f"is {ratio:.2f} times the torque of the off-axis force about P's "
                    f"origin: the sign is reversed"
                )
                yield error("sign", record.run, name, text, scale_fix(name, -1.0))
        elif all(1 / AGREE < r < AGREE for r in crossed) and not any(
            1 / AGREE < r < AGREE for r in own
        ):
            text = (
                f"is the torque of the off-axis force about the other axis, and "
                f"{names[2]} is that of this axis: they are exchanged"
            )
            fix = f"exchange the columns of {names[1]} and {names[2]}"
            yield error("axes", record.run, names[1], text, fix)
