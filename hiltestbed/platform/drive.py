"""A position controller that works against dry friction with a limited force, over a stretch of a
straight command.

    x'' = sat(w^2 (u - x + q), a_max) - 2 zeta w x' - w^2 r sgn(x') + w^2 o,    q' = (u - x)/T_i

All terms are divided by the moving mass. r is the Coulomb force and o the load, each over the
controller's gain, so that both are following errors [m]. At rest the axis holds while the sum of
drive force and load does not exceed the static friction.

The law is linear between the instants at which the axis stops, breaks loose, reverses, or reaches
or leaves its force limit. In between, the state is advanced by its Taylor series to round-off; the
instants themselves are found to round-off by root finding. The result therefore does not depend on
how finely a command is divided. Limitation: a stop is missed if the acceleration reverses twice
within a time constant, which requires an integral part that is faster than the axis.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hiltestbed.compiled.jit import njit
from hiltestbed.platform.parameters import FRICTION, INTEGRAL, LIMIT, OFFSET, STATIC, ZETA, W

PLACE, RATE, SUM = 0, 1, 2  # its state: x [m], x' [m/s], q [m]
STATE = 3

ORDER = 19  # of the series: a piece is at most one time constant long, and 1/20! is 4e-19
MAX_PIECES = 100_000  # per call: it ends with unphysical parameters as well
# quantities whose zeros are sought; SPEED and ERROR precede their rates
SPEED, ACCELERATION, ERROR, ERROR_RATE = 0, 1, 2, 3


class Stretch(NamedTuple):
    """An axis that does not reverse, from now on: the linear law that it follows (w^2, 2 zeta w,
    the constant force as a following error [m], 1/T_i, 1 if the controller's force is unlimited),
    its position, speed and integral, and its command u + rate t.
    """

    law: tuple[float, float, float, float, float]
    x: float
    v: float
    q: float
    u: float
    rate: float


@njit(cache=True)
def _slide(now, t):
    """Position, speed and integral of an axis after t."""
    stiffness, damping, push, integral, follows = now.law
    x, v, q = xk, vk, qk = now.x, now.v, now.q
    uk = now.u
    for k in range(ORDER):
        part = t / (k + 1.0)
        force = stiffness * (follows * (uk - xk + qk) + push) - damping * vk
        qk = part * integral * (uk - xk)
        xk = part * vk
        vk = part * force
        uk = now.rate * t if k == 0 else 0.0
        push = 0.0
        x += xk
        v += vk
        q += qk
    return x, v, q


@njit(cache=True)
def _of(what, now, level, state, t):
    """A quantity and its slope in the ``state`` (x, v, q) after t: speed, acceleration, the
    controller's error minus ``level``, or the rate of that error.
    """
    stiffness, damping, push, integral, follows = now.law
    x, v, q = state
    u, rate = now.u + now.rate * t, now.rate
    a = stiffness * (follows * (u - x + q) + push) - damping * v
    closing = rate - v + integral * (u - x)
    if what == SPEED:
        return v, a
    if what == ACCELERATION:
        return a, stiffness * follows * closing - damping * a
    if what == ERROR:
        return u - x + q - level, closing
    return closing, integral * (rate - v) - a


@njit(cache=True)
def _after(what, now, level, t):
    """A quantity and its slope, see :func:`_of`, after t."""
    return _of(what, now, level, _slide(now, t), t)


@njit(cache=True)
def _zero(what, now, level, low, high):
    """Zero of a quantity where its signs at ``low`` and ``high`` differ: Newton, or bisection."""
    rises = _after(what, now, level, high)[0] > 0.0
    t = 0.5 * (low + high)
    for _ in range(100):
        value, slope = _after(what, now, level, t)
        if (value > 0.0) == rises:
            high = t
        else:
            low = t
        last = t
        t = last - value / slope if slope != 0.0 else low
        if not low < t < high:
            t = 0.5 * (low + high)
        if abs(t - last) <= 1e-16 * high:
            break
    return t


@njit(cache=True)
def _falls(what, now, level, sign, starts, t, end):
    """Time within t at which ``sign`` times SPEED or ERROR first falls below zero, else infinite;
    its slope changes sign at most once.

    starts: whether it is zero now, up to round-off, and begins to grow. end: the state after t.
    """
    first, slope = _of(what, now, level, (now.x, now.v, now.q), 0.0)
    then, last = _of(what, now, level, end, t)
    first, slope, then, last = sign * first, sign * slope, sign * then, sign * last
    if first < 0.0 and slope > 0.0:
        starts = True
    if starts:
        if then >= 0.0:
            return math.inf
        top = _zero(what + 1, now, 0.0, 0.0, t)
        above = sign * _after(what, now, level, top)[0] > 0.0
        return _zero(what, now, level, top, t) if above else t
    if first < 0.0:
        return 0.0
    if then < 0.0:
        return _zero(what, now, level, 0.0, t)
    if slope < 0.0 < last:
        least = _zero(what + 1, now, 0.0, 0.0, t)
        if sign * _after(what, now, level, least)[0] < 0.0:
            return _zero(what, now, level, 0.0, least)
    return math.inf


@njit(cache=True)
def _passes(c0, c1, c2):
    """The first time t >= 0 at which c0 + c1 t + c2 t^2 becomes positive; infinite if never."""
    if c0 > 0.0 or (c0 == 0.0 and (c1 > 0.0 or (c1 == 0.0 and c2 > 0.0))):
        return 0.0
    inside = c1 * c1 - 4.0 * c2 * c0
    if inside < 0.0 or (c1 <= 0.0 and c2 <= 0.0):
        return math.inf
    if c1 > 0.0:
        return -2.0 * c0 / (c1 + math.sqrt(inside))
    return (math.sqrt(inside) - c1) / (2.0 * c2)


@njit(cache=True)
def _breaks_loose(numbers, x, q, u, rate, bound):
    """Time until an axis at rest moves, its direction; ``bound``: force limit as an error [m]."""
    hold, offset = numbers[FRICTION] * numbers[STATIC], numbers[OFFSET]
    integral = 1.0 / numbers[INTEGRAL]
    error, closing, bend = u - x + q, rate + integral * (u - x), 0.5 * integral * rate
    up = _passes(error - (hold - offset), closing, bend) if hold - offset < bound else math.inf
    down = _passes(-error - (hold + offset), -closing, -bend) if hold + offset < bound else math.inf
    if up <= down:
        return up, 1.0
    return down, -1.0


@njit(cache=True)
def drive_over(before, after, dt, numbers, state):
    """The position [m] of an axis after dt, for a command that runs linearly from ``before`` to
    ``after`` [m].

    numbers: (NUMBERS,) parameters of the drive. state: (STATE,), updated in place.
    """
    rate, w, integral = (after - before) / dt, numbers[W], 1.0 / numbers[INTEGRAL]
    zeta = numbers[ZETA]
    longest = 1.0 / (w * (zeta + math.sqrt(1.0 + zeta * zeta)) + integral)
    most = numbers[LIMIT] / (w * w)
    dry = numbers[FRICTION] > 0.0
    x, v, q = state[PLACE], state[RATE], state[SUM]
    side = math.copysign(1.0, v) if dry else 0.0
    bound = _bound(before - x + q, most)
    left, starts = dt, False
    for _ in range(MAX_PIECES):
        if not left > 0.0:
            break
        u = after - rate * left
        if dry and v == 0.0 and not starts:
            wait, side = _breaks_loose(numbers, x, q, u, rate, most)
            starts, wait = wait < left, min(wait, left)
            q += integral * wait * (u - x + 0.5 * rate * wait)
            left -= wait
            bound = _bound(u + rate * wait - x + q, most)
            continue
        push = numbers[OFFSET] - side * numbers[FRICTION]
        if bound != 0.0:
            push += bound * numbers[LIMIT] / (w * w)
        follows = 1.0 if bound == 0.0 else 0.0
        now = Stretch((w * w, 2.0 * zeta * w, push, integral, follows), x, v, q, u, rate)
        piece = min(longest, left)
        end = _slide(now, piece)
        stops = _falls(SPEED, now, 0.0, side, starts, piece, end) if dry else math.inf
        turned, then = math.inf, 0.0
        if most < math.inf and bound != 0.0:
            turned = _falls(ERROR, now, bound * most, bound, False, piece, end)
        elif most < math.inf:
            high = _falls(ERROR, now, most, -1.0, False, piece, end)
            low = _falls(ERROR, now, -most, 1.0, False, piece, end)
            turned, then = min(high, low), (1.0 if high < low else -1.0)
        event = min(stops, turned)
        if event < math.inf:
            piece = event
            end = _slide(now, piece)
        x, v, q = end
        left -= piece
        starts = starts and piece == 0.0
        if event < math.inf and stops <= turned:
            v, starts = 0.0, False
        elif event < math.inf:
            bound = then
    state[PLACE], state[RATE], state[SUM] = x, v, q
    return x


@njit(cache=True)
def _bound(error, most):
    """Whether the drive force is at its upper (1) or lower (-1) limit, or within both (0)."""
    return 1.0 if error > most else (-1.0 if error < -most else 0.0)
