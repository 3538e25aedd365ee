"""Parameters of a rig, and of a platform's response from command to pose.

A linear response is described by its response to a step: a piecewise-linear curve over the time
since the step.

The response to a command u is s_0 u(t - t_0) + sum_i m_i (U(t - t_i) - U(t - t_(i+1))), U the
integral of u over time, m_i the slope of the curve from its knot i to the next: no sum over the
past, and exact for a command that is linear over each tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.config.piecewise import packed
from hiltestbed.effects.base import LinkParameters
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.contact.composition import Structure
    from hiltestbed.contact.parameters import MechanismParameters
    from hiltestbed.platform.facilities.facility import Facility, Runs

# parameters of a drive: [rad/s], -, m, m, m/s^2, s, -
W, ZETA, FRICTION, OFFSET, LIMIT, INTEGRAL, STATIC = range(7)
NUMBERS = 7


@dataclass
class PlatformParameters(LinkParameters):
    """One platform at a tick of ``tick`` [s]; the default of each parameter has no effect.

    Attributes:
        delay: [s]. speed: limit [m/s]. play, stick: [m]. scale: (3,) factor on x, y, z.
        lag: natural frequency [rad/s] and damping ratio of each second-order response.
        mode: natural frequency [rad/s] and damping ratio of each structural mode that is excited at
            its base.
        drive: (3, NUMBERS) of a controller against dry friction on x, y, z, see
            :mod:`hiltestbed.platform.drive`; 0 for none.
        instants: number of instants per tick at which a sticking platform may move; 0: the physics
            steps. phase: by which they come before even parts of the tick, as a share of the time
            between two.
        begun: share of the approach's rate at which lags and modes start, see
            :func:`hiltestbed.platform.effects.response.stepped`.
        step: response to a step of the command, packed, see
            :func:`hiltestbed.config.piecewise.packed`;
            without knots: the step itself.
    """

    link = "platform"
    tick: float
    delay: float = 0.0
    speed: float = np.inf
    play: float = 0.0
    stick: float = 0.0
    scale: Array = field(default_factory=lambda: np.ones(3))
    lag: list[tuple[float, float]] = field(default_factory=list)
    mode: list[tuple[float, float]] = field(default_factory=list)
    drive: Array = field(default_factory=lambda: np.zeros((3, NUMBERS)))
    instants: int = 0
    phase: float = 0.0
    begun: float = 1.0
    step: Array = field(default_factory=lambda: packed(()))


class RigParameters(NamedTuple):
    """What `n` rigs of one structure are made of.

    Attributes:
        facility: the platform, with the vehicles if they move freely. structure: of the sides on
            it. runs: rates, and settings of each platform. mechanism: numbers of each mechanism.
        responses: of each platform, effects included; departs: whether any effect acts on one.
        start: (n, 13) pose of A in P and relative twist in P at t = 0.
        watched: (n, 5) which limits of the drives (stroke, speed, acceleration, force, reach) end a
            run; None: no limit is the facility's.
        upper: tracking of the upper platform, "servo" or "ideal"; None: the passive side is fixed.
    """

    facility: Facility
    structure: Structure
    runs: Runs
    mechanism: MechanismParameters
    responses: Sequence[PlatformParameters]
    departs: bool
    start: Array
    watched: NDArray[np.bool_] | None = None
    upper: str | None = None


class ResponseParameters(NamedTuple):
    """Parameters of n platforms as kernel inputs: delay, speed, play, stick, begun (n,), scale (n,
    3), drive (n, 3, NUMBERS), step (n, PACKED), lag and mode (n, S, 2), a frequency of 0 meaning
    none.
    """

    delay: Array
    speed: Array
    play: Array
    stick: Array
    scale: Array
    drive: Array
    step: Array
    begun: Array
    lag: Array
    mode: Array


def stack(platforms: Sequence[PlatformParameters]) -> ResponseParameters:
    """Parameters of several platforms as arrays with the run as leading axis."""

    def filled(rows: list[list[tuple[float, float]]]) -> Array:
        longest = max(len(r) for r in rows)
        padded = [[*r, *[(0.0, 1.0)] * (longest - len(r))] for r in rows]
        return np.array(padded, dtype=float).reshape(len(rows), longest, 2)

    rows = {name: [getattr(p, name) for p in platforms] for name in ResponseParameters._fields}
    responses = {name: filled(rows.pop(name)) for name in ("lag", "mode")}
    alone = {name: np.array(values, dtype=float) for name, values in rows.items()}
    return ResponseParameters(**alone, **responses)


def knots(step: Array) -> tuple[Array, Array]:
    """``(K,)`` times [s] and values of a packed curve."""
    n, most = int(step[0]), (len(step) - 1) // 2
    return step[1 : 1 + n], step[1 + most : 1 + most + n]


def longest_memory(steps: Array) -> float:
    """Time [s] after which all packed curves (n, PACKED) are constant."""
    return max((float(knots(s)[0][-1]) for s in steps if s[0] > 0), default=0.0)


def mean_lateness(step: Array) -> float:
    """Steady lag [s] behind a uniform motion: the area above the curve over its last value."""
    times, values = knots(step)
    if not len(times) or values[-1] == 0.0:
        return 0.0
    return float(times[0] + np.trapezoid(values[-1] - values, times) / values[-1])


def summed_over(step: Array, start: Array, velocity: Array) -> tuple[Array, Array]:
    """Response and its rate (3,) to a uniform motion at ``start`` (3,) with ``velocity`` (3,)."""
    values = knots(step)[1]
    if not len(values):
        return start, velocity
    return values[-1] * (start - velocity * mean_lateness(step)), values[-1] * velocity
