"""HILDOCK-1: its cases, its plant (contact, sensor and delay of one axis, tick by tick), and its
indices.

A reduced mass flies against a spring and a damper. An entrant receives the delayed force and
returns the position that the rig reaches at the next tick; it contains the numerical model.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Protocol

TICK = 0.0005  # [s] 2 kHz, the rate of the loop
MASS = 400.0  # [kg] reduced mass of 500 kg and 2000 kg
SPEED = 0.03  # [m/s] of approach
START = -0.00101  # [m] the touch lies between two ticks: round-off cannot move it to another one
FAR = 1.0  # [m] a command beyond it has diverged
FREQUENCIES = (1.0, 2.0, 4.0, 8.0)  # [Hz] of the undamped contact
DELAYS = (0.002, 0.005, 0.010, 0.020)  # [s]
DAMPING_RATIOS = (0.02, 0.05, 0.2)
NOISE = 0.002  # 1 sigma, of SPEED sqrt(k m)
LOW_PASS = 0.001  # [s] time constant in the track `lowpass`
DRIFT = 0.10  # of the delay, over a case
STOP, STOP_STIFFNESS = 0.6, 4.0  # hard stop: position over the linear depth, stiffness over k
OFFS = (-30, -20, -10, 10, 20, 30)  # [%] of the delay that is told
OTHERS = ("jitter", "drift", "lowpass", "hunt_crossley", "hard_stop")
TRACKS = ("exact", *(f"off{off:+d}" for off in OFFS), *OTHERS)
MULTIPLIER, MODULUS = 16807, 2**31 - 1  # S. K. Park, K. W. Miller, CACM 31 (1988)
SEED, SEED_STEP, DISCARDED = 12345, 7919, 20
LAST = 40  # ticks over which the rebound speed is taken: 20 ms
INDICES = (
    "cor_log_error",
    "energy_generated",
    "peak_force_error",
    "contact_time_error",
    "tracking_error",
    "stiffness_error",
    "damping_error",
)


@dataclass(frozen=True)
class Case:
    """One contact. frequency: [Hz]. delay: [s], the true one. track: one of `TRACKS`."""

    number: int
    track: str
    frequency: float
    delay: float
    damping_ratio: float

    @property
    def told(self) -> float:
        """[s] the delay that the entrant is told."""
        off = int(self.track[3:]) if self.track.startswith("off") else 0
        return self.delay * (1.0 + off / 100.0)

    @property
    def stiffness(self) -> float:
        """[N/m]"""
        return MASS * (2.0 * math.pi * self.frequency) ** 2

    @property
    def damping(self) -> float:
        """[N s/m]"""
        return 2.0 * self.damping_ratio * math.sqrt(self.stiffness * MASS)

    @property
    def ticks(self) -> int:
        return math.ceil((-START / SPEED + 0.75 / self.frequency + 0.1) / TICK)

    def force(self, x: float, v: float) -> float:
        """[N] of the contact at a depth [m] and speed [m/s]."""
        if x <= 0.0:
            return 0.0
        k, c = self.stiffness, self.damping
        depth = SPEED / (2.0 * math.pi * self.frequency)
        force = k * x + c * v
        if self.track == "hunt_crossley":
            force = k * x * (1.0 + 2.0 * c / (k * depth) * v)
        if self.track == "hard_stop" and x > STOP * depth:
            force += STOP_STIFFNESS * k * (x - STOP * depth)
        return max(0.0, force)


class Entrant(Protocol):
    """What takes part, one case at a time."""

    name: str

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        """A case begins; delay: [s] as it is believed to be; noise: [N] 1 sigma of the force."""
        ...

    def step(self, tick: int, force: float) -> float:
        """[m] the position to be reached at the next tick, from the measured force [N]."""
        ...

    def end(self) -> tuple[float, float] | None:
        """Stiffness [N/m] and damping [N s/m] that were identified, or None."""
        ...


@dataclass(frozen=True)
class Course:
    """A case as it went: position [m] at ticks 0 ... N and contact force [N] at ticks 0 ... N-1.

    identified: (k, c) of the entrant, or None. diverged: whether it was ended for that.
    """

    position: list[float]
    force: list[float]
    identified: tuple[float, float] | None = None
    diverged: bool = False


def cases(quick: bool = False) -> list[Case]:
    """All cases, numbered as on the page; quick: the same numbers, fewer contacts."""
    every = product(TRACKS, FREQUENCIES, DELAYS, DAMPING_RATIOS)
    return [
        Case(number, *one)
        for number, one in enumerate(every)
        if not quick or (one[1] in (2.0, 8.0) and one[2] in (0.005, 0.020) and one[3] == 0.05)
    ]


def draws(case: int) -> Iterator[float]:
    """Uniform numbers in (0, 1), the same in every language: the products fit in 53 bits."""
    state = SEED + SEED_STEP * case
    drawn = 0
    while True:
        state = MULTIPLIER * state % MODULUS
        drawn += 1
        if drawn > DISCARDED:
            yield state / MODULUS


def in_order(values: Iterable[float]) -> float:
    """The sum from the first to the last, each addition rounded, as other languages have it: `sum`
    carries the remainders along since Python 3.12.
    """
    total = 0.0
    for value in values:
        total += value
    return total


def reference(case: Case) -> Course:
    """The same contact without delay, filter and noise: the force at t_k drives the model."""
    x, v = START, SPEED
    position, force = [x], []
    for _ in range(case.ticks):
        force.append(case.force(x, v))
        v -= TICK * force[-1] / MASS
        x += TICK * v
        position.append(x)
    return Course(position, force)


def play(case: Case, entrant: Entrant) -> Course:
    """A case with an entrant."""
    random = draws(case.number)
    sd = NOISE * SPEED * math.sqrt(case.stiffness * MASS)
    share = TICK / (TICK + LOW_PASS) if case.track == "lowpass" else 1.0
    x, before = START, START - TICK * SPEED
    position, force, sensed, s = [x], [], [], 0.0
    entrant.start(case.number, case.ticks, case.told, sd)
    for k in range(case.ticks):
        force.append(case.force(x, (x - before) / TICK))
        s += share * (force[-1] - s)
        sensed.append(s)
        noise = in_order(next(random) for _ in range(12)) - 6.0
        uniform = next(random)
        delay = case.delay
        if case.track == "drift":
            delay *= 1.0 + DRIFT * k / case.ticks
        if case.track == "jitter":
            delay += (2.0 * uniform - 1.0) * TICK
        at = k - delay / TICK
        late = 0.0
        if at >= 0.0:
            j = int(at)
            late = sensed[j] + (at - j) * (sensed[j + 1] - sensed[j])
        before, x = x, entrant.step(k, late + sd * noise)
        position.append(x)
        if abs(x) > FAR:
            return Course(position, force, diverged=True)
    return Course(position, force, entrant.end())


def rebound(course: Course) -> float | None:
    """Coefficient of restitution, or None where the mass has not left at the end."""
    if course.diverged or len(course.position) <= LAST or course.position[-1] > 0.0:
        return None
    e = (course.position[-1 - LAST] - course.position[-1]) / (LAST * TICK * SPEED)
    return e if e > 0.0 else None


def causal_bound(case: Case, ideal: Course) -> float:
    """Least error of the peak force of a first contact: until the first delayed force has arrived,
    no method can know that there is a contact, and the mass flies on freely.
    """
    force, k, touch = 0.0, 0, None
    while touch is None or k - case.delay / TICK <= touch - 1:
        # the force at tick k + 1, which the answer to tick k commands before anything is known
        k += 1
        x = START + k * TICK * SPEED
        touch = k if touch is None and x > 0.0 else touch
        force = max(force, case.force(x, SPEED))
    return max(0.0, force / max(ideal.force) - 1.0)


def indices(case: Case, course: Course, ideal: Course) -> dict[str, Any]:
    """The record of one case; an index that does not exist is None."""
    e, true = rebound(course), rebound(ideal)
    if true is None:
        raise ValueError(f"case {case.number}: the reference does not leave its contact")
    record: dict[str, Any] = {
        "case": case.number,
        "track": case.track,
        "frequency": case.frequency,
        "delay": case.delay,
        "delay_told": case.told,
        "damping_ratio": case.damping_ratio,
        "cor": e,
        "cor_reference": true,
        "peak_force_bound": causal_bound(case, ideal),
        **dict.fromkeys(INDICES),
    }
    if e is None:
        return record
    touched = sum(f > 0.0 for f in ideal.force)
    n = max(k for k, f in enumerate(ideal.force) if f > 0.0) + 1
    off = [a - b for a, b in zip(course.position[:n], ideal.position[:n], strict=True)]
    record |= {
        "cor_log_error": math.log(e / true),
        "energy_generated": e * e - true * true,
        "peak_force_error": max(course.force) / max(ideal.force) - 1.0,
        "contact_time_error": sum(f > 0.0 for f in course.force) / touched - 1.0,
        "tracking_error": math.sqrt(in_order(d * d for d in off) / n) / max(ideal.position),
    }
    if course.identified is not None and case.track not in ("hunt_crossley", "hard_stop"):
        k, c = course.identified
        record["stiffness_error"] = k / case.stiffness - 1.0
        record["damping_error"] = c / case.damping - 1.0
    return record


def percentile_95(values: Sequence[float]) -> float:
    """The nearest rank: of n sorted values number ceil(0.95 n), counted from one."""
    return sorted(values)[math.ceil(0.95 * len(values)) - 1]


def by_track(records: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Track to its totals: `failed` cases without a rebound; worst and 95th percentile of the
    magnitude of each index; None where a case has none. Energy counts where it is made.
    """
    board = {}
    for track in TRACKS:
        mine = [r for r in records if r["track"] == track]
        row: dict[str, Any] = {"failed": sum(r["cor"] is None for r in mine)}
        for index in INDICES:
            found = [r[index] for r in mine]
            whole = bool(found) and None not in found
            size = [max(0.0, v) if index == "energy_generated" else abs(v) for v in found if whole]
            row[f"{index}_worst"] = max(size) if whole else None
            row[f"{index}_p95"] = percentile_95(size) if whole else None
        board[track] = row
    return board
