"""The numbers of a numerical model: what is believed of both vehicles, and how the model that runs departs from it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array

BODIES = ("chaser", "target")
RATIO, STIFFNESS, DAMPING, PLACE, APPENDAGE = 0, 1, 2, 3, 6  # columns of an appendage: mass ratio, k/m_a [1/s^2], d/m_a [1/s], place [m]
Appendage = tuple[float, ...]  # those columns


@dataclass
class DynamicsParameters:
    """Departures of one numerical model.

    Attributes:
        mass, inertia: (2,) factors on chaser and target. port: (2, 3) offset of the port in body axes [m].
        appendages: of chaser and of target, each (mass ratio, k/m_a [1/s^2], d/m_a [1/s], place in body axes [m]).
        late: whole ticks. explicit: pose with the old twist.
    """

    mass: Array = field(default_factory=lambda: np.ones(2))
    inertia: Array = field(default_factory=lambda: np.ones(2))
    port: Array = field(default_factory=lambda: np.zeros((2, 3)))
    appendages: tuple[list[Appendage], list[Appendage]] = field(default_factory=lambda: ([], []))
    late: int = 0
    explicit: bool = False

    @classmethod
    def of(cls, effects: Iterable[Effect]) -> DynamicsParameters:
        """What the effects of the numerical model among ``effects`` make of it."""
        p = cls()
        for effect in effects:
            if effect.link == "dynamics":
                effect.apply(p)
        return p


@dataclass(frozen=True)
class Departures:
    """The departures of n models: mass, inertia (n, 2), port (n, 2, 3), appendage (n, 2, S, APPENDAGE), late and explicit (n,)."""

    mass: Array
    inertia: Array
    port: Array
    appendage: Array
    late: np.ndarray
    explicit: np.ndarray

    @property
    def any(self) -> bool:
        """Whether any model departs at all."""
        same = np.all(self.mass == 1.0) and np.all(self.inertia == 1.0) and not self.port.any()
        return not (same and not self.appendage.any() and not self.late.any() and not self.explicit.any())


def stack(models: Sequence[DynamicsParameters]) -> Departures:
    """Several models as arrays with the run as leading axis."""
    most = max(len(part) for m in models for part in m.appendages)
    none = (0.0,) * APPENDAGE
    swinging = [[[*part, *[none] * (most - len(part))] for part in m.appendages] for m in models]
    return Departures(
        mass=np.array([m.mass for m in models]),
        inertia=np.array([m.inertia for m in models]),
        port=np.array([m.port for m in models]),
        appendage=np.array(swinging, dtype=float).reshape(len(models), 2, most, APPENDAGE),
        late=np.array([m.late for m in models], dtype=np.int64),
        explicit=np.array([m.explicit for m in models], dtype=bool),
    )
