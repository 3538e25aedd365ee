"""The sets of the benchmark of diagnosis: hidden effects, rigs and noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hiltestbed.effects.table import EFFECTS
from tests.equipment.independent_rig import (
    NOISE_KINDS,
    SIZES,
    HiddenSet,
    Nuisances,
    acting_in,
    draw_nuisances,
    draw_set,
)

Computing = Literal["plain", "divided", "clocks"]

SEED, DOCKING_SEED, NOISE_SEED, COMPUTING_SEED = 400_000, 500_000, 600_000, 700_000
FULL = {"single": 82, "pair": 40, "healthy": 120, "foreign": 40, "triple": 20, "alike": 26}
QUICK = {"single": 8, "pair": 3, "healthy": 3, "foreign": 3}
DOCKING_FULL = {"single": 60, "pair": 20, "healthy": 60, "foreign": 20}
DOCKING_QUICK = {"single": 3, "pair": 1, "healthy": 2, "foreign": 1}
DOCKINGS = ("docking", "docking", "mounted", "held")  # cycled through
# sets of each kind of noise at each strength
NOISE_FULL, NOISE_QUICK = {"healthy": 60, "single": 10}, {"healthy": 1}
OF_COMPUTING = (  # effects that depend most on how a tick is divided and stamped
    "platform.friction",
    "platform.backlash",
    "platform.mode",
    "platform.lag",
    "frame.compliance",
    "sensor.delay",
)
WAYS: tuple[Computing, ...] = ("divided", "clocks")
# sets of each way of computing
COMPUTING_FULL, COMPUTING_QUICK = {"single": 60, "healthy": 20}, {"single": 2, "healthy": 1}
# fractions of the drawn size, to find the smallest detectable size
SMALLER = (0.3, 0.1, 0.03, 0.01)
UNSCALED = {"dynamics.integrator", "dynamics.step_delay"}  # effects without a size


@dataclass(frozen=True)
class Task:
    """One set to draw and diagnose.

    Attributes:
        kind, names, scale, design, noise: see :func:`~tests.equipment.independent_rig.draw_set`.
        computing: plain | divided (a tick with any number of sub-steps, the force at any lever) |
            clocks (divided, with instants and stamps offset as well).
    """

    seed: int
    kind: str
    names: tuple[str, ...] | None = None
    scale: float = 1.0
    design: str = "bumper"
    noise: tuple[str, float] | None = None
    computing: Computing = "plain"

    def draw(self) -> HiddenSet:
        """Draw the set, a :class:`~tests.equipment.independent_rig.HiddenSet`."""
        options: dict[str, Any] = {"names": self.names} if self.names else {}
        return draw_set(
            np.random.default_rng(self.seed),
            self.kind,  # type: ignore[arg-type]
            scale=self.scale,
            design=self.design,  # type: ignore[arg-type]
            noise=self.noise,  # type: ignore[arg-type]
            nuisances=self._nuisances(),
            **options,
        )

    def _nuisances(self) -> Nuisances | None:
        if self.computing == "plain":
            return None
        drawn = draw_nuisances(np.random.default_rng([self.seed, 1]))
        return (
            drawn
            if self.computing == "clocks"
            else replace(Nuisances(), substeps=drawn.substeps, lever=drawn.lever)
        )


def _each(counts: Mapping[str, int]) -> Iterator[tuple[str, int]]:
    """The kind of each set, and its number of this kind."""
    return ((kind, i) for kind, count in counts.items() for i in range(count))


def _cycled(kind: str, i: int, names: Sequence[str], stride: int = 7) -> tuple[str] | None:
    """The effect of single number ``i``: they cycle through ``names``."""
    return (names[(i * stride) % len(names)],) if kind == "single" else None


def tasks(counts: Mapping[str, int], ladder: bool) -> list[Task]:
    """The sets of a bumper; with ``ladder`` also each effect at decreasing sizes."""
    ids = [name for name in EFFECTS if name in SIZES]  # learned laws are not drawn
    out = [Task(SEED + n, kind, _cycled(kind, i, ids)) for n, (kind, i) in enumerate(_each(counts))]
    if ladder:
        out += [
            Task(SEED + 5000 + i, "single", (name,), scale)
            for scale in SMALLER
            for i, name in enumerate(ids)
            if name not in UNSCALED
        ]
    return out


def docking_tasks(counts: Mapping[str, int]) -> list[Task]:
    """The docking sets; singles are effects that act in their design."""
    out: list[Task] = []
    for n, (kind, i) in enumerate(_each(counts)):
        design = DOCKINGS[i % len(DOCKINGS)]
        names = _cycled(kind, i, acting_in(design))  # type: ignore[arg-type]
        out.append(Task(DOCKING_SEED + n, kind, names, design=design))
    return out


def noise_tasks(counts: Mapping[str, int]) -> list[Task]:
    """Sets of a bumper with every kind of noise at each of its strengths."""
    noises = [(name, strength) for name, kind in NOISE_KINDS.items() for strength in kind.strengths]
    each = [
        (kind, noise) for kind, count in counts.items() for noise in noises for _ in range(count)
    ]
    return [Task(NOISE_SEED + i, kind, noise=noise) for i, (kind, noise) in enumerate(each)]


def computing_tasks(counts: Mapping[str, int]) -> list[Task]:
    """Sets of a bumper whose facility divides, samples and stamps its ticks in other ways."""
    each: list[tuple[Computing, str, int]] = [
        (way, kind, i) for way in WAYS for kind, i in _each(counts)
    ]
    return [
        Task(COMPUTING_SEED + n, kind, _cycled(kind, i, OF_COMPUTING, 1), computing=way)
        for n, (way, kind, i) in enumerate(each)
    ]


def plan(quick: bool, parts: Sequence[str] = ()) -> list[Task]:
    """The sets of the ``parts`` (docking, noise, computing), by default of bumper and dockings."""
    out = [] if parts else tasks(QUICK if quick else FULL, not quick)
    if not parts or "docking" in parts:
        out += docking_tasks(DOCKING_QUICK if quick else DOCKING_FULL)
    if "noise" in parts:
        out += noise_tasks(NOISE_QUICK if quick else NOISE_FULL)
    if "computing" in parts:
        out += computing_tasks(COMPUTING_QUICK if quick else COMPUTING_FULL)
    return out
