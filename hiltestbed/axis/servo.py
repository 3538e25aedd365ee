"""The response of one servo axis to its command.

From the command to the position: a transport delay, a limit of the speed, a first-order pole, the
controller that moves a mass against dry friction and a load with a limited force, play, a scale and
an offset::

    x'' = sat(w^2 (r - x + q), limit) + 2 zeta w (ahead r' - x') - w^2 friction sgn(x') + w^2 load
    q' = (r - x)/integral_time

With all of them at their nominal values the position is the command. Between two rows the command
is linear.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compiled.jit import njit

(
    DELAY,  # [s]
    SPEED,  # [m/s] limit of the command's speed; infinite: none
    POLE,  # [s] time constant ahead of the controller
    SECOND_POLE,  # [s]
    BANDWIDTH,  # [rad/s] of the controller; 0: it follows exactly
    ZETA,
    AHEAD,  # share of the command's speed that the controller feeds forward
    FRICTION,  # [m]
    STATIC,  # [m] at rest, not below FRICTION
    LOAD,  # [m]
    ACCELERATION,  # [m/s^2] limit
    INTEGRAL,  # [s]
    PLAY,  # [m]
    STICK,  # [m]
    SCALE,
    OFFSET,  # [m]
    NUMBERS,
) = range(17)


def following() -> np.ndarray:
    """(NUMBERS,) of an axis that follows its command."""
    out = np.zeros(NUMBERS)
    out[[SPEED, ACCELERATION, INTEGRAL]] = np.inf
    out[SCALE], out[ZETA] = 1.0, 0.7
    return out


@njit(cache=True)
def response(t, u, y0, p, longest):
    """``(N,)`` positions at the times ``t`` of an axis under the command ``u`` (N,), linear between
    its rows and held beyond them, which stands at ``y0`` at first.

    The controller moves in steps of at most ``longest`` [s], each exact for a command that is
    linear over it and a friction of one sign; where the motion turns, it stops at the turn.
    """
    n = len(t)
    out = np.empty(n)
    w, zeta, most = p[BANDWIDTH], p[ZETA], p[ACCELERATION]
    s, square = zeta * w, w * w * (1.0 - zeta * zeta)
    root = math.sqrt(abs(square))
    gap = 0.5 * p[PLAY]
    # all that moves rests where the record begins
    x = (y0 - p[OFFSET]) / p[SCALE] if p[SCALE] != 0.0 else 0.0
    limited = first = second = played = stuck = x
    v = q = stepped = 0.0
    a = b = c = d = 0.0
    for k in range(n):
        dt = t[k] - t[k - 1] if k > 0 else 0.0
        pieces = max(1, int(math.ceil(dt / longest - 1e-9))) if k > 0 else 0
        h = dt / max(pieces, 1)
        if w > 0.0 and h > 0.0 and abs(h - stepped) > 1e-12:
            # what takes (z, z') of z'' + 2 zeta w z' + w^2 z = 0 over the step
            e, even, odd = math.exp(-s * h), 1.0, h
            if square > 0.0:
                even, odd = math.cos(root * h), math.sin(root * h) / root
            elif square < 0.0:
                even, odd = math.cosh(root * h), math.sinh(root * h) / root
            a, b, c, d = e * (even + s * odd), e * odd, -e * w * w * odd, e * (even - s * odd)
            stepped = h
        low = -1
        for i in range(pieces):
            at = t[k - 1] + (i + 1) * h - p[DELAY]
            if low < 0:
                low = max(np.searchsorted(t, at, side="right") - 1, 0)
            while low < n - 2 and t[low + 1] <= at:
                low += 1
            part = (at - t[low]) / (t[low + 1] - t[low]) if low < n - 1 else 0.0
            goal = u[low] + min(max(part, 0.0), 1.0) * (u[min(low + 1, n - 1)] - u[low])
            before = second
            limited += min(max(goal - limited, -p[SPEED] * h), p[SPEED] * h)
            first = (
                limited - (limited - first) * math.exp(-h / p[POLE]) if p[POLE] > 0.0 else limited
            )
            second = (
                first - (first - second) * math.exp(-h / p[SECOND_POLE])
                if p[SECOND_POLE] > 0.0
                else first
            )
            if w == 0.0:
                x = second
                continue
            slope = (second - before) / h
            level = p[FRICTION] if v != 0.0 else max(p[FRICTION], p[STATIC])
            pull = before - x + q + p[LOAD]
            if v == 0.0 and abs(second - x + q + p[LOAD]) <= level and abs(pull) <= level:
                if p[INTEGRAL] < np.inf:  # it goes on at rest, until it breaks the axis loose
                    q += h * (second - x) / p[INTEGRAL]
                continue
            way = math.copysign(1.0, v if v != 0.0 else second - x + q + p[LOAD])
            if abs(w * w * (0.5 * (before + second) - x + q)) > most:
                push = math.copysign(most, second - x + q) + w * w * (p[LOAD] - way * level)
                drag = 2.0 * zeta * w
                new = (v + h * (push + drag * p[AHEAD] * slope)) / (1.0 + h * drag)
                there = x + 0.5 * h * (v + new)
            else:
                # about the motion that follows the command at a constant distance
                aside = q + p[LOAD] - way * level - 2.0 * zeta * (1.0 - p[AHEAD]) / w * slope
                z, y = x - before - aside, v - slope
                there = second + aside + a * z + b * y
                new = slope + c * z + d * y
            if level > 0.0 and new * way < 0.0:
                # it turns within the step, and rests there
                part = v / (v - new) if v != new else 0.0
                x, v = x + 0.5 * part * h * v, 0.0
            else:
                x, v = there, new
            if p[INTEGRAL] < np.inf:
                q += h * (second - x) / p[INTEGRAL]
        played = min(max(played, x - gap), x + gap) if gap > 0.0 else x
        if p[STICK] > 0.0:
            if abs(played - stuck) > p[STICK]:
                stuck = played
        else:
            stuck = played
        out[k] = p[SCALE] * stuck + p[OFFSET]
    return out
