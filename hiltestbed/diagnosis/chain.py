"""Sensor and compensation run over a whole record, with the kernels of the simulation."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hiltestbed.effects.sensor import condition


@njit(cache=True)
def sense_record(sub, delay, h, calibration, lag, leak, offset, drift, tone, deadzone, limit, step, out):
    """The noiseless readings of a sensor.

    Args:
        sub: (N, m, 6) physical wrench at the instants up to t_k. delay: [s]. h: tick [s].
        calibration ... step: see hiltestbed.effects.sensor.SensorChain.
        out: (N, 6).
    """
    ticks, m = sub.shape[0], sub.shape[1]
    if delay == 0.0 and _passes(calibration, lag, leak, offset, drift, tone, deadzone, limit, step):
        out[:] = sub[:, m - 1]
        return
    stages = max(lag.shape[0], leak.shape[0])
    low, high, before = np.zeros((stages, 6)), np.zeros((stages, 6)), np.zeros((stages, 6))
    late, quiet = np.zeros(6), np.zeros(6)
    shift = delay / h * m
    for k in range(ticks):
        at = k * m - shift
        if abs(at - round(at)) < 1e-6:
            at = round(at)
        first = math.floor(at)
        part = at - first
        for j in range(6):
            a = sub[(first + m - 1) // m, (first + m - 1) % m, j] if first >= 0 else 0.0
            if part > 0.0:
                b = sub[(first + m) // m, (first + m) % m, j] if first + 1 >= 0 else 0.0
                a += part * (b - a)
            late[j] = a
        condition(late, k * h, quiet, calibration, lag, leak, offset, drift, tone, deadzone, limit, step, low, high, before, out[k])


@njit(cache=True)
def _passes(calibration, lag, leak, offset, drift, tone, deadzone, limit, step):
    """Whether a sensor shows what it feels."""
    linear = np.all(calibration == np.eye(6)) and np.all(lag == 1.0) and np.all(leak < 0.0)
    added = np.any(tone[:, :3] != 0.0) or np.any(offset != 0.0) or np.any(drift != 0.0)
    return linear and not added and np.all(deadzone == 0.0) and np.all(limit == np.inf) and np.all(step == 0.0)


@njit(cache=True)
def lead_record(u, lead, lag, h, y):
    """The phase lead over a record u (N, 6): y_k = (y_(k-1) T2/h + u_k + T1 (u_k - u_(k-1))/h)/(1 + T2/h), from zero."""
    a, b = lag / h, lead / h
    for j in range(u.shape[1]):
        held, previous = 0.0, 0.0
        for k in range(u.shape[0]):
            held = (held * a + u[k, j] + b * (u[k, j] - previous)) / (1.0 + a)
            previous = u[k, j]
            y[k, j] = held
