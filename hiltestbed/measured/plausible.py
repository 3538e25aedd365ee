"""Detection of units, signs and orders that contradict the physics of the scenario. Nothing is
corrected.

The pose is compared with gap and approach velocity, the attitude with the start attitude, and force
and pose with each other by the momentum balance. If the recorded bodies do not float freely, the
force is compared with k x + c v and v sqrt(k mu). Effects change these by a factor of a few, so
that a wrong unit is only detected there from a factor of some hundreds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hiltestbed.frames import Array, quat_from_attitude_deg
from hiltestbed.measured.momentum import balances, centred, imbalances
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark, error, note
from hiltestbed.measured.sameness import copies_and_constants
from hiltestbed.measured.shifts import shifts
from hiltestbed.measured.start import factor_text, likely_scale, scale_fix, starts_at_fault
from hiltestbed.measured.survey import MOVED, Survey, extent, from_baseline, penetration
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

FORCE_FACTOR = 200.0  # a larger ratio means another unit, whatever the contact is
CORRELATION = -0.5
QUAT_NORM = 0.01
QUAT_NORM_NOTE = 1e-3
TURNED_DEG = 30.0  # the platform rotates by 10 deg at most
# of a measured torque to that of the off-axis force: effects change it by less, or the two torques
# differently
RATIO = (0.8, 1.25)
EXPLAINED = 0.9  # of the variance of a torque that the off-axis force must explain
LEVER_LIMIT = 20.0  # [m] torque over force: no rig is that large
STILL_FREE = 20  # rows at the start of a run in which an approaching spacecraft feels no force
# of the approach speed: largest change by the force in these rows that counts as free flight
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
    pushed = np.abs(record.filled("wrench_comp")[:STILL_FREE, 2])
    impulse = float(np.sum(pushed)) * scenario.tick
    free = speed > 0.0 and impulse * (chaser + target) / (chaser * target) < UNDRIVEN * speed
    return not free


def _forces(record: Record, found: Survey, scenario: Scenario) -> list[Remark]:
    """Remarks on the forces: by momentum if the bodies float freely, else by the contact law."""
    pairs = balances(record, scenario)
    wrong = list(imbalances(record, found, scenario, pairs))
    if pairs:
        return wrong or list(shifts(record, found, scenario))
    return [*_measured_force(record, found, scenario), *_force_pair(record, found)]


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
        if off > QUAT_NORM_NOTE:
            text = f"has a length that is off by up to {off:.3g}; it is used as it is"
            yield note(record.run, name, text)
        yield from _order(record.run, group, q[:50], expected)


def _order(run: int, group: str, q: Array, expected: Array) -> Iterator[Remark]:
    """Remark on a start attitude far from the scenario's, and the order that would match it."""
    name, given = f"{group}.q*", _angle_deg(q, expected)
    w_first = _angle_deg(q[:, [1, 2, 3, 0]], expected)
    conjugate = _angle_deg(q * [-1, -1, -1, 1], expected)
    if given > TURNED_DEG and w_first < 0.5 * TURNED_DEG:
        text = (
            f"starts {given:.0f} deg from the scenario's attitude, {w_first:.1f} deg "
            f"when read w first: the order is w, x, y, z"
        )
        fix = (
            f"exchange the columns under channels: {group}.qw takes that of qx, qx that "
            f"of qy, qy that of qz, qz that of qw"
        )
        yield error("attitude", run, name, text, fix)
    elif given > TURNED_DEG:
        text = (
            f"starts {given:.0f} deg from the scenario's attitude; the platform rotates "
            f"by 10 deg at most"
        )
        fix = "check frames and columns, or set approach.attitude_deg"
        yield error("attitude", run, name, text, fix)
    elif given > 1.0 and conjugate < 0.2 * given:
        text = (
            f"starts {given:.1f} deg from the scenario's attitude, {conjugate:.1f} deg "
            f"when inverted: it is P in A"
        )
        fix = "give the scale -1 to its qx, qy and qz"
        yield error("attitude", run, name, text, fix)


