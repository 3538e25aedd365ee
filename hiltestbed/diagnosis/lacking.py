"""Stage "layout": which links are not judged, and why: channels that the data lack, or a rig that
cannot be replayed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.links import ModelLink
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.momentum import centred
from hiltestbed.replay import can_carry, follows_exactly
from hiltestbed.replay.compensation import needs
from hiltestbed.signals import GROUPS

OFF_AXIS = "with motion off the axis of insertion"
# derived: of the rows in which effects show. The smallest size that shows goes with the inverse
# root of their number: below a quarter an effect must be more than twice as large
LEAST_SHARE = 0.25


def lacking(runs: Sequence[MeasuredRun]) -> dict[str, str]:
    """Link to the reason why it is not judged."""
    why = {link: reason(runs) for link, reason in REASONS.items()}
    if any(r.scenario.rig.platform.physical for r in runs):
        free = "the bodies move freely: nothing is computed or commanded"
        why |= dict.fromkeys(("platform", "compensation", "dynamics"), free)
    return {link: reason for link, reason in why.items() if reason}


def _of_platform(runs: Sequence[MeasuredRun]) -> str | None:
    if not every_run_has(runs, "pose_cmd", "pose_act"):
        return "needs pose_cmd and pose_act in every run"
    if not all(all_axes(r, "pose_cmd") for r in runs if not r.scenario.rig.platform.prescribed):
        return f"needs all axes of pose_cmd: {OFF_AXIS} each drive moves with all of them"
    return None


def _of_compensation(runs: Sequence[MeasuredRun]) -> str | None:
    if not every_run_has(runs, "wrench_meas", "wrench_comp"):
        return "needs wrench_meas and wrench_comp in every run"
    scenarios = [r.scenario for r in runs]
    needed = [needs(s.compensation, s.mechanism) for s in scenarios]
    groups = sorted(set().union(*needed) - {"wrench_meas"})
    if not every_run_has(runs, *groups):
        kinds = ", ".join(sorted({s.compensation.force.kind for s in scenarios}))
        return f"needs {' and '.join(groups)} in every run for compensation.force {kinds}"
    pairs = zip(runs, needed, strict=True)
    if groups and not all(all_axes(r, g) for r, own in pairs for g in own):
        kinds = " and ".join(["wrench_meas", *groups])
        return f"needs all axes of {kinds}: {OFF_AXIS} each of them acts on the force"
    return None


def _of_dynamics(runs: Sequence[MeasuredRun]) -> str | None:
    if not every_run_has(runs, "wrench_comp", "pose_cmd"):
        return "needs wrench_comp and pose_cmd in every run"
    if not all(all_axes(r, "wrench_comp") for r in runs):
        return f"needs all axes of wrench_comp: {OFF_AXIS} each of them acts on all of pose_cmd"
    return None


def _of_wrench(runs: Sequence[MeasuredRun]) -> str | None:
    if not every_run_has(runs, "wrench_meas"):
        return "needs wrench_meas in every run"
    if not every_run_has(runs, "wrench_meas.fz"):
        return "needs wrench_meas.fz in every run"
    if not all(r.record.has("pose_act") or r.record.has("pose_cmd") for r in runs):
        return "needs pose_act or pose_cmd in every run"
    if not all(all_axes(r, "pose_act", "pose_cmd") for r in runs):
        either = "pose_act or pose_cmd"
        return f"needs all axes of {either}: {OFF_AXIS} the contact depends on each of them"
    if not all(
        r.record.has("pose_act")
        or follows_exactly(r.scenario.rig, r.scenario.compensation)
        or all_axes(r, "wrench_meas")
        for r in runs
    ):
        return "needs pose_act, or all axes of wrench_meas: the drives yield to each of them"
    if not any(r.survey.contacts for r in runs):
        return "needs a contact"
    if not all(sides_of(r.scenario.mechanism).rigid or can_carry(r.scenario.rig) for r in runs):
        return (
            "the mechanism has parts that move, or parts that collide at several points: its "
            "force follows from how A moves within a tick, which is not on record; it is judged "
            "where tracking is ideal or servo and nothing moves P"
        )
    rigs = [(r.scenario.rig.upper.kind, r.scenario.mechanism.latch) for r in runs]
    if any(upper != "fixed" and latch is not None for upper, latch in rigs):
        return (
            "a latch closes while the upper platform moves: where it holds A depends on motion "
            "within a tick, which is not on record"
        )
    return None


REASONS: dict[str, Callable[[Sequence[MeasuredRun]], str | None]] = {
    "platform": _of_platform,
    "compensation": _of_compensation,
    "dynamics": _of_dynamics,
    "wrench": _of_wrench,
}


def too_little(link: ModelLink) -> str | None:
    """Why a link on which nothing departs is not judged: losses left too little of the rows in
    which its effects show, those in contact or, of a platform, all; None where they did not.
    """
    everywhere = link.name == "platform"
    inside = np.concatenate([r.sigma[r.touching | everywhere] for r in link.runs])
    share = float(np.mean(np.isfinite(inside).any(axis=1))) if len(inside) else 1.0
    if share >= LEAST_SHARE:
        return None
    if share > 0.0:
        return (
            f"{share:.0%} of the rows in which its effects show could be compared: only effects "
            f"{share**-0.5:.2g} times as large as in a whole record would show"
        )
    return "no row in which its effects show could be compared"


def all_axes(run: MeasuredRun, *groups: str) -> bool:
    """Whether each axis that moves is on record in one of the ``groups``, which have the same axes.
    By symmetry none but z moves where all is centred.
    """
    return (centred(run.scenario) and any(run.record.has(g) for g in groups)) or on_record(
        run, *groups
    )


def on_record(run: MeasuredRun, *groups: str) -> bool:
    """Whether each axis that the rig can move is on record in one of the ``groups``."""
    moving = [
        part for part in GROUPS[groups[0]].parts if part not in run.scenario.rig.platform.still
    ]
    measured = [g for g in groups if run.record.has(g)]
    return all(any(f"{g}.{part}" not in run.record.absent for g in measured) for part in moving)


def every_run_has(runs: Sequence[MeasuredRun], *groups: str) -> bool:
    """Whether every run holds all of the groups or columns."""
    return all(r.record.has(g) for r in runs for g in groups)
