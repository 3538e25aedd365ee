"""The models that an engineer writes in an afternoon: simulated with a plain loop, fitted by
`scipy.optimize`.

They share no code with the rest of the package, because they are what its results are compared
with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numba
import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from hiltestbed.bench.real.device import Array, AxisRecord, Predictor


def fitted(
    model: Callable[[Array, AxisRecord], Array],
    records: Sequence[AxisRecord],
    start: Sequence[float] | Array,
    bounds: tuple[Sequence[float] | float, Sequence[float] | float] = (-np.inf, np.inf),
) -> Array:
    """Parameters with the least squared error of `model` over all records, each record's error in
    multiples of its own spread.

    `start` and `bounds` are in the parameters' units.
    """
    scales = [np.std(r.y) * np.sqrt(r.y.size) for r in records]

    def residual(p: Array) -> Array:
        errors = [(model(p, r) - r.y) / s for r, s in zip(records, scales, strict=True)]
        return np.nan_to_num(np.concatenate(errors), nan=1e3, posinf=1e3, neginf=-1e3)

    options = {"bounds": bounds, "x_scale": "jac", "diff_step": 1e-4, "max_nfev": 60}
    return least_squares(residual, np.asarray(start, float), **options).x


def best_of(
    model: Callable[[Array, AxisRecord], Array],
    records: Sequence[AxisRecord],
    starts: Sequence[Sequence[float] | Array],
    bounds: tuple[Sequence[float], Sequence[float]] | None = None,
    also: Sequence[Array] = (),
) -> Predictor:
    """The model as :func:`fitted` from each of several `starts`, and with the parameters `also`:
    that with the smallest error over all records, each in multiples of its spread.
    """
    limits = bounds or (-np.inf, np.inf)

    def error(p: Array) -> float:
        return float(sum(np.mean((model(p, r) - r.y) ** 2) / np.var(r.y) for r in records))

    p = min([*also, *(fitted(model, records, start, limits) for start in starts)], key=error)
    return lambda record: model(p, record)


def derivatives(record: AxisRecord, window: float, column: str = "y") -> tuple[Array, Array]:
    """First and second derivative of a column, by a cubic over a window [s] of even rows."""
    period = float(np.median(np.diff(record.t)))
    length = max(5, 2 * int(window / period / 2) + 1)
    values = getattr(record, column)
    first = np.asarray(savgol_filter(values, length, 3, deriv=1, delta=period), dtype=float)
    second = np.asarray(savgol_filter(values, length, 3, deriv=2, delta=period), dtype=float)
    return first, second


@numba.njit(cache=True)
def _drive(p: Array, t: Array, u: Array, start: float, speed: float) -> Array:
    gain, viscous, forwards, backwards, spring = p
    y = np.empty(t.size)
    q, v = start, speed
    for i in range(t.size):
        y[i] = q
        if i + 1 < t.size:
            dt = t[i + 1] - t[i]
            w = v + dt * (gain * u[i] - viscous * v - spring * q)
            v = max(0.0, w - dt * forwards) if w > 0 else min(0.0, w + dt * backwards)
            q += dt * v
    return y


def drive(
    p: Array | Sequence[float], record: AxisRecord, window: float, spring: float = 0.0
) -> Array:
    """Position of q'' = a u - b q' - c sign q' - ``spring`` q, all per inertia, from the input
    alone.

    `p` = (a, b, c forwards, c backwards). It starts at the recorded position with the slope of the
    first `window` seconds; 0 without rows. At rest, dry friction holds what does not exceed it.
    """
    rows, speed = record.t - record.t[0] <= window, 0.0
    if np.count_nonzero(rows) > 1:
        speed = float(np.polyfit(record.t[rows] - record.t[0], record.y[rows], 1)[0])
    return _drive(np.append(p, spring), record.t, record.u, record.y[0], speed)


def drive_regression(records: Sequence[AxisRecord], window: float, slow: float) -> Array:
    """The parameters of `drive` by linear least squares (inverse dynamics, rows faster than
    `slow`).

    q'' + b q' + c sign q' + offset = a u, with the derivatives of
    `derivatives`. Source: Janot, Gautier, Brunot 2019, data set and reference models of EMPS.
    """
    blocks, targets = [], []
    for r in records:
        v, a = derivatives(r, window)
        columns = [a, v, np.sign(v), np.ones_like(v)]
        moving = np.abs(v) > slow
        blocks.append(np.column_stack(columns)[moving])
        targets.append(r.u[moving])
    solution = np.linalg.lstsq(np.vstack(blocks), np.concatenate(targets), rcond=None)[0]
    mass, viscous, dry, offset = solution
    return np.array([1.0, viscous, dry + offset, dry - offset]) / mass


@numba.njit(cache=True)
def _servo(p: Array, t: Array, u: Array, start: float, steps: int) -> Array:
    omega, damping, delay, play, limit, offset, gain = p
    y = np.empty(t.size)
    x, v = start - offset, 0.0
    reached = x
    j = 0
    for i in range(t.size):
        y[i] = reached + offset
        if i + 1 == t.size:
            break
        dt = (t[i + 1] - t[i]) / steps
        for k in range(steps):
            now = t[i] + k * dt - delay
            while j + 1 < t.size and t[j + 1] <= now:
                j += 1
            a = omega * omega * (gain * u[j] - x) - 2 * damping * omega * v
            v = min(limit, max(-limit, v + dt * a))
            x += dt * v
            reached = min(x + play / 2, max(x - play / 2, reached))
    return y


def servo(p: Array, record: AxisRecord, steps: int = 10) -> Array:
    """Position reached: the command, held between rows, delayed, through a second order with a
    limited speed and a play.

    `p` = (natural frequency [rad/s], damping ratio, delay [s], width of the play, greatest
    speed, offset, gain).
    """
    p = np.asarray(p, float).copy()
    p[0] = abs(p[0])
    return _servo(p, record.t, record.u, record.y[0], steps)


@numba.njit(cache=True)
def _slider(p: Array, start: float, u: Array) -> Array:
    stiffness, pull, push, play = p
    force = np.empty(u.size)
    s = start
    for i in range(u.size):
        if i:
            s += u[i] - u[i - 1]
            s = min(pull / stiffness + play / 2, max(-push / stiffness - play / 2, s))
        force[i] = stiffness * (min(s + play / 2, 0.0) + max(s - play / 2, 0.0))
    return force


def slider(p: Array, u: Array, first: float = 0.0) -> Array:
    """Force of a spring that slips at a limit and turns through a play without force.

    `p` = (stiffness, limit of the pull, limit of the push, width of the play). The deflection at
    the first row follows from the `first` force; without force it is the middle of the play.
    """
    p = np.abs(np.asarray(p, dtype=float))
    held = float(np.clip(first, -p[2], p[1])) / p[0] + np.sign(first) * p[3] / 2
    return _slider(p, held, u)


@numba.njit(cache=True)
def _bouc_wen(p: Array, t: Array, u: Array) -> Array:
    alpha, reach, exponent, damping, dashpot, stiffness, offset = p
    force = np.empty(t.size)
    z, steps = 0.0, 4
    for i in range(t.size):
        j = max(i, 1)
        speed = (u[j] - u[j - 1]) / (t[j] - t[j - 1])
        dt = (t[j] - t[j - 1]) / steps
        v = (dashpot * speed - alpha * z) / (damping + dashpot)
        for _ in range(steps if i else 0):
            z += dt * v / reach * (1.0 - abs(z) ** exponent * (v * z > 0))
            z = min(1.0, max(-1.0, z))
            v = (dashpot * speed - alpha * z) / (damping + dashpot)
        force[i] = alpha * z + damping * v + stiffness * u[i] + offset
    return force


def bouc_wen(p: Array, record: AxisRecord) -> Array:
    """Force of the modified Bouc-Wen damper at the recorded displacement.

    `p` = (force of the hysteretic element [N], its reach [m], exponent, damping beside it,
    dashpot in series with both [N s/m], stiffness [N/m], offset [N]). Source: Spencer, Dyke,
    Sain, Carlson 1997, eq. 16 to 18, with k0 = 0 and beta = gamma, so that |z| <= 1.
    """
    p = np.abs(p[:5]).tolist() + list(p[5:])
    return _bouc_wen(np.asarray(p), record.t, record.u)
