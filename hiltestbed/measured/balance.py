"""Check of unit, sign and axes of force and pose by momentum: the force must have caused the
recorded motion, whatever the contact.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from hiltestbed.measured.momentum import FORCES, Momentum, momentum
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark, error
from hiltestbed.measured.start import AGREE, Start, factor_text, likely_scale, scale_fix, start_of
from hiltestbed.measured.survey import Survey
from hiltestbed.scenario import Scenario

# factor from 1 that no effect causes: the largest over the independent rig's effects is 1.25
SCALE = 2.2
# part of the motion that a force with its axes as given must explain; otherwise other orders of
# axes are tried
EXPLAINED = 0.85
# largest remainder with another order, as part of that in the given order; the least over the rig's
# hidden effects is 0.29
REMAINDER = 0.1
AXIS_REVERSED = -0.5  # of the common scale: below it the sign of one axis is reversed


def balances(record: Record, scenario: Scenario) -> dict[str, Momentum]:
    """The momentum balance of each force (by its group) with the pose, where it can be evaluated.

    The commanded pose follows from wrench_comp by the law of the numerical model. Without
    wrench_comp, or with a reached pose only, the force must have moved the bodies: assumed if they
    approach with the scenario's speed, but not for a driven machine.
    """
    pose = "pose_cmd" if record.has("pose_cmd") else "pose_act"
    modelled = record.has("wrench_comp") and pose == "pose_cmd"
    if not (modelled or any(scenario.approach.velocity)):
        return {}
    forces = (f for f in ("wrench_comp", "wrench_meas") if record.has(f))
    found = {force: momentum(record, scenario, force, pose) for force in forces}
    return {force: pair for force, pair in found.items() if pair is not None}


def imbalances(
    record: Record, found: Survey, scenario: Scenario, pairs: dict[str, Momentum]
) -> Iterator[Remark]:
    """Errors for a force that cannot have caused the recorded motion."""
    for pair in pairs.values():
        left, left_in_order = 1.0 - pair.explained, 1.0 - pair.explained_in_order
        otherwise = pair.explained < EXPLAINED and left_in_order < REMAINDER * left
        if otherwise and pair.order != FORCES:
            yield _exchanged(record, pair)
        elif otherwise and -1 in pair.signs:
            yield from _turned(record, pair)
        elif pair.explained > EXPLAINED:
            yield from _scaled(record, found, scenario, pair)


def _seen(pair: Momentum, change: str) -> tuple[str, dict[str, float]]:
    text = (
        f"does not explain the motion of {pair.pose} ({100 * max(pair.explained, 0.0):.0f} % of "
        f"it); {change} it explains {100 * pair.explained_in_order:.0f} %"
    )
    return text, {"explained": pair.explained, "explained_in_order": pair.explained_in_order}


def _exchanged(record: Record, pair: Momentum) -> Remark:
    moved = [(given, f) for given, f in zip(FORCES, pair.order, strict=True) if given != f]
    text, evidence = _seen(pair, "with its axes exchanged")
    taken = ", ".join(f"{pair.force}.{a} takes the column of {pair.force}.{b}" for a, b in moved)
    fix = f"exchange the columns under channels: {taken}"
    name = f"{pair.force}.{moved[-1][0]}"
    return error("axes", record.run, name, f"{text}: the axes are swapped", fix, **evidence)


def _turned(record: Record, pair: Momentum) -> Iterator[Remark]:
    text, evidence = _seen(pair, "with this axis reversed")
    text = f"{text}: the sign is reversed"
    for part, sign in zip(FORCES, pair.signs, strict=True):
        name = f"{pair.force}.{part}"
        if sign < 0:
            yield error("sign", record.run, name, text, scale_fix(name, -1.0), **evidence)


def _scaled(record: Record, found: Survey, scenario: Scenario, pair: Momentum) -> Iterator[Remark]:
    start = start_of(record, found, scenario, f"{pair.pose}.pz")
    at_fault, scale, size = _pose_at_fault(pair, start), pair.scale, abs(pair.scale)
    # the columns of the force that clearly move the pose; at least z
    moving = [f"{pair.force}.f{axis}" for axis in dict.fromkeys(("z", *pair.axes))]
    if not at_fault and scale < 0:
        text = (
            f"pulls while pushing: the motion of {pair.pose} is {scale:.3g} times what "
            f"it causes; the sign is reversed"
        )
        for name in moving:
            yield error("sign", record.run, name, text, scale_fix(name, -1.0), scale=scale)
    for axis, s in pair.axes.items():
        # beyond -SCALE the motion has another cause than this force
        if scale > 0 and -SCALE * scale < s < AXIS_REVERSED * scale:
            name = f"{pair.force}.f{axis}"
            text = (
                f"pushes {pair.pose}.p{axis} the wrong way ({s:.3g} times what it "
                f"causes, all axes {scale:.3g}): its sign is reversed"
            )
            yield error("sign", record.run, name, text, scale_fix(name, -1.0), scale=s)
    if 1 / SCALE < size < SCALE or at_fault:
        return
    text = (
        f"mass times the change of velocity in {pair.pose} is {size:.4g} times the "
        f"impulse of the force: {factor_text(1.0 / size, 'N')}"
    )
    for name in moving:
        fix = scale_fix(name, likely_scale(1.0 / size, "N"))
        yield error("unit", record.run, name, text, fix, scale=scale)


def _pose_at_fault(pair: Momentum, start: Start | None) -> bool:
    """Whether the start of the pose shows the same factor or sign: then its unit is wrong."""
    if start is None or not start.ratios:
        return False
    off = start.unit if start.unit is not None else 1.0
    apart = abs(math.log(off) - math.log(max(abs(pair.scale), 1e-300)))
    same_size = off != 1.0 and apart < math.log(AGREE) * 2
    return same_size or (pair.scale < 0 and start.reversed)