def _angle_deg(q: Array, expected: Array) -> float:
    """Median angle [deg] between quaternions ``(rows, 4)`` and one."""
    dot = np.abs(q @ expected) / np.linalg.norm(q, axis=1)
    return float(np.degrees(2 * np.median(np.arccos(np.clip(dot, 0.0, 1.0)))))


def _measured_force(record: Record, found: Survey, scenario: Scenario) -> Iterator[Remark]:
    """Remarks on sign and size of the force along z, and on one that is on another axis."""
    name = "wrench_meas.fz" if record.has("wrench_meas.fz") else "wrench_comp.fz"
    if not record.has(name) or not found.contacts:
        return
    force = from_baseline(record, found, name)
    high, low = float(np.nanmax(force)), float(np.nanmin(force))
    peak, run = max(high, -low), record.run
    clear = peak > MOVED * found.noise[name].rms
    if clear and _pulls(record, force, high, low, scenario):
        text = (
            f"pulls while pushing: {low:.4g} N at its strongest against {high:.4g} N, "
            f"and falls as the penetration grows"
        )
        yield error("sign", run, name, text, scale_fix(name, -1.0))
    expected = _expected_force(record, scenario)
    if not expected:
        return
    ratio = peak / expected
    if clear and not 1 / FORCE_FACTOR < ratio < FORCE_FACTOR:
        text = (
            f"peaks at {peak:.4g} N, the scenario gives about {expected:.4g} "
            f"N: {factor_text(ratio, 'N')}"
        )
        fix = scale_fix(name, 10.0 ** -round(math.log10(ratio)))
        yield error("unit", run, name, text, fix)
    elif not clear:
        yield from _other_axis(record, found, name, expected)


def _pulls(record: Record, force: Array, peak: float, low: float, scenario: Scenario) -> bool:
    """Whether the sign is wrong: by the largest force (not of a latch) and its history."""
    latched, depth = scenario.mechanism.captured, penetration(record)
    if not latched and -low < 3 * peak:
        return False
    if depth is None:
        return not latched
    if not scenario.mechanism.flat and not latched and not np.nanmax(depth) > 0:
        return True  # on the wall of a cone the probe touches before pz = 0
    depth = depth if latched else np.maximum(depth, 0.0)
    late = min(round(scenario.sensor.delay * scenario.rate), len(force) - 2)
    return correlation(depth[: len(depth) - late], force[late:]) < CORRELATION


def correlation(a: Array, b: Array) -> float:
    """Pearson's correlation over the rows where both are known; 0 if one of them does not vary."""
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < 3:
        return 0.0
    a, b = a[known] - a[known].mean(), b[known] - b[known].mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


def _expected_force(record: Record, scenario: Scenario) -> float | None:
    """The peak expected from the scenario [N]: v sqrt(k mu) for two free bodies, k x + c v for a
    latched mechanism; None without motion.
    """
    k, c = scenario.mechanism.contact.stiffness, scenario.mechanism.contact.damping
    if scenario.mechanism.captured:
        depth = penetration(record)
        if depth is None:
            return None
        known = depth[np.isfinite(depth)]
        return float(k * np.abs(known).max(initial=0.0) + c * _fastest(record, depth)) or None
    chaser, target = scenario.spacecraft.chaser.mass, scenario.spacecraft.target.mass
    speed = abs(scenario.approach.velocity[2])
    return speed * math.sqrt(k * chaser * target / (chaser + target)) + c * speed or None


