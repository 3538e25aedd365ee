"""The compensator of this rig: from the reading to the wrench that drives the numerical model.

Methods, each from its published equation, with the nominal delay d of the facility and backward
differences over a tick h:

    NONE                u
    PHASE_LEAD          (T1 s + 1)/(T2 s + 1), T1 = d + T2
    SECOND_ORDER_LEAD   (1 + (d + 2 T2) s + (d^2/2 + 2 d T2 + T2^2) s^2)/(T2 s + 1)^2
    POLYNOMIAL          sum over i = 0 .. p of (-1)^i C(p + 1, i + 1) u(t - i d)
    DEAD_ZONE           forces within the width are set to zero, and the torques if all forces are
    SMITH               M(x, v) + u - M(x, v at t - d), M a given spring and damper along z at
                        A; the difference may pass the lead
    VIRTUAL             u + a spring and damper along z at A beyond the nominal touch
    PASSIVITY           damping that restores the energy h sum of u . v as soon as it is negative
    RECONSTRUCTION      as SMITH on six axes, M as identified so far; an axis without an estimate
                        passes the lead

The identification in the loop is a least-squares fit of F = k x + c v + b on each axis. Force and
pose refer to the same instant (the pose is delayed). A sample is used if there is contact one tick
before and after it. The sums are accumulated, so that the estimate uses all samples so far.

The dead zone of the loop (an effect) is applied before the method, the foreign gain and slew limit
after it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig.rotation import turn_of

METHODS = {
    "none": (NONE := 0),
    "phase_lead": (PHASE_LEAD := 1),
    "second_order_lead": (SECOND_ORDER_LEAD := 2),
    "polynomial": (POLYNOMIAL := 3),
    "dead_zone": (DEAD_ZONE := 4),
    "smith_predictor": (SMITH := 5),
    "virtual_contact": (VIRTUAL := 6),
    "passivity_control": (PASSIVITY := 7),
    "reconstruction": (RECONSTRUCTION := 8),
}
INPUT, OUTPUT = 0, 2  # first rows of the last two inputs and of the last two outputs in `past`
ENERGY, PEAK, GATED, HELD = range(4)  # entries of `tally`
SUMS = 10  # 1, x, v, y, xx, xv, vv, xy, vy, yy
LEAST = 8  # samples
TRAVEL = 1e-6  # m, rad: standard deviation of x below which an axis is not excited
EXPLAINED = 0.9  # smallest fraction of the force's variance that a valid estimate explains
MOST_DAMPING = 0.5  # fraction of the damping that would stop the bodies in one tick


class Compensator(NamedTuple):
    """The method with its parameters, and the operations before and after it. SI."""

    t1: float
    t2: float
    deadzone: float = 0.0
    gain: float = 1.0  # foreign
    slew: float = 0.0  # N/s, foreign: limit of the output's rate
    method: int = NONE
    delay: float = 0.0  # nominal
    order: int = 3
    stiffness: float = 0.0
    damping: float = 0.0
    width: float = 0.0
    lead_rest: bool = False
    inverse_mass: float = 0.0  # 1/kg, of both bodies together
    threshold: float = 0.0  # N, above which the identification detects a contact


class Memory(NamedTuple):
    """The compensator's state from tick to tick; all arrays are updated in place."""

    past: np.ndarray  # (4, 6)
    # (length, 12) reading, model force or pose and twist, one row per tick, in a ring
    history: np.ndarray
    tally: np.ndarray  # (4,)
    sums: np.ndarray  # (6, SUMS)
    found: np.ndarray  # (6, 2) identified stiffness and damping, NaN without an estimate
    pending: np.ndarray  # (2, 6, 3) samples of this tick and the one before


def memory(comp: Compensator, h: float) -> Memory:
    """An empty memory for a tick h [s]."""
    length = math.ceil(comp.delay / h * max(comp.order, 1)) + 3
    return Memory(
        np.zeros((4, 6)),
        np.zeros((length, 12)),
        np.zeros(4),
        np.zeros((6, SUMS)),
        np.full((6, 2), np.nan),
        np.zeros((2, 6, 3)),
    )


@njit(cache=True)
def _remember(history, k, row):
    if k == 0:
        for i in range(len(history)):
            history[i, : len(row)] = row
    history[k % len(history), : len(row)] = row


@njit(cache=True)
def _recall(history, k, ticks, column):
    """A column's value `ticks` before row k, interpolated linearly; before the first row, the value
    of that row.
    """
    whole = int(math.floor(ticks))
    part = ticks - whole
    length = len(history)
    late, early = history[(k - whole) % length, column], history[(k - whole - 1) % length, column]
    return (1.0 - part) * late + part * early


