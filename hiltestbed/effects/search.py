"""Hypotheses of a diagnosis: an effect with the parameters to fit, their bounds and starting
points.

The fit of an effect may be discontinuous at whole ticks, have flat ranges (clipping, dead zone) and
several minima, so each candidate brings a grid of starting points, scaled to the data: peak force,
penetration, rate.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hiltestbed.effects.departure import Departure
from hiltestbed.frames import Array

# [s], ticks: the larger bounds the search for a delay of the reading
LONGEST_DELAY, LONGEST_TICKS = 0.03, 20.0
# ticks: so dense because F(delay) jumps at whole ticks
DELAYS = (0.4, 0.8, 1.4, 2.5, 4.5, 8.0, 13.0, 20.0)


@dataclass(frozen=True)
class Scales:
    """Magnitudes in the data that scale starting points and bounds.

    Attributes:
        force: peak force [N]. depth: largest penetration [m]. stiffness: nominal [N/m]. tick: of
            the loop [s].
        noise: of a force axis [N]. slow, fast: lowest and highest approach speed [m/s]. duration:
            of the shortest run [s].
        reading: the highest force peaks [N]. travel: largest commanded travel [m]. substeps:
            nominal physics steps per tick.
        captured: whether the mechanism is captured. slides: whether the tip moves across the
            surface.
        sticks: instants per tick at which a platform may move, and their phase, see
            `PlatformParameters`, to starting values for its stiction [m], where the data show any.
        jumps: whether the mechanism moves in jumps, as on a platform that sticks.
    """

    force: float
    depth: float
    stiffness: float
    tick: float
    noise: float
    slow: float
    fast: float
    duration: float = 1.0
    reading: tuple[float, ...] = ()
    travel: float = 0.0
    substeps: int = 1
    captured: bool = False
    slides: bool = True
    sticks: Mapping[tuple[int, float], Sequence[float]] = field(default_factory=dict)
    jumps: bool = False

    @property
    def longest_delay(self) -> float:
        """[s] upper bound of the search for a delay of the reading."""
        return max(LONGEST_DELAY, LONGEST_TICKS * self.tick)

    @property
    def delays(self) -> list[float]:
        """[s] starting values of a delay of the reading; of what jumps, each tick: a delay that is
        a tick off fits no better than none.
        """
        if self.jumps:
            return [(n + DELAYS[0]) * self.tick for n in range(int(self.longest_delay / self.tick))]
        return [ticks * self.tick for ticks in DELAYS]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect with its free parameters.

    Attributes:
        effect: its class. names: free parameters, "force.0" for an item of a list. low, high:
            bounds.
        log: which are searched logarithmically. grid: starting points. fixed: parameters that are
            chosen, not fitted.
        variant: an interpretation of the equation where it is ambiguous, or how a facility computes
            it; name to value, read by :meth:`Effect.apply` from ``effect.variant``.
        choices: number of candidates that differ only in ``fixed``: choosing among them costs 2
            ln(choices) in chi-square.
        needs: parameters, as "kind:name", without which this one means nothing: it is a part of an
            effect to which they belong.
        linear: the parameter with which, the others given, the change of the prediction only grows,
            or "".
    """

    effect: type[Departure]
    names: tuple[str, ...]
    low: Array
    high: Array
    log: np.ndarray
    grid: tuple[tuple[float, ...], ...]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    variant: Mapping[str, Any] = field(default_factory=dict)
    choices: int = 1
    needs: tuple[str, ...] = ()
    linear: str = ""

    @property
    def kind(self) -> str:
        return str(self.effect.model_fields["kind"].default)

    @property
    def vector(self) -> bool:
        """Whether they are components of a vector, whose directions no grid covers."""
        return any("." in name for name in self.names)

    @property
    def place(self) -> tuple[str, ...]:
        return tuple(
            f"{name}={value}"
            for name, value in sorted(self.fixed.items())
            if isinstance(value, str)
        )

    def unit(self, name: str) -> str:
        """The unit of one of :attr:`names`; of one of the variant, which is a delay, seconds."""
        key = name.partition(".")[0]
        return self.effect.unit(key) if key in self.effect.model_fields else "s"

    @property
    def key(self) -> tuple:
        """Identifies the candidate: kind, free parameters, fixed values and variant."""
        return (
            self.kind,
            *self.names,
            *sorted((k, str(v)) for k, v in {**self.fixed, **self.variant}.items()),
        )

    def shapes(self) -> list[tuple[float, ...]]:
        """Starts that differ in more than the ``linear`` parameter, with the middle one of its
        values.
        """
        groups: dict[tuple[float, ...], list[tuple[float, ...]]] = {}
        for start in self.grid:
            groups.setdefault(self._shape(start), []).append(start)
        return [sorted(group)[len(group) // 2] for group in groups.values()]

    def of_shape(self, start: tuple[float, ...]) -> list[tuple[float, ...]]:
        """Starting points that differ from ``start`` in the ``linear`` parameter alone, and it."""
        return [other for other in self.grid if self._shape(other) == self._shape(start)]

    def _shape(self, start: tuple[float, ...]) -> tuple[float, ...]:
        pairs = zip(self.names, start, strict=True)
        return tuple(value for name, value in pairs if name != self.linear)

    def at(self, theta: Array) -> Any:
        """The effect with the free parameters at theta, unchecked."""
        values: dict[str, Any] = dict(self.fixed)
        variant = dict(self.variant)
        for name, value in zip(self.names, theta, strict=True):
            key, _, item = name.partition(".")
            if key not in self.effect.model_fields:
                variant[key] = float(value)
            elif item:
                values.setdefault(key, {})[int(item)] = float(value)
            else:
                values[key] = float(value)
        for key, value in values.items():
            if isinstance(value, dict):
                values[key] = tuple(value.get(i, 0.0) for i in range(1 + max(value)))
        return self.effect.hypothesis(variant, **values)


def candidate(
    effect: type[Departure],
    grids: Mapping[str, Sequence[float]],
    *,
    starts: Sequence[Sequence[float]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    variant: Mapping[str, Any] | None = None,
    choices: int = 1,
    needs: tuple[str, ...] = (),
    linear: str = "",
    **fixed: Any,
) -> Candidate:
    """A candidate that starts from all combinations of ``grids`` (or from ``starts``), within
    ``bounds`` or the effect's search range.

    A name in ``grids`` that is not a field of the effect is a free parameter of the variant; its
    bounds must be given.
    """
    low, high, log = [], [], []
    for name in grids:
        key = name.partition(".")[0]
        if bounds and name in bounds:
            ratio = effect.by_ratio(key) if key in effect.model_fields else False
            ends = bounds[name]
        else:
            *ends, ratio = effect.searched(key)
        low.append(ends[0])
        high.append(ends[1])
        log.append(bool(ratio) and ends[0] > 0)
    grid = tuple(tuple(map(float, s)) for s in (starts or itertools.product(*grids.values())))
    return Candidate(
        effect,
        tuple(grids),
        np.array(low, float),
        np.array(high, float),
        np.array(log, bool),
        grid,
        fixed,
        variant or {},
        choices,
        needs,
        linear,
    )
