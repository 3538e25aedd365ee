"""Unit, sign and axes of force and pose by momentum: what the force did to the bodies is what the pose shows, whatever was in contact."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hiltestbed.measured.momentum import FORCES, Momentum, momentum
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.start import AGREE, Start, factor_text, likely_scale, scale_fix, start_of
from hiltestbed.measured.survey import Survey
from hiltestbed.scenario import Scenario

SCALE = 2.2  # factor off 1 that no effect gives: the largest over the independent rig's effects is 1.25
HOLDS = 0.85  # part of the motion that a force in the given order explains at least, or else an order is looked for
LEAVES = 0.1  # of what that force leaves unexplained, that is left in another order; the least over the rig's hidden effects is 0.29
AXIS_REVERSED = -0.5  # of the common scale: one axis has the other sign


def balances(record: Record, scenario: Scenario) -> dict[str, Momentum]:
    """Group of the force to what it and the pose say of each other, for the forces of which it can be said.

    The commanded pose follows from the force by the numerical model's own law. Where there is no wrench_comp, or only a reached pose, the
    force has to have moved the bodies: taken for granted where they were sent with the scenario's speed, not of a driven machine.
    """
    pose = "pose_cmd" if record.has("pose_cmd") else "pose_act"
    modelled = record.has("wrench_comp") and pose == "pose_cmd"
    floats = any(scenario.approach.velocity)
    found = {}
    for force in ("wrench_comp", "wrench_meas"):
        if record.has(force) and (modelled or floats):
            pair = momentum(record, scenario, force, pose)
            if pair is not None:
                found[force] = pair
    return found


def imbalances(record: Record, found: Survey, scenario: Scenario, pairs: dict[str, Momentum]) -> Iterator[Remark]:
    """Errors for a force that does not belong to the motion it is said to have caused."""
    for pair in pairs.values():
        otherwise = pair.explained < HOLDS and 1.0 - pair.explained_in_order < LEAVES * (1.0 - pair.explained)
        if otherwise and pair.order != FORCES:
            yield _exchanged(record, pair)
        elif otherwise and -1 in pair.signs:
            yield from _turned(record, pair)
        elif pair.explained > HOLDS:
            yield from _scaled(record, found, scenario, pair)


def _seen(pair: Momentum, change: str) -> tuple[str, dict[str, float]]:
    text = (
        f"does not explain the motion of {pair.pose} ({100 * max(pair.explained, 0.0):.0f} % of it); {change} it explains "
        f"{100 * pair.explained_in_order:.0f} %"
    )
    return text, {"explained": pair.explained, "explained_in_order": pair.explained_in_order}


def _exchanged(record: Record, pair: Momentum) -> Remark:
    moved = [(given, f) for given, f in zip(FORCES, pair.order, strict=True) if given != f]
    text, evidence = _seen(pair, "with its axes exchanged")
    fix = f"exchange the columns under channels: {', '.join(f'{pair.force}.{a} takes the column of {pair.force}.{b}' for a, b in moved)}"
    name = f"{pair.force}.{moved[-1][0]}"
    return Remark("error", record.run, name, f"{text}: the axes are swapped", fix, evidence, "axes")


def _turned(record: Record, pair: Momentum) -> Iterator[Remark]:
    text, evidence = _seen(pair, "with this axis turned round")
    for name, sign in zip(FORCES, pair.signs, strict=True):
        if sign < 0:
            channel = f"{pair.force}.{name}"
            yield Remark(
                "error", record.run, channel, f"{text}: the sign is the other way round", scale_fix(channel, -1.0), evidence, "sign"
            )


def _scaled(record: Record, found: Survey, scenario: Scenario, pair: Momentum) -> Iterator[Remark]:
    start = start_of(record, found, scenario, f"{pair.pose}.pz")
    at_fault = _pose_at_fault(pair, start)
    scale = pair.scale
    if not at_fault and scale < 0:
        text = f"pulls while pushing: the motion of {pair.pose} is {scale:.3g} times what it causes; the sign is the other way round"
        for name in _moving(pair):
            yield Remark("error", record.run, name, text, scale_fix(name, -1.0), {"scale": scale}, "sign")
    for axis, s in pair.axes.items():
        if scale > 0 and -SCALE * scale < s < AXIS_REVERSED * scale:  # more than that is another motion, which the force does not make
            name = f"{pair.force}.f{axis}"
            text = f"pushes {pair.pose}.p{axis} the wrong way ({s:.3g} times what it causes, all axes {scale:.3g}): its sign is turned"
            yield Remark("error", record.run, name, text, scale_fix(name, -1.0), {"scale": s}, "sign")
    size = abs(scale)
    if 1 / SCALE < size < SCALE or at_fault:
        return
    text = f"{_causes(pair, scale)}: {factor_text(1.0 / size, 'N')}"
    for name in _moving(pair):
        yield Remark("error", record.run, name, text, scale_fix(name, likely_scale(1.0 / size, "N")), {"scale": scale}, "unit")


def _causes(pair: Momentum, scale: float) -> str:
    return f"mass times the change of velocity in {pair.pose} is {abs(scale):.4g} times the impulse of the force"


def _moving(pair: Momentum) -> list[str]:
    """The columns of the force that clearly move the pose, z at least."""
    return [f"{pair.force}.f{axis}" for axis in dict.fromkeys(("z", *pair.axes))]


def _pose_at_fault(pair: Momentum, start: Start | None) -> bool:
    """Whether the pose's own start shows the same factor or sign: then it is the pose that is in another unit, not the force."""
    if start is None or not start.ratios:
        return False
    off = start.unit if start.unit is not None else 1.0
    same_size = off != 1.0 and abs(math.log(off) - math.log(max(abs(pair.scale), 1e-300))) < math.log(AGREE) * 2
    return same_size or (pair.scale < 0 and start.reversed)
