"""How far the believed rig departs from its command, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.contact.mount_dynamics import borne
from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.links import flat_pose
from hiltestbed.diagnosis.settings import BLOCK
from hiltestbed.frames import Array
from hiltestbed.identification.samples import GATE_SIGMA
from hiltestbed.measured import MeasuredRun
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.replay import Engaged, Played, can_carry, follows_exactly, moves_linearly, replay_rig
from hiltestbed.replay.compensation import central_rates
from hiltestbed.replay.wrench import shifted
from hiltestbed.scenario import Scenario

KNOWN = 0.25  # of the deflection that a wrong reading of the force may falsify: the largest gain error that goes unnoticed here
OFF = 5e-3  # [s] that the reading may be later than believed, or earlier
AS_TOLD = 1e-8  # [m] noise of a reached pose, up to which the record holds what a method was told: a servo's own jitter reads as 1e-9
UNFOLLOWED = 0.01  # of a departure: what the drives leave of a jump is not replayed
CONSTANTS = 10.0  # time constants of the drives, within which where they start from is forgotten


@dataclass(frozen=True)
class Deflection:
    """Of one run: away (N, 6) by how much the believed rig departs from its command [m, rad], doubt (N, 6) how well that is known.

    noise: [m] what the noise of the force makes of it.
    """

    away: Array
    doubt: Array
    noise: float = 0.0


def deflection(run: MeasuredRun, noise: float, reading: Array | None = None, engaged: Engaged | None = None) -> Deflection | None:
    """Where the believed rig takes A beside its command; None where it cannot follow it.

    What is not known takes whole blocks of rows the same way, and is counted like white noise that is larger by the root of a block.
    noise: [N] of the force. reading: (N, 6) what the believed sensor would show; None: the record. It is read as much earlier as the
    believed sensor is late; where none was measured, the pose tells nothing once A has reached P. engaged: see :func:`engagement`.
    """
    scenario, command = run.scenario, np.ascontiguousarray(run.record.filled("pose_cmd"))
    if follows_exactly(scenario):
        return Deflection(np.zeros((len(command), 6)), np.zeros((len(command), 6)))
    recorded = run.record.filled("wrench_meas") if run.record.has("wrench_meas") else np.zeros((len(command), 6))
    reading = recorded if reading is None else reading
    late = scenario.sensor.delay / scenario.tick
    touching = run.survey.touching(len(reading), round(late), GATE_SIGMA * noise)[:, None]  # else the reading is noise: nothing bears
    wrench = shifted(np.where(touching, reading, 0.0), late)
    rates = run.record.filled("twist_cmd") if run.record.has("twist_cmd") else None
    told = flat_pose(np.vstack([approach_state(scenario)[:7], command[:-1]]))
    reached = _as_told(run)
    taken = 0.0 if engaged is None else engaged.taken
    path = replay_rig(scenario, command, rates, borne(scenario, wrench) + taken, recorded, reached)
    if path is None:
        return None
    away = flat_pose(path) - told
    departure = np.nanmax(np.abs(flat_pose(run.record.data["pose_act"]) - told - away), axis=0, initial=0.0)
    departure[:3], departure[3:] = departure[:3].max(), departure[3:].max()
    unloaded = replay_rig(scenario, command, rates, borne(scenario, np.zeros_like(wrench)), recorded, reached)
    yielded = away if unloaded is None else flat_pose(path) - flat_pose(unloaded)  # what the command makes is known, whatever was read
    off = [np.abs(shifted(yielded, way * OFF / scenario.tick) - yielded) for way in (-1.0, 1.0)]
    doubt = math.sqrt(BLOCK) * np.sqrt((KNOWN * yielded) ** 2 + np.maximum(*off) ** 2 + (UNFOLLOWED * departure) ** 2)
    doubt[: math.ceil(_settling(scenario) / scenario.tick)] = np.inf
    if not run.record.has("wrench_meas"):
        doubt[np.maximum.accumulate(told[:, 2] > -departure[2])] = np.inf
    if engaged is not None:  # what slides turns about within a tick, from which the drives keep what they stick at
        chattering = replay_rig(scenario, command, rates, borne(scenario, wrench) + taken, recorded, reached, engaged.between)
        if chattering is not None:
            kept = np.maximum.accumulate(np.abs(flat_pose(chattering) - flat_pose(path)), axis=0)
            doubt = np.hypot(doubt, math.sqrt(BLOCK) * kept)
    passed = np.zeros(6)
    if noise > 0.0:
        shaken = wrench.copy()
        shaken[:, :3] += np.where(touching, noise * np.random.default_rng(0).standard_normal((len(wrench), 3)), 0.0)
        noisy = replay_rig(scenario, command, rates, borne(scenario, shaken) + taken, recorded, reached)
        passed = np.std(flat_pose(noisy) - flat_pose(path), axis=0) if noisy is not None else passed
        doubt = np.hypot(doubt, passed * math.sqrt(max(1.0, _memory(scenario) / scenario.tick)))
    return Deflection(away, doubt, float(passed[:3].max()))


def engagement(run: MeasuredRun) -> Engaged | None:
    """What its contact does along the pose on record, where that takes playing it; None where it follows from the pose, or where no such
    mechanism can have gone along it."""
    if sides_of(run.scenario.mechanism).rigid or not can_carry(run.scenario):
        return None
    path = np.ascontiguousarray(run.record.filled("pose_act"))
    rates = run.record.filled("twist_act") if run.record.whole("twist_act") else central_rates(run.scenario, path)
    found = Played([run.scenario], path[None], None if moves_linearly(run.scenario) else np.ascontiguousarray(rates)[None]).believed(0)
    return found if np.isfinite(found.taken).all() and np.isfinite(found.wrench).all() else None


def _as_told(run: MeasuredRun) -> Array | None:
    """(N, 7) the pose that a motion compensation was told, where the record holds it: without the noise that a log may have added."""
    record = run.record
    if "pose" not in run.scenario.compensation.motion.reads or not record.whole("pose_act"):
        return None
    noisy = max(run.survey.noise[f"pose_act.{axis}"].white for axis in ("px", "py", "pz") if f"pose_act.{axis}" in run.survey.noise)
    return record.filled("pose_act") if noisy <= AS_TOLD else None


def _memory(scenario: Scenario) -> float:
    """[s] of a deflection that count as one: its noise is that of the force, through the drives."""
    return 1.0 / scenario.rig.platform.nearest_bandwidth(scenario)


def _settling(scenario: Scenario) -> float:
    """[s] until where the drives start from is forgotten."""
    return CONSTANTS / (2.0 * math.pi * scenario.rig.platform.nearest_bandwidth(scenario))
