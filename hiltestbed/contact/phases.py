"""Capture: the phases of a mechanism, when each begins and what it does; the latch of a probe in
its cone.

Conditions are evaluated once per tick, at the state for which the contacts were last evaluated. A
phase begins when its condition has held for the required time and the previous phase has begun: its
latch closes, its actuators get their commands, its geoms no longer touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.contact.composition import ACTIVE, Structure
from hiltestbed.contact.description import Phase, matching
from hiltestbed.contact.engagement import Engagement
from hiltestbed.contact.latches import site_state
from hiltestbed.contact.legs import RingLegs
from hiltestbed.contact.sides import Sides
from hiltestbed.contact.wrench import relate_one
from hiltestbed.errors import InputError
from hiltestbed.frames import Array


class _Condition(NamedTuple):
    """A condition as arrays, of Q pairs of sites: their frames (Q, 2) and poses (Q, 2, 7)."""

    frames: NDArray[np.int64]
    places: Array
    needed: int
    limits: Array  # distance [m], cosine, speed [m/s]
    joints: NDArray[np.int64]  # indices in qpos
    ranges: Array  # (J, 2) [m, rad]
    lasting: float


class Phases:
    """The progress of capture of `n` runs.

    Attributes:
        begun: (n,) int64, number of phases begun. since: (n, K) tick at which each began, -1
            before. names: of the phases. legs: of an active ring, or None.
    """

    def __init__(
        self, batch: Batch, structure: Structure, tick: float, n: int, legs: RingLegs | None
    ) -> None:
        """``tick``: [s] between evaluations. Raises InputError for an unknown joint or actuator."""
        self.legs = legs
        self._phases = structure.mechanism.phases()
        self.names = [p.name for p in self._phases]
        model, sides = batch.model, structure.sides
        self._commands = [actuators_of(phase, model) for phase in self._phases]
        self._dropped = [dropped_by(sides, phase.drop_contacts) for phase in self._phases]
        self._ctrl, qpos = batch.bind("ctrl"), batch.bind("qpos")
        self.begun = np.zeros(n, dtype=np.int64)
        self.since = np.full((n, len(self._phases)), -1, dtype=np.int64)
        self._held, self._due = np.zeros(n), np.zeros(n, dtype=bool)
        now = (self.begun, self._held, self._due)
        self._looks = [
            Call(_look, k, tick, _condition(phase, sides.sites, model), qpos, GIVEN, GIVEN, *now)
            for k, phase in enumerate(self._phases)
        ]
        self._ticks = np.zeros(1, dtype=np.int64)

    def reset(self) -> None:
        """Return to the state before the first phase."""
        self.begun[:], self.since[:], self._held[:], self._ticks[0] = 0, -1, 0.0, 0

    def look(self, engagement: Engagement) -> None:
        """Begin the phases whose conditions hold; call once per tick."""
        self._ticks[0] += 1
        frames, motions = engagement.frames, engagement.motions
        # from the last phase down, so that a run begins at most one phase per tick
        for k in range(len(self._phases) - 1, -1, -1):
            if not (self.begun == k).any():
                continue
            self._looks[k].on(frames, motions)()
            if self._due.any():
                self._begin(k, engagement)

    def _begin(self, k: int, engagement: Engagement) -> None:
        phase, due = self._phases[k], self._due
        if phase.close is not None:
            engagement.close(engagement.latches.number(phase.name), due, np.zeros((len(due), 3)))
        for actuator, value in self._commands[k]:
            self._ctrl[due, actuator] = value
        if self.legs is not None:
            self.legs.begin(phase.name, due)
        if self._dropped[k].size:
            engagement.release(due, self._dropped[k])
        self.begun[due] = k + 1
        self.since[due, k] = self._ticks[0]
        self._held[due] = 0.0


def _condition(
    phase: Phase, sites: dict[tuple[str, str], tuple[int, Array]], model: mujoco.MjModel
) -> _Condition:
    when = phase.when
    pairs = [(sites["A", a], sites["P", p]) for a, p in when.pairs]
    return _Condition(
        np.array([[a[0], p[0]] for a, p in pairs], dtype=np.int64),
        np.array([[a[1], p[1]] for a, p in pairs]),
        when.count or len(pairs),
        np.array([when.within, np.cos(np.radians(when.angle_deg)), when.speed]),
        joints_of(phase, model),
        np.array(list(when.joints.values())).reshape(-1, 2),
        when.lasting,
    )


def joints_of(phase: Phase, model: mujoco.MjModel) -> NDArray[np.int64]:
    """Indices in qpos of the joints of a phase's condition. Raises InputError."""
    names = [model.joint(i).name for i in range(model.njnt)]
    return np.array(
        [model.jnt_qposadr[_index(name, names, phase, "joint")] for name in phase.when.joints],
        dtype=np.int64,
    )