def _fastest(record: Record, depth: Array) -> float:
    """99th percentile of the rate of penetration [m/s], over steps beyond the pose's noise."""
    known = np.flatnonzero(np.isfinite(depth))
    known = known[:: max(1, len(known) // 500)]
    if len(known) < 3:
        return 0.0
    return float(np.percentile(np.abs(np.diff(depth[known]) / np.diff(record.t[known])), 99))


def _other_axis(record: Record, found: Survey, name: str, expected: float) -> Iterator[Remark]:
    group = name.partition(".")[0]
    own = _peak(record, found, name)
    for other in (f"{group}.fx", f"{group}.fy"):
        if not record.has(other):
            continue
        peak = _peak(record, found, other)
        if 0.3 * expected < peak < 3 * expected and own < 0.1 * peak:
            text = (
                f"stays in its noise while {other} peaks at {peak:.4g} N, about what is "
                f"expected along z: the axes are swapped"
            )
            fix = f"exchange the columns of {name} and {other}"
            yield error("axes", record.run, name, text, fix)


def _peak(record: Record, found: Survey, name: str) -> float:
    return float(np.nanmax(np.abs(from_baseline(record, found, name))))


def _force_pair(record: Record, found: Survey) -> Iterator[Remark]:
    """Remarks on wrench_comp against wrench_meas: the same force, some milliseconds apart."""
    for axis in ("fx", "fy", "fz", "tx", "ty", "tz"):
        meas, comp = names = f"wrench_meas.{axis}", f"wrench_comp.{axis}"
        if not (record.has(meas) and record.has(comp)):
            continue
        a, b = (from_baseline(record, found, n) for n in names)
        both = np.isfinite(a) & np.isfinite(b)
        peaks = [float(np.abs(values[both]).max(initial=0.0)) for values in (a, b)]
        least = [2 * MOVED * found.noise[n].rms for n in names]
        if peaks[0] <= least[0] or peaks[1] <= least[1]:
            continue
        run, together, ratio = record.run, correlation(a, b), peaks[1] / peaks[0]
        if together < CORRELATION:
            text = (
                f"is opposite to {meas} (correlation {together:.2f}): the sign of one is reversed"
            )
            yield error("sign", run, comp, text, scale_fix(comp, -1.0))
        if not 1 / FORCE_FACTOR < ratio < FORCE_FACTOR:
            text = (
                f"peaks at {peaks[1]:.4g} where {meas} peaks at {peaks[0]:.4g}: "
                f"{factor_text(ratio, 'N')}"
            )
            fix = scale_fix(comp, likely_scale(ratio, "N"))
            yield error("unit", run, comp, text, fix)


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
            least = max(MOVED * found.noise[name].rms, LEVER_LIMIT * largest)
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
            np.nanmax(np.abs(m)) < 2 * MOVED * found.noise[name].rms
            for m, name in zip(made, names[1:], strict=True)
        ):
            continue
        own = [_share(m, t) for m, t in zip(made, torques, strict=True)]
        crossed = [abs(_share(m, t)) for m, t in zip(made[::-1], torques, strict=True)]
        if all(-RATIO[1] < share < -RATIO[0] for share in own):
            for name, share in zip(names[1:], own, strict=True):
                text = (
                    f"is {share:.2f} times the torque of the off-axis force about P's "
                    f"origin: the sign is reversed"
                )
                yield error("sign", record.run, name, text, scale_fix(name, -1.0))
        elif all(RATIO[0] < share < RATIO[1] for share in crossed) and not any(
            RATIO[0] < share < RATIO[1] for share in own
        ):
            text = (
                f"is the torque of the off-axis force about the other axis, and "
                f"{names[2]} is that of this axis: they are exchanged"
            )
            fix = f"exchange the columns of {names[1]} and {names[2]}"
            yield error("axes", record.run, names[1], text, fix)


def _share(made: Array, torque: Array) -> float:
    """Ratio of a torque to ``made``; 0 if ``made`` does not explain it."""
    known = np.isfinite(made) & np.isfinite(torque)
    m, t = made[known], torque[known]
    size = float(m @ m)
    share = float(m @ t) / size if size > 0.0 else 0.0
    return share if float(np.sum((t - share * m) ** 2)) < (1.0 - EXPLAINED) * float(t @ t) else 0.0
