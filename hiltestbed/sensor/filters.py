"""First-order filters of an analogue signal that is known at instants a step apart and is linear
between them.

From y' = (u - y)/T, with a = exp(-h/T) and b = (1 - a) T/h, the response to u(t) = u_0 + (u_1 -
u_0) t/h at the end of the step is y_1 = a y_0 + (b - a) u_0 + (1 - b) u_1. It is exact, so that a
ramp comes out later by T whatever the step is; held over the step, the signal would come out later
by only h/(exp(h/T) - 1). The high-pass s T/(1 + s T) is the signal minus its low-pass: z_1 = a z_0
+ b (u_1 - u_0).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array


def low_pass(time_constant: ArrayLike, step: float) -> Array:
    """``(..., 2)`` weights per step [s] of the signal at its end, 1 - b, and at its start, b - a;
    time constant [s], 0: none.
    """
    a, b = _decay(time_constant, step)
    return np.stack([1.0 - b, b - a], axis=-1)


def high_pass(time_constant: ArrayLike, step: float) -> Array:
    """``(..., 2)`` factors per step [s] of the output, a, and of the signal's change, b; time
    constant [s], infinite: none.
    """
    return np.stack(_decay(time_constant, step), axis=-1)


def _decay(time_constant: ArrayLike, step: float) -> tuple[Array, Array]:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = step / np.asarray(time_constant, dtype=float)
        mean = np.where(ratio > 0.0, -np.expm1(-ratio) / ratio, 1.0)
    return np.exp(-ratio), mean


@njit(cache=True)
def lagged(y, u, before, weights):
    """The low-passed signal at the end of a step: ``y`` at its start, the signal ``before`` and
    ``u`` at its start and end.
    """
    return y + ((u - y) * weights[0] + (before - y) * weights[1])


@njit(cache=True)
def leaked(z, u, before, factors):
    """The high-passed signal at the end of a step, as in :func:`lagged`."""
    return factors[0] * z + factors[1] * (u - before)


FILTERED = 3  # numbers that :func:`filtered` remembers: low-passed value, its input, high-passed


@njit(cache=True)
def filtered(u, low, high, memory):
    """A signal ``u`` at the end of a step through a low-pass, with weights ``low``, and then a
    high-pass, with factors ``high``; ``memory`` (FILTERED,) is changed in place.
    """
    before = memory[0]
    memory[0] = lagged(before, u, memory[1], low)
    memory[1] = u
    if high[0] < 1.0:
        memory[2] = leaked(memory[2], memory[0], before, high)
        return memory[2]
    return memory[0]
