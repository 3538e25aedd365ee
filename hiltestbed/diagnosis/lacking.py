"""Stage "layout": which links are not judged, and why: channels that the data lack, or a rig that
cannot be replayed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.links import ModelLink
from hiltestbed.measured import MeasuredRun
from hiltestbed.measured.momentum import centred
from hiltestbed.replay import can_carry, follows_exactly
from hiltestbed.replay.compensation import needs
from hiltestbed.signals import GROUPS

# derived: of the rows in which effects show. The smallest size that shows goes with the inverse
# root of their number: below a quarter an effect must be more than twice as large
LEAST_SHARE = 0.25
MAX_UNKNOWN_SHARE = 0.9  # chosen: of the rows of every run, that depend on missing samples


def lacking(runs: Sequence[MeasuredRun]) -> dict[str, str]:
    """Link to the reason why it is not judged."""
    if any(r.scenario.rig.platform.physical for r in runs):
        free = "the bodies move freely: nothing is computed or commanded"
        return dict.fromkeys(("platform", "compensation", "dynamics"), free) | _lacking_of_wrench(
            runs
        )
    out = {}
    if not every_run_has(runs, "pose_cmd", "pose_act"):
        out["platform"] = "needs pose_cmd and pose_act in every run"
    elif not all(all_axes(r, "pose_cmd") for r in runs if not r.scenario.rig.platform.prescribed):
        out["platform"] = (
            "needs all axes of pose_cmd: with motion off the axis of insertion each drive moves "
            "with all of them"
        )
    if not every_run_has(runs, "wrench_meas", "wrench_comp"):
        out["compensation"] = "needs wrench_meas and wrench_comp in every run"
    else:
        groups = sorted({g for r in runs for g in needs(r.scenario)} - {"wrench_meas"})
        if not every_run_has(runs, *groups):
            kinds = ", ".join(sorted({r.scenario.compensation.force.kind for r in runs}))
            out["compensation"] = (
                f"needs {' and '.join(groups)} in every run for compensation.force {kinds}"
            )
        elif not all(all_axes(r, g) for r in runs for g in (needs(r.scenario) if groups else ())):
            kinds = " and ".join(["wrench_meas", *groups])
            out["compensation"] = (
                f"needs all axes of {kinds}: with motion off the axis of insertion each of them "
                f"acts on the force"
            )
    if not every_run_has(runs, "wrench_comp", "pose_cmd"):
        out["dynamics"] = "needs wrench_comp and pose_cmd in every run"
    elif not all(all_axes(r, "wrench_comp") for r in runs):
        out["dynamics"] = (
            "needs all axes of wrench_comp: with motion off the axis of insertion each of them "
            "acts on all of pose_cmd"
        )
    elif all(
        not r.record.only_short_gaps("wrench_comp")
        and r.record.unknown("wrench_comp")[-1]
        and r.record.unknown("wrench_comp").mean() > MAX_UNKNOWN_SHARE
        for r in runs
    ):
        out["dynamics"] = (
            "needs wrench_comp without gaps: the effect of a missing sample on the motion is "
            "permanent"
        )
    return out | _lacking_of_wrench(runs)


def too_little(link: ModelLink) -> str | None:
    """Why a link on which nothing departs is not judged: losses left too little of the rows in
    which its effects show, those in contact or, of a platform, all; None where they did not.
    """
    counted = np.concatenate(
        [
            np.isfinite(run.sigma[run.touching | (link.name == "platform")]).any(axis=1)
            for run in link.runs
        ]
    )
    share = float(np.mean(counted)) if len(counted) else 1.0
    if share >= LEAST_SHARE:
        return None
    if share > 0.0:
        return (
            f"{share:.0%} of the rows in which its effects show could be compared: only effects "
            f"{share**-0.5:.2g} times as large as in a whole record would show"
        )
    return "no row in which its effects show could be compared"


def _lacking_of_wrench(runs: Sequence[MeasuredRun]) -> dict[str, str]:
    out = {}
    if not every_run_has(runs, "wrench_meas"):
        out["wrench"] = "needs wrench_meas in every run"
    elif not every_run_has(runs, "wrench_meas.fz"):
        out["wrench"] = "needs wrench_meas.fz in every run"
    elif not all(r.record.has("pose_act") or r.record.has("pose_cmd") for r in runs):
        out["wrench"] = "needs pose_act or pose_cmd in every run"
    elif not all(all_axes(r, "pose_act", "pose_cmd") for r in runs):
        out["wrench"] = (
            "needs all axes of pose_act or pose_cmd: with motion off the axis of insertion the "
            "contact depends on each of them"
        )
    elif not all(
        r.record.has("pose_act") or follows_exactly(r.scenario) or all_axes(r, "wrench_meas")
        for r in runs
    ):
        out["wrench"] = (
            "needs pose_act, or all axes of wrench_meas: the drives yield to each of them"
        )
    elif not any(r.survey.contacts for r in runs):
        out["wrench"] = "needs a contact"
    elif not all(sides_of(r.scenario.mechanism).rigid or can_carry(r.scenario) for r in runs):
        out["wrench"] = (
            "the mechanism has parts that move, or parts that collide at several points: its "
            "force follows from how A moves within a tick, "
            "which is not on record; it is judged where tracking is ideal or servo and nothing "
            "moves P"
        )
    elif any(
        r.scenario.rig.upper.kind != "fixed" and r.scenario.mechanism.latch is not None
        for r in runs
    ):
        out["wrench"] = (
            "a latch closes while the upper platform moves: where it holds A depends on motion "
            "within a tick, which is not on record"
        )
    return out


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