def actuators_of(phase: Phase, model: mujoco.MjModel) -> list[tuple[int, float]]:
    """Numbers of the actuators that a phase commands, and their commands. Raises InputError."""
    names = [model.actuator(i).name for i in range(model.nu)]
    return [
        (_index(name, names, phase, "actuator"), value) for name, value in phase.command.items()
    ]


def dropped_by(sides: Sides, patterns: Sequence[str]) -> NDArray[np.int64]:
    """Numbers of the pairs whose active geom matches one of the ``patterns``."""
    pairs = (*sides.facets, *sides.native)
    return np.array(
        [k for k, pair in enumerate(pairs) if any(matching(p, [pair.active]) for p in patterns)],
        dtype=np.int64,
    )


def _index(name: str, names: list[str], phase: Phase, what: str) -> int:
    if ACTIVE + name not in names:
        have = ", ".join(n.removeprefix(ACTIVE) for n in names if n.startswith(ACTIVE)) or "none"
        raise InputError(
            f"phase {phase.name!r}: the active side has no {what} {name!r}; its {what}s are {have}"
        )
    return names.index(ACTIVE + name)


@njit(cache=True)
def _look(k, tick, condition, qpos, frames, motions, begun, held, due):
    """Mark in ``due`` (n,) where phase ``k`` begins; ``held`` (n,) [s]: how long it has held."""
    pairs, places, needed, limits, joints, ranges, lasting = condition
    site, velocity = np.empty((2, 7)), np.empty((2, 6))
    at, rate, work = np.empty(7), np.empty(6), np.empty((1, 3))
    for i in range(begun.shape[0]):
        due[i] = False
        if begun[i] != k:
            continue
        met = 0
        for q in range(pairs.shape[0]):
            for e in range(2):
                f = pairs[q, e]
                site_state(frames[i, f], motions[i, f], places[q, e], site[e], velocity[e])
            relate_one(site[0], velocity[0], site[1], velocity[1], at, rate, work)
            away = at[0] ** 2 + at[1] ** 2 + at[2] ** 2
            speed = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
            aligned = 1.0 - 2.0 * (at[3] ** 2 + at[4] ** 2)  # cosine between the z axes
            if away <= limits[0] ** 2 and speed <= limits[2] ** 2 and aligned >= limits[1]:
                met += 1
        holds = met >= needed
        for j in range(joints.shape[0]):
            holds &= ranges[j, 0] <= qpos[i, joints[j]] <= ranges[j, 1]
        if not holds:
            held[i] = 0.0
            continue
        due[i] = held[i] >= lasting - 0.5 * tick
        held[i] += tick


class LatchCondition:
    """The closing conditions of `n` runs: depth, alignment and speed, all at once."""

    def __init__(self, limits: Array) -> None:
        """``limits``: (n, 3), see :func:`hiltestbed.contact.parameters.latch_limits`."""
        self._closing = np.zeros(len(limits), dtype=bool)
        self._due = Call(_due, GIVEN, GIVEN, limits, GIVEN, self._closing)

    def close(self, engagement: Engagement) -> None:
        """Latch the runs whose condition holds at the state of the last update."""
        if self._due.on(*engagement.relative(), engagement.latched)():
            engagement.capture(self._closing)


@njit(cache=True)
def closes(pose, twist, limits):
    """Whether a latch closes; for ``limits`` (3,) see ``parameters.latch_limits``."""
    aligned = 1.0 - 2.0 * (pose[3] ** 2 + pose[4] ** 2)  # cosine between the axes
    speed2 = twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2
    return pose[2] >= -limits[0] and aligned >= limits[1] and speed2 <= limits[2] ** 2


@njit(cache=True)
def _due(pose, twist, limits, latched, due):
    """Mark in ``due`` (n,) the runs that are to latch now; returns whether there is any."""
    some = False
    for i in range(pose.shape[0]):
        due[i] = not latched[i] and closes(pose[i], twist[i], limits[i])
        some |= due[i]
    return some
