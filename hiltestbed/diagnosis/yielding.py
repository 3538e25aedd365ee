"""Stage "layout": deflection of the believed rig from its command, under the measured force, and
its uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.contact.mount_dynamics import borne
from hiltestbed.contact.sides import sides_of
from hiltestbed.diagnosis.lacking import all_axes
from hiltestbed.diagnosis.links import flat_pose
from hiltestbed.diagnosis.settings import BLOCK_ROWS
from hiltestbed.frames import Array
from hiltestbed.identification.samples import GATE_SIGMA
from hiltestbed.measured import MeasuredRun
from hiltestbed.numerical_model.bodies import approach_state, approach_states
from hiltestbed.platform.build import nearest_bandwidth, runs_of
from hiltestbed.replay import (
    Engaged,
    Simulated,
    can_carry,
    follows_exactly,
    moves_linearly,
    replay_rig,
)
from hiltestbed.replay.compensation import central_rates
from hiltestbed.replay.wrench import shifted

# chosen: of the deflection, due to a wrong reading of the force: the largest gain error that goes
# unnoticed here
MAX_GAIN_ERROR = 0.25
MAX_READING_SHIFT = 5e-3  # chosen: [s] by which the reading may be later or earlier than believed
# chosen: [m] noise below which the recorded pose is the one a method was given: a servo's own
# jitter reads as 1e-9
NOISELESS_POSE = 1e-8
UNREPLAYED_SHARE = 0.01  # chosen: of a departure: what the drives leave of a jump is not replayed
# chosen: time constants of the drives, after which their initial state has decayed
SETTLING_CONSTANTS = 10.0


@dataclass(frozen=True)
class Deflection:
    """Of one run: away (N, 6) deflection of the believed rig from its command [m, rad], doubt (N,
    6) its uncertainty.

    yielded: (N, 6) part of it that is due to the force; the rest is the response to the command.
        noise: [m] of the deflection, due to the noise of the force.
    """

    away: Array
    yielded: Array
    doubt: Array
    noise: float = 0.0


def deflection(run: MeasuredRun, noise: float, engaged: Engaged | None = None) -> Deflection | None:
    """Deflection of the believed rig from its command in one run; None where it cannot follow the
    command.

    Its error has one sign over whole blocks of rows, and counts like white noise that is larger by
    the root of a block. noise: [N] of the force, which is on record later by the believed delay of
    the sensor; where an axis of it that acts was not measured, the pose is not compared once A has
    reached P. engaged: see :func:`engagement`.
    """
    scenario = run.scenario
    if follows_exactly(scenario.rig, scenario.compensation):
        nothing = np.zeros((run.record.ticks, 6))
        return Deflection(nothing, nothing, nothing)
    touching, wrench = _load(run, _recorded(run), noise, engaged)
    told, taken = flat_pose(told_pose(run)), 0.0 if engaged is None else engaged.taken
    path = _replayed(run, wrench, taken)
    if path is None:
        return None
    away = path - told
    shown = flat_pose(run.record.data["pose_act"]) - told if run.record.has("pose_act") else away
    departure = np.nanmax(np.abs(shown - away), axis=0, initial=0.0)
    departure[:3], departure[3:] = departure[:3].max(), departure[3:].max()
    unloaded = _replayed(run, np.zeros_like(wrench))
    # the rest is the response to the command, which is known
    yielded = away if unloaded is None else path - unloaded
    rows = MAX_READING_SHIFT / scenario.tick
    off = np.maximum(*(np.abs(shifted(yielded, way * rows) - yielded) for way in (-1.0, 1.0)))
    parts = (MAX_GAIN_ERROR * yielded, off, UNREPLAYED_SHARE * departure + np.zeros_like(off))
    alike = math.sqrt(BLOCK_ROWS)
    doubt = alike * np.sqrt(np.sum(np.square(parts), axis=0))
    band = nearest_bandwidth(scenario)
    settling = SETTLING_CONSTANTS / (2.0 * math.pi * band)
    doubt[: math.ceil(settling / scenario.tick)] = np.inf
    if not all_axes(run, "wrench_meas"):
        doubt[np.maximum.accumulate(told[:, 2] > -departure[2])] = np.inf
    # sliding parts reverse within a tick; stiction of the drives retains the effect
    if engaged is not None:
        chattering = _replayed(run, wrench, taken, engaged.between)
        if chattering is not None:
            kept = np.maximum.accumulate(np.abs(chattering - path), axis=0)
            doubt = np.hypot(doubt, alike * kept)
    if noise <= 0.0:
        return Deflection(away, yielded, doubt)
    shaken = wrench.copy()
    error = noise * np.random.default_rng(0).standard_normal((len(wrench), 3))
    shaken[:, :3] += np.where(touching, error, 0.0)
    noisy = _replayed(run, shaken, taken)
    passed = np.zeros(6) if noisy is None else np.std(noisy - path, axis=0)
    # it is correlated for as long as the drives remember
    doubt = np.hypot(doubt, passed * math.sqrt(max(1.0, 1.0 / band / scenario.tick)))
    return Deflection(away, yielded, doubt, float(passed[:3].max()))


def yielded_under(run: MeasuredRun, found: Deflection, reading: Array, noise: float) -> Array:
    """`yielded` of a deflection that was ``found``, under another ``reading`` (N, 6)."""
    _, wrench = _load(run, reading, noise)
    path = _replayed(run, wrench)
    if path is None:
        return found.yielded
    return path - flat_pose(told_pose(run)) - (found.away - found.yielded)


def _replayed(
    run: MeasuredRun, reading: Array, taken: Array | float = 0.0, between: Array | None = None
) -> Array | None:
    """(N, 6) flat pose of the believed rig on its command under the load of a ``reading`` (N, 6),
    what parts have ``taken`` and what is ``between`` rows; None where it cannot follow.
    """
    record, scenario = run.record, run.scenario
    load = borne(scenario.mechanism, scenario.tick, reading) + taken
    command = np.ascontiguousarray(record.filled("pose_cmd"))
    rates = record.filled("twist_cmd") if record.has("twist_cmd") else None
    reached = _noiseless_pose(run)
    path = replay_rig(scenario, command, rates, load, _recorded(run), reached, between)
    return None if path is None else flat_pose(path)


def _load(
    run: MeasuredRun, reading: Array, noise: float, engaged: Engaged | None = None
) -> tuple[np.ndarray, Array]:
    """(N, 1) where there is a contact, outside of which the reading is noise; (N, 6) the wrench
    that the drives bear.

    A mechanism that holds A still acts where its force passes through zero: the survey takes that
    for a gap, ``engaged`` tells.
    """
    late = run.scenario.sensor.delay / run.scenario.tick
    touching = run.survey.touching(len(reading), round(late), GATE_SIGMA * noise)[:, None]
    if engaged is not None:
        acts = np.flatnonzero(engaged.wrench.any(axis=(1, 2)))
        touching[
            np.unique(np.minimum(acts[:, None] + np.arange(round(late) + 1), len(reading) - 1))
        ] = True
    return touching, shifted(np.where(touching, reading, 0.0), late)


def _recorded(run: MeasuredRun) -> Array:
    """(N, 6) the measured wrench; zero where none was measured."""
    if run.record.has("wrench_meas"):
        return run.record.filled("wrench_meas")
    return np.zeros((run.record.ticks, 6))


def told_pose(run: MeasuredRun) -> Array:
    """(N, 7) the commanded pose one row later."""
    return np.vstack(
        [approach_state(run.scenario.approach)[:7], run.record.filled("pose_cmd")[:-1]]
    )


def engagement(run: MeasuredRun) -> Engaged | None:
    """The action of the contact along the pose on record, where only playing the mechanism gives
    it; None where it follows from the pose, or where no such mechanism can have taken that path.
    """
    scenario, record = run.scenario, run.record
    if sides_of(scenario.mechanism).rigid or not can_carry(scenario.rig):
        return None
    path, rates = np.ascontiguousarray(record.filled("pose_act")), None
    if not moves_linearly(scenario.rig):
        rates = central_rates(scenario.approach, scenario.tick, path)
        if record.whole("twist_act"):
            rates = record.filled("twist_act")
        rates = np.ascontiguousarray(rates)[None]
    start = approach_states([scenario.approach])
    carried = Simulated([scenario.mechanism], start, runs_of([scenario]), path[None], rates)
    found = carried.believed(0)
    return found if np.isfinite(found.taken).all() and np.isfinite(found.wrench).all() else None


def _noiseless_pose(run: MeasuredRun) -> Array | None:
    """(N, 7) the pose that a motion compensation was given, where the record has no noise."""
    record, noise = run.record, run.survey.noise
    if "pose" not in run.scenario.compensation.motion.reads or not record.whole("pose_act"):
        return None
    places = (f"pose_act.{axis}" for axis in ("px", "py", "pz"))
    noisy = max(noise[name].white for name in places if name in noise)
    return record.filled("pose_act") if noisy <= NOISELESS_POSE else None
