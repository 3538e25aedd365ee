"""Strength of a hidden effect: its size relative to the noise of its link's records."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.equipment.independent_rig.closed_loop import simulate
from tests.equipment.independent_rig.compensation import LEAD, METHODS
from tests.equipment.independent_rig.facility import Facility
from tests.equipment.independent_rig.generation import draw_noise, link_of, rig_of, sigma_of
from tests.equipment.independent_rig.links import Rig, silence

MODEL_NOISE = 2e-6  # m, reference for pose_cmd, which is computed and has no noise
RUNS = (1, 3, 4)  # runs that are evaluated
AMPLIFYING = (METHODS["phase_lead"], METHODS["reconstruction"])


def strength(
    facility: Facility, effects: list[dict[str, Any]], which: int, variants: dict[str, Any]
) -> float:
    """Size of effect `which` relative to the noise in its link's records, in the run where it is
    largest; see `HiddenSet`.
    """
    rest = [e for i, e in enumerate(effects) if i != which]
    return max(
        _strength(facility, run, effects, rest, link_of(effects[which]["kind"]), variants)
        for run in RUNS
    )


def _strength(
    facility: Facility, run: int, effects: list, rest: list, link: str, variants: dict[str, Any]
) -> float:
    without, full = (rig_of(facility, run, e, variants) for e in (rest, effects))
    drawn = draw_noise(np.random.default_rng(run), facility, full.ticks)
    quiet = silence(full.ticks)._replace(delay=drawn.delay, repeat=drawn.repeat)
    plain = simulate(without, quiet)
    cut = simulate(full, quiet, pose_cmd=plain.pose_cmd, wrench_comp=plain.wrench_comp)
    forces = sigma_of(facility)
    if link == "platform":
        change = (cut.pose_act - plain.pose_act)[:, :3] / facility.pose_noise
    elif link == "dynamics":
        change = (cut.pose_cmd - plain.pose_cmd)[:, :3] / MODEL_NOISE
    elif link == "compensation":
        change = (cut.wrench_comp - plain.wrench_comp) / forces / _amplification(full)
    else:
        change = (cut.wrench_meas - plain.wrench_meas) / forces
    on = plain.touching | cut.touching
    return float(np.sqrt(np.max(np.mean(change[on] ** 2, axis=0)))) if on.any() else 0.0


def _amplification(rig: Rig) -> float:
    """Factor by which the method amplifies the noise of a row."""
    comp = rig.compensator
    if comp.method not in (LEAD, *AMPLIFYING):
        return 1.0
    return (comp.t1 * rig.rate + 1.0) / (comp.t2 * rig.rate + 1.0)