@njit(cache=True)
def _second_order(comp, u, h, past, out):
    """The second-order lead; `past` contains inputs and outputs of the last two ticks."""
    a1 = comp.delay + 2.0 * comp.t2
    a2 = 0.5 * comp.delay**2 + 2.0 * comp.delay * comp.t2 + comp.t2**2
    b1, b2 = 2.0 * comp.t2, comp.t2**2
    for i in range(6):
        u1, u2, y1, y2 = past[INPUT, i], past[INPUT + 1, i], past[OUTPUT, i], past[OUTPUT + 1, i]
        ahead = u[i] + a1 * (u[i] - u1) / h + a2 * (u[i] - 2.0 * u1 + u2) / h**2
        out[i] = (ahead + b1 * y1 / h + b2 * (2.0 * y1 - y2) / h**2) / (1.0 + b1 / h + b2 / h**2)
        past[INPUT + 1, i], past[INPUT, i] = u1, u[i]
        past[OUTPUT + 1, i], past[OUTPUT, i] = y1, out[i]


@njit(cache=True)
def _polynomial(comp, k, u, h, history, out):
    _remember(history, k, u)
    for i in range(6):
        out[i] = 0.0
    weight = 1.0
    for i in range(comp.order + 1):  # binomial coefficients by recursion
        weight = weight * (comp.order + 1 - i) / (i + 1)
        sign = 1.0 if i % 2 == 0 else -1.0
        for a in range(6):
            out[a] += sign * weight * _recall(history, k, i * comp.delay / h, a)


@njit(cache=True)
def _spring_at_port(stiffness, damping, clipped, pose, twist, out):
    """Wrench (6,) of a spring and damper along z at A beyond the nominal touch; clipped: it cannot
    pull.
    """
    force = 0.0
    if pose[2] > 0.0:
        force = stiffness * pose[2] + damping * twist[2]
        if clipped:
            force = max(force, 0.0)
    for i in range(6):
        out[i] = 0.0
    out[2], out[3], out[4] = force, pose[1] * force, -pose[0] * force


@njit(cache=True)
def _lead(t1, t2, u, h, past, out):
    for i in range(6):
        out[i] = (past[OUTPUT, i] * t2 / h + u[i] + t1 * (u[i] - past[INPUT, i]) / h) / (
            1.0 + t2 / h
        )
        past[INPUT, i], past[OUTPUT, i] = u[i], out[i]


@njit(cache=True)
def _smith(comp, k, u, pose, twist, h, keep, out):
    now, rest = np.empty(6), np.empty(6)
    _spring_at_port(comp.stiffness, comp.damping, True, pose, twist, now)
    _remember(keep.history, k, now)
    for i in range(6):
        rest[i] = u[i] - _recall(keep.history, k, comp.delay / h, i)
    if comp.lead_rest:
        _lead(comp.t1, comp.t2, rest, h, keep.past, out)
        rest[:] = out
    for i in range(6):
        out[i] = now[i] + rest[i]


@njit(cache=True)
def _passive(comp, u, twist, h, tally, out):
    """twist: (6,) of the numerical model at the tick's start."""
    speed2 = twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2
    for i in range(6):
        out[i] = u[i]
        tally[ENERGY] += h * u[i] * twist[i]
    if tally[ENERGY] < 0.0 and speed2 > 0.0:
        alpha = min(-tally[ENERGY] / (h * speed2), MOST_DAMPING / (h * comp.inverse_mass))
        for i in range(3):
            out[i] += alpha * twist[i]
        tally[ENERGY] += h * alpha * speed2


@njit(cache=True)
def _reconstruct(comp, k, u, felt, latched, h, keep, out):
    pose, twist, _ = felt
    now, late = np.empty(12), np.empty(12)
    now[:3], now[3:6], now[6:] = pose[:3], turn_of(pose[3:7]), twist
    led = np.empty(6)
    _lead(comp.t1, comp.t2, u, h, keep.past, led)
    _remember(keep.history, k, now)
    for i in range(12):
        late[i] = _recall(keep.history, k, comp.delay / h, i)
    whole = int(math.floor(comp.delay / h))
    rate = keep.history[(k - whole) % len(keep.history), 6:12]  # constant over its tick
    _gate(comp, u[2], latched, h, keep.tally)
    take(keep.pending, keep.sums, keep.tally[GATED], late, rate, u)
    estimate(keep.tally[GATED], keep.sums, keep.found)
    for i in range(6):
        stiff, damp = keep.found[i, 0], keep.found[i, 1]
        if math.isnan(stiff) or (u[2] <= 0.0 and i != 2):
            out[i] = led[i]
        elif i == 2:
            ahead = max(stiff * now[2] + damp * now[8], 0.0) if now[2] > 0.0 else 0.0
            behind = max(stiff * late[2] + damp * late[8], 0.0) if late[2] > 0.0 else 0.0
            out[i] = u[i] + ahead - behind
        else:
            out[i] = u[i] + stiff * (now[i] - late[i]) + damp * (now[6 + i] - late[6 + i])


