"""A run against the limits of its scenario: its first contact, and the loads on the interface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.compiled.jit import interpreted
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.contact.touch import INSERTION
from hiltestbed.frames import Array, pose_step
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility
from hiltestbed.platform.build import Demand, built, demand_of
from hiltestbed.scenario import Scenario
from hiltestbed.scenario.limits import LEAST, UNIT, DockingLimits

# share of a limit from which it counts as exceeded: noise of the force changes a nominal approach
BEYOND = 1.001
# rows of Outcomes.loads
LOADS = ("compression", "tension", "shear", "bending", "torsion")
Found = Mapping[str, Mapping[str, float] | None]


def conditions(state: Array) -> dict[str, float]:
    """Conditions of a contact from pose and twist ``(13,)`` of A in P [m, m/s, rad, rad/s]."""
    x, y, _, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz = map(float, state)
    roll = 2.0 * math.atan2(qz, qw)  # the twist of the rotation about z, the rest is its swing
    return {
        "closing_speed": vz,
        "lateral_speed": math.hypot(vx, vy),
        "pitch_yaw_rate": math.hypot(wx, wy),
        "roll_rate": abs(wz),
        "lateral_offset": math.hypot(x, y),
        "pitch_yaw": 2.0 * math.asin(min(1.0, math.hypot(qx, qy))),
        "roll": abs(math.remainder(roll, 2.0 * math.pi)),
    }


def compared(limits: DockingLimits | None, found: Found) -> list[dict[str, Any]]:
    """Each limit with the value found (None: it did not come to that) and its ``share`` of the
    limit, above 1 beyond it; of a lowest value, 2 less the share. In SI units.
    """
    rows = []
    for (part, name), limit in () if limits is None else limits.each().items():
        values = found.get(part) or {}
        value = values.get(name.removesuffix("_min").removesuffix("_max"))
        share = None if value is None else value / limit
        if share is not None and name == LEAST:
            share = 2.0 - share
        row = {"quantity": f"{part}.{name}", "value": value, "limit": limit, "unit": UNIT[name]}
        rows.append(row | {"share": share})
    return rows


def verdict(limits: DockingLimits | None, found: Found) -> dict[str, Any]:
    """Entries of a summary: ``limits``, see :func:`compared`; the largest share, and whose."""
    rows = compared(limits, found)
    worst = max((r for r in rows if r["share"] is not None), key=lambda r: r["share"], default=None)
    return {
        "limits": rows,
        "limits_share": worst and worst["share"],
        "limits_worst": worst and worst["quantity"],
    }


def in_cells(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """A row of :func:`compared` as texts: quantity, value, limit and unit, angles in degrees."""
    unit, scale = row["unit"], 1.0
    if unit.startswith("rad"):
        unit, scale = unit.replace("rad", "deg"), math.degrees(1.0)
    value = "-" if row["value"] is None else f"{scale * row['value']:.4g}"
    return row["quantity"], value, f"{scale * row['limit']:.4g}", unit


def in_words(row: Mapping[str, Any]) -> str:
    """A row of :func:`compared` as a sentence."""
    quantity, value, limit, unit = in_cells(row)
    bound = "at least" if quantity.endswith(LEAST) else "at most"
    return f"{quantity} is {value} {unit}, allowed is {bound} {limit} {unit}"


def rig_ahead(scenario: Scenario) -> tuple[str, ...]:
    """Whether the peak force of a bounce along the insertion on spring and damper is more than the
    safety limit of the sensor, or than a drive can exert.
    """
    speed, limit = scenario.approach.velocity[2], scenario.safety.force
    if scenario.mechanism.captured or speed <= 0.0:
        return ()
    (k, c), mass = acting_along_z(scenario.impact), effective_mass(scenario.spacecraft)
    peak, found = SpringDamper(k, c, mass).peak_force(speed), []
    if limit is not None and peak > limit:
        found.append((f"is beyond safety.force, {limit:g} N", limit / peak))
    if (drives := demand_of(scenario)) is not None:
        rest, contact = drives.weight, drives_in_contact(scenario, drives, peak)
        left = drives.most - np.copysign(rest, rest * contact)  # in the direction of the contact
        with np.errstate(divide="ignore"):  # of a drive that the contact does not load
            shares = left / np.abs(contact)
        j = int(np.argmin(shares))
        if 0.0 < shares[j] < 1.0:
            axis, force = drives.axes[j], abs(rest[j] + contact[j])
            unit = "N" if axis.unit == "m" else "N m"
            takes = f"takes {force:.4g} {unit} of the drive of joint {axis.joint}, weight included"
            found.append((f"{takes}; its limit is {axis.force:.4g} {unit}", shares[j]))
    return tuple(
        f"warning: the contact's peak force, {peak:.4g} N at {speed:.3g} m/s, {what}; approach at "
        f"less than {speed * share:.3g} m/s, or take a softer contact"
        for what, share in found
    )


def drives_in_contact(scenario: Scenario, drives: Demand, force: float) -> Array:
    """``(J,)`` force of the drives beyond the weight [N, N m] while a contact along the insertion
    pushes the sides apart with ``force`` [N]: they carry it, and decelerate what they move.
    """
    parts = np.array(built(scenario.rig.platform).tool_shares)
    sides = np.array([1.0, -1.0][: len(parts)])  # P does the opposite of A
    push = -force * INSERTION
    accel = np.kron(sides * parts, mobility(scenario.spacecraft) @ push)
    return drives.inertia @ accel + drives.load @ np.kron(sides, push)


def ahead(scenario: Scenario) -> tuple[str, ...]:
    """The verdict before a run: the uniform approach up to the nominal touch, and the peak force of
    a spring and damper along the insertion.
    """
    mechanism, start = scenario.mechanism, approach_state(scenario.approach)
    if scenario.limits is None or mechanism.captured:
        return ()
    speed, pose = scenario.approach.velocity[2], start[:7].copy()
    if speed > 0.0:
        interpreted(pose_step)(start[:7], start[7:], scenario.approach.gap / speed, pose)
    (k, c), mass = acting_along_z(scenario.impact), effective_mass(scenario.spacecraft)
    peak = SpringDamper(k, c, mass).peak_force(max(speed, 0.0))
    state = np.concatenate([pose, start[7:]])
    found = {"approach": conditions(state), "soft_capture": {"compression": peak}}
    rows = [r for r in compared(scenario.limits, found) if r["value"] is not None]
    beyond = [f"warning: limits: {in_words(r)}" for r in rows if r["share"] > BEYOND]
    kept = (
        "limits: those of the approach, and of a first contact along the insertion, are kept; "
        "other loads need a run"
    )
    return tuple(beyond or ([kept] if rows else []))
