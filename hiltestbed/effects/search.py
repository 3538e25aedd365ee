"""Hypotheses of a diagnosis: an effect with the parameters to fit, their bounds, and where to start.

Fits of effects are rough (jumps at whole ticks, clipped and dead ranges, several minima), so each candidate brings a grid of starts,
scaled by what the data hold: peak force, penetration, rate.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.effects.base import Effect


@dataclass(frozen=True)
class DrivenAxis:
    """What a regression of the force on the motion says of an axis that a force drives, to start a search from.

    Attributes:
        factor: of the chaser's mass. viscous: [N s/m]. coulomb, offset: [N]. fastest: speed on record [m/s].
        stamp: [s] by which the position is read later than the numerical model hands it on; stamps: [s] to each side, that are searched.
    """

    factor: float
    viscous: float
    coulomb: float
    offset: float
    fastest: float
    stamp: float
    stamps: float


@dataclass(frozen=True)
class Scales:
    """What the data hold, to scale starts and bounds with.

    Attributes:
        force: peak force [N]. depth: largest penetration [m]. stiffness: believed [N/m]. tick: of the loop [s].
        noise: of a force axis [N]. slow, fast: lowest and highest approach speed [m/s]. duration: of the shortest run [s].
        reading: the highest peaks of the force [N]. travel: the largest that was commanded [m]. substeps: of the believed physics a tick.
        captured: whether the mechanism holds. slides: whether the tip moves across the surface.
        lines: force axis to frequency [Hz], amplitude [N] and phase [rad] of the strongest spectral line of the residual.
        sticks: instants a tick to starts for stiction of the platform [m], where the data show any.
        late: a delay of the force record [s] that another link has told to a tick, or None.
        driven: an axis that a force drives, with position and force on record and nothing else, or None.
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
    lines: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    sticks: Mapping[int, Sequence[float]] = field(default_factory=dict)
    late: float | None = None
    driven: DrivenAxis | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect with its free parameters.

    Attributes:
        effect: its class. names: free parameters, "force.0" for an item of a list. low, high: bounds. log: which are searched by ratio.
        grid: starts. fixed: parameters that are chosen, not fitted.
        variant: a reading of the equation where its words leave more than one, or how a facility computes it; name to value, read by
            :meth:`Effect.apply` from ``effect.variant``.
        choices: number of siblings that differ in what is fixed: a search among them costs 2 ln(choices).
    """

    effect: type[Effect]
    names: tuple[str, ...]
    low: Array
    high: Array
    log: np.ndarray
    grid: tuple[tuple[float, ...], ...]
    fixed: Mapping[str, Any] = field(default_factory=dict)
    variant: Mapping[str, Any] = field(default_factory=dict)
    choices: int = 1

    @property
    def kind(self) -> str:
        """The id of the effect."""
        return str(self.effect.model_fields["kind"].default)

    @property
    def vector(self) -> bool:
        """Whether the parameters are the components of a vector, whose direction no grid covers."""
        return any("." in name for name in self.names)

    @property
    def key(self) -> tuple:
        """What tells candidates apart."""
        return (self.kind, *self.names, *sorted((k, str(v)) for k, v in {**self.fixed, **self.variant}.items()))

    def held(self, index: int, value: float) -> Candidate:
        """The same effect with one of its free parameters, a number, held at ``value``."""
        rest = np.delete(np.arange(len(self.names)), index)
        names = tuple(self.names[i] for i in rest)
        grid = tuple(tuple(start[i] for i in rest) for start in self.grid)
        where = "fixed" if self.names[index] in self.effect.model_fields else "variant"
        told = {where: {**getattr(self, where), self.names[index]: value}}
        return replace(self, names=names, low=self.low[rest], high=self.high[rest], log=self.log[rest], grid=grid, **told)

    def at(self, theta: Array) -> Effect:
        """The effect with the free parameters at theta, unchecked: a search may leave what a scenario allows."""
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
    effect: type[Effect],
    grids: Mapping[str, Sequence[float]],
    *,
    starts: Sequence[Sequence[float]] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    variant: Mapping[str, Any] | None = None,
    choices: int = 1,
    **fixed: Any,
) -> Candidate:
    """A candidate whose starts are all combinations of ``grids`` (or ``starts``), within ``bounds`` or the effect's own search range.

    A name in ``grids`` that is no field of the effect is a free part of the variant; its bounds must be given.
    """
    low, high, log = [], [], []
    for name in grids:
        key = name.partition(".")[0]
        if bounds and name in bounds:
            ratio = effect.searched(key)[2] if key in effect.model_fields else False
            ends = bounds[name]
        else:
            *ends, ratio = effect.searched(key)
        low.append(ends[0])
        high.append(ends[1])
        log.append(bool(ratio) and ends[0] > 0)
    grid = tuple(tuple(map(float, s)) for s in (starts or itertools.product(*grids.values())))
    return Candidate(
        effect, tuple(grids), np.array(low, float), np.array(high, float), np.array(log, bool), grid, fixed, variant or {}, choices
    )
