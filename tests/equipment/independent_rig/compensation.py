"""The compensator of this rig: from the reading to the wrench that drives the numerical model.

Methods, each from its published equation, with the nominal delay d of the facility and backward
differences over a tick h:

    NONE                u
    PHASE_LEAD          (T1 s + 1)/(T2 s + 1), T1 = d + T2
    SECOND_ORDER_LEAD   (1 + (d + 2 T2) s + (d^2/2 + 2 d T2 + T2^2) s^2)/(T2 s + 1)^2
    SMITH               M(x, v) + u - M(x, v at t - d), M a given spring and damper along z at
                        A; the difference may pass the lead

The dead zone of the loop (an effect) is applied before the method, the foreign gain and slew limit
after it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit

METHODS = {
    "none": (NONE := 0),
    "phase_lead": (PHASE_LEAD := 1),
    "second_order_lead": (SECOND_ORDER_LEAD := 2),
    "smith_predictor": (SMITH := 3),
}
INPUT, OUTPUT = 0, 2  # first rows of the last two inputs and of the last two outputs in `past`


class Compensator(NamedTuple):
    """The method with its parameters, and the operations before and after it. SI."""

    t1: float
    t2: float
    deadzone: float = 0.0
    gain: float = 1.0  # foreign
    slew: float = 0.0  # N/s, foreign: limit of the output's rate
    method: int = NONE
    delay: float = 0.0  # nominal
    stiffness: float = 0.0
    damping: float = 0.0
    lead_rest: bool = False


class Memory(NamedTuple):
    """The compensator's state from tick to tick; all arrays are updated in place."""

    past: np.ndarray  # (4, 6)
    history: np.ndarray  # (length, 6) the model's force, one row per tick, in a ring


def memory(comp: Compensator, h: float) -> Memory:
    """An empty memory for a tick h [s]."""
    return Memory(np.zeros((4, 6)), np.zeros((math.ceil(comp.delay / h) + 3, 6)))


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
def _spring_at_port(comp, pose, twist, out):
    """Wrench (6,) of a spring and damper along z at A beyond the nominal touch, which cannot pull."""
    force = 0.0
    if pose[2] > 0.0:
        force = max(comp.stiffness * pose[2] + comp.damping * twist[2], 0.0)
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
    _spring_at_port(comp, pose, twist, now)
    history, length = keep.history, len(keep.history)
    if k == 0:  # before the first row, its force
        for i in range(length):
            history[i] = now
    history[k % length] = now
    whole = int(math.floor(comp.delay / h))
    part = comp.delay / h - whole
    for i in range(6):
        late, early = history[(k - whole) % length, i], history[(k - whole - 1) % length, i]
        rest[i] = u[i] - ((1.0 - part) * late + part * early)
    if comp.lead_rest:
        _lead(comp.t1, comp.t2, rest, h, keep.past, out)
        rest[:] = out
    for i in range(6):
        out[i] = now[i] + rest[i]


@njit(cache=True)
def drive(comp, k, reading, felt, h, keep, out):
    """The wrench `out` (6,) that drives the numerical model at tick k; on input, that of the tick
    before.

    ``felt``: (7,), (6,) pose and twist of A in P as measured by the facility.
    """
    pose, twist = felt
    u, y = reading.copy(), np.empty(6)
    for i in range(3):
        if abs(u[i]) < comp.deadzone:
            u[i] = 0.0
    if comp.method == PHASE_LEAD:
        _lead(comp.t1, comp.t2, u, h, keep.past, y)
    elif comp.method == SECOND_ORDER_LEAD:
        _second_order(comp, u, h, keep.past, y)
    elif comp.method == SMITH:
        _smith(comp, k, u, pose, twist, h, keep, y)
    else:
        y[:] = u
    for i in range(6):
        y[i] *= comp.gain
        if comp.slew > 0.0:
            y[i] = min(max(y[i], out[i] - comp.slew * h), out[i] + comp.slew * h)
        out[i] = y[i]
