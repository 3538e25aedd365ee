"""A linear response described by its step response: a piecewise-linear curve over the time since
the step.

The response to a command u is s_0 u(t - t_0) + sum_i m_i (U(t - t_i) - U(t - t_(i+1))), U the
integral of u over time, m_i the slope of
the curve from its knot i to the next: no sum over the past, and exact for a command that is linear
over each tick.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.frames import Array


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
