"""Parameters of a numerical model: how the model that runs departs from the nominal one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.effects.base import LinkParameters
from hiltestbed.frames import Array
from hiltestbed.numerical_model.resistance import RESISTANCE

BODIES = ("chaser", "target")
RESISTED = (*BODIES, "both")  # what a resisting force acts on; the index is its BODY column
# columns of an appendage: mass ratio, k/m_a [1/s^2], d/m_a [1/s], place [m]
RATIO, STIFFNESS, DAMPING, PLACE, APPENDAGE = 0, 1, 2, 3, 6
Appendage = tuple[float, ...]  # those columns


@dataclass
class DynamicsParameters(LinkParameters):
    """Departures of one numerical model.

    Attributes:
        mass, inertia: (2,) factors on chaser and target. port: (2, 3) offset of the port in body
            axes [m].
        appendages: of chaser and of target, each (mass ratio, k/m_a [1/s^2], d/m_a [1/s], place in
            body axes [m]).
        forces: that resist motion, each a row of :mod:`hiltestbed.numerical_model.resistance`.
        late: delay of the pose in whole ticks. explicit: explicit Euler, the pose with the old
            twist.
    """

    link = "dynamics"
    mass: Array = field(default_factory=lambda: np.ones(2))
    inertia: Array = field(default_factory=lambda: np.ones(2))
    port: Array = field(default_factory=lambda: np.zeros((2, 3)))
    appendages: tuple[list[Appendage], list[Appendage]] = field(default_factory=lambda: ([], []))
    forces: list[tuple[float, ...]] = field(default_factory=list)
    late: int = 0
    explicit: bool = False


@dataclass(frozen=True)
class Departures:
    """The departures of n models.

    Attributes:
        mass, inertia: (n, 2). port: (n, 2, 3). appendage: (n, 2, S, APPENDAGE). force: (n, F,
            RESISTANCE). late, explicit: (n,).
    """

    mass: Array
    inertia: Array
    port: Array
    appendage: Array
    force: Array
    late: np.ndarray
    explicit: np.ndarray


def stack(models: Sequence[DynamicsParameters]) -> Departures:
    """Several models as arrays with the run as leading axis."""
    most = max(len(part) for m in models for part in m.appendages)
    none = (0.0,) * APPENDAGE
    swinging = [[[*part, *[none] * (most - len(part))] for part in m.appendages] for m in models]
    resisted = max(len(m.forces) for m in models)
    forces = np.full((len(models), resisted, RESISTANCE), -1.0)  # unused rows act on no body
    for row, m in zip(forces, models, strict=True):
        for slot, law in zip(row, m.forces, strict=False):
            slot[:] = law
    return Departures(
        mass=np.array([m.mass for m in models]),
        inertia=np.array([m.inertia for m in models]),
        port=np.array([m.port for m in models]),
        appendage=np.array(swinging, dtype=float).reshape(len(models), 2, most, APPENDAGE),
        force=forces,
        late=np.array([m.late for m in models], dtype=np.int64),
        explicit=np.array([m.explicit for m in models], dtype=bool),
    )