@njit(cache=True)
def take(pending, sums, gated, late, rate, force):
    """Store this tick's samples and accumulate those of the tick before, once the contact has
    lasted three ticks.

    pending: (2, 6, 3) x, v, F of this tick and of the one before. late: (12,) pose at the force's
        instant. rate: (6,). force: (6,).
    """
    pending[1] = pending[0]
    for i in range(6):
        pending[0, i, 0] = late[i] if gated > 0.0 else 0.0
        pending[0, i, 1] = rate[i] if gated > 0.0 else 0.0
        pending[0, i, 2] = force[i]
    if gated < 3.0:
        return
    for i in range(6):
        x, v, y = pending[1, i, 0], pending[1, i, 1], pending[1, i, 2]
        terms = (1.0, x, v, y, x * x, x * v, v * v, x * y, v * y, y * y)
        for j in range(SUMS):
            sums[i, j] += terms[j]


@njit(cache=True)
def estimate(gated, sums, found):
    """Solve for stiffness and damping, `found` (6, 2); NaN for an axis whose force they do not
    explain.
    """
    if gated < 3.0:
        return
    for i in range(6):
        n = sums[i, 0]
        if n < LEAST:
            continue
        x, v, y = sums[i, 1] / n, sums[i, 2] / n, sums[i, 3] / n
        xx, xv, vv = sums[i, 4] - n * x * x, sums[i, 5] - n * x * v, sums[i, 6] - n * v * v
        xy, vy, yy = sums[i, 7] - n * x * y, sums[i, 8] - n * v * y, sums[i, 9] - n * y * y
        det = xx * vv - xv * xv
        if xx < n * TRAVEL**2 or det <= 1e-10 * xx * vv:
            continue
        stiffness, damping = (vv * xy - xv * vy) / det, (xx * vy - xv * xy) / det
        if stiffness * xy + damping * vy < EXPLAINED * yy:
            found[i] = math.nan
        else:
            found[i, 0], found[i, 1] = stiffness, damping


@njit(cache=True)
def _gate(comp, force, latched, h, tally):
    """Count the ticks of the contact: a force above noise threshold and 2 % of its peak, or a latch
    closed for longer than the delay.
    """
    tally[PEAK] = max(tally[PEAK], force)
    tally[HELD] = tally[HELD] + 1.0 if latched else 0.0
    felt = tally[HELD] > comp.delay / h + 1.0
    inside = felt or (force > comp.threshold and force > 0.02 * tally[PEAK])
    tally[GATED] = tally[GATED] + 1.0 if inside else 0.0


@njit(cache=True)
def drive(comp, k, reading, felt, latched, h, keep, out):
    """The wrench `out` (6,) that drives the numerical model at tick k; on input, that of the tick
    before.

    ``felt``: (7,), (6,) pose and twist of A in P as measured by the facility, and (6,) the twist of
    the numerical model.
    """
    pose, twist, model_twist = felt
    u, y = reading.copy(), np.empty(6)
    for i in range(3):
        if abs(u[i]) < comp.deadzone:
            u[i] = 0.0
    if comp.method == PHASE_LEAD:
        _lead(comp.t1, comp.t2, u, h, keep.past, y)
    elif comp.method == SECOND_ORDER_LEAD:
        _second_order(comp, u, h, keep.past, y)
    elif comp.method == POLYNOMIAL:
        _polynomial(comp, k, u, h, keep.history, y)
    elif comp.method == DEAD_ZONE:
        some = False
        for i in range(6):
            y[i] = u[i] if i >= 3 or abs(u[i]) > comp.width else 0.0
            some = some or (i < 3 and abs(u[i]) > comp.width)
        if not some:
            y[3:] = 0.0
    elif comp.method == SMITH:
        _smith(comp, k, u, pose, twist, h, keep, y)
    elif comp.method == VIRTUAL:
        _spring_at_port(comp.stiffness, comp.damping, False, pose, twist, y)
        y += u
    elif comp.method == PASSIVITY:
        _passive(comp, u, model_twist, h, keep.tally, y)
    elif comp.method == RECONSTRUCTION:
        _reconstruct(comp, k, u, felt, latched, h, keep, y)
    else:
        y[:] = u
    for i in range(6):
        y[i] *= comp.gain
        if comp.slew > 0.0:
            y[i] = min(max(y[i], out[i] - comp.slew * h), out[i] + comp.slew * h)
        out[i] = y[i]
