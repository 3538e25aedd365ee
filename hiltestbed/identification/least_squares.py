"""Recursive least squares of stiffness and damping, with the pose taken at the time the force was felt.

On each axis ``F = k x + c v + b``: the intercept b takes up where the touch is, since an error dx of the touch point costs
``dk/k ~ -(4/pi) dx/x_max`` without it. What is measured at t_k left the contact at t_k - delay, so x and v are taken then, from the
history of the pose, and pass the sensor's own filters: nothing is differentiated and no lead is needed.

The recursion is kept in its information form (L. Ljung, System Identification, 2nd ed. 1999, eq. 11.12): the sums of products are
updated, and the estimate solved from them. It is the usual recursion with P0 to infinity, so no P0 biases the estimate.

A sample counts when the axial force is above the noise for a while before and after it: at touch and at separation the force is clipped,
and the filters remember it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from hiltestbed.frames import Array, rotation_vector
from hiltestbed.scenario import Scenario

GATE_SIGMA = 5.0  # contact is where the force exceeds this many standard deviations of its noise
GATE_PEAK = 0.02  # and this part of the peak so far
FILTER_MEMORY = 3.0  # time constants of the low-pass that are left out at both ends of a contact: exp(-3) = 5 % is left
MINIMUM_SAMPLES = 8
MINIMUM_TRAVEL = 1e-6  # [m, rad] standard deviation of x below which an axis is not excited
EXPLAINED = 0.9  # part of the force's variance that k x + c v must explain, else the axis carries no spring that could be told
SUMS = 9  # n, x, v, y, xx, xv, vv, xy, vy (yy is kept apart: it only serves the intervals)


class RecursiveLeastSquares:
    """Estimates of stiffness and damping on six axes for ``n`` runs.

    Axes are the components of the relative pose (position of A, rotation vector, both in P) against those of the wrench.

    Attributes:
        stiffness, damping: ``(n, 6)`` [N/m, N m/rad; N s/m, N m s/rad], NaN before the first estimate.
        stiffness_sd, damping_sd: ``(n, 6)`` their standard deviations, from the residual's variance.
        samples: ``(n, 6)`` contact samples used.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        n, first = len(scenarios), scenarios[0]
        h = 1.0 / first.rate
        self.tick = h
        self.delay = np.array([s.sensor.delay for s in scenarios])
        self._lag = self.delay / h
        self.threshold = np.array([GATE_SIGMA * s.sensor.noise for s in scenarios])
        self.forgetting = np.array([s.identification.forgetting for s in scenarios])
        lowpass = np.array([0.0 if s.sensor.lowpass is None else 1.0 / (2.0 * math.pi * s.sensor.lowpass) for s in scenarios])
        highpass = np.array([math.inf if s.sensor.time_constant is None else s.sensor.time_constant for s in scenarios])
        self._smooth = np.array([1.0 if T == 0.0 else 1.0 - math.exp(-h / T) for T in lowpass])
        self._leak = np.exp(-h / highpass)
        self._held_rate = first.rig.platform.tracking == "ideal"
        self._margin = 1 + int(math.ceil(FILTER_MEMORY * lowpass.max() / h))
        length = 2 + int(math.ceil(self.delay.max() / h))
        self._x = np.zeros((n, length, 6))
        self._v = np.zeros((n, length, 6))
        self._clock = np.zeros(1, dtype=np.int64)  # ticks seen
        self._filter = np.zeros((n, 6, 3, 2))  # low-passed value; its predecessor's high-passed value
        self._pending = np.zeros((n, self._margin + 1, 6, 4))  # x, v, 1 as felt, and F
        self._gated = np.zeros(n, dtype=np.int64)
        self._peak = np.zeros(n)
        self._sums = np.zeros((n, 6, SUMS))
        self._yy = np.zeros((n, 6))
        self.stiffness = np.full((n, 6), np.nan)
        self.damping = np.full((n, 6), np.nan)
        self.stiffness_sd = np.full((n, 6), np.nan)
        self.damping_sd = np.full((n, 6), np.nan)
        self.samples = np.zeros((n, 6))

    def update(self, wrench: Array, pose: Array, twist: Array) -> None:
        """Take in what was measured at t_k: wrench ``(n, 6)``, pose ``(n, 7)``, twist ``(n, 6)``."""
        k = int(self._clock[0])
        _remember(k, pose, twist, self._x, self._v)
        _gate(wrench, self.threshold, self._peak, self._gated)
        _sample(k, wrench, self._x, self._v, self._lag, self._held_rate, self._gated, self._smooth, self._leak, self._filter, self._pending)
        _accumulate(k, self._margin, self._gated, self._pending, self.forgetting, self._sums, self._yy, self.samples)
        _solve(self._gated, self._margin, self._sums, self._yy, self.stiffness, self.damping, self.stiffness_sd, self.damping_sd)
        self._clock[0] = k + 1

    def buffers(self) -> dict[str, Array]:
        names = ("x", "v", "clock", "filter", "pending", "gated", "peak", "sums", "yy")
        outputs = ("stiffness", "damping", "stiffness_sd", "damping_sd", "samples")
        return {name: getattr(self, "_" + name) for name in names} | {name: getattr(self, name) for name in outputs}


@njit(cache=True)
def _remember(k, pose, twist, x, v):
    slot = k % x.shape[1]
    for i in range(pose.shape[0]):
        for j in range(3):
            x[i, slot, j] = pose[i, j]
        rotation_vector(pose[i, 3:7], x[i, slot, 3:6])
        for j in range(6):
            v[i, slot, j] = twist[i, j]
        if k == 0:  # before the start the approach is uniform; no force is felt from then
            for s in range(x.shape[1]):
                x[i, s] = x[i, slot]
                v[i, s] = v[i, slot]


@njit(cache=True)
def _sample(k, wrench, x, v, delay, held_rate, gated, smooth, leak, memory, pending):
    """x, v and 1 at t_k - delay while in contact, else 0, through the sensor's filters, beside the force read at t_k."""
    length = x.shape[1]
    slot = k % pending.shape[1]
    for i in range(wrench.shape[0]):
        whole = int(math.floor(delay[i]))
        part = delay[i] - whole
        late = (k - whole) % length  # the tick that ends at or after t_k - delay
        early = (k - whole - 1) % length
        for j in range(6):
            position = (1.0 - part) * x[i, late, j] + part * x[i, early, j]
            rate = v[i, late, j] if held_rate else (1.0 - part) * v[i, late, j] + part * v[i, early, j]
            for c in range(3):
                u = 0.0 if gated[i] == 0 else position if c == 0 else rate if c == 1 else 1.0
                before = memory[i, j, c, 0]
                memory[i, j, c, 0] += (u - before) * smooth[i]
                if leak[i] < 1.0:
                    memory[i, j, c, 1] = leak[i] * (memory[i, j, c, 1] + memory[i, j, c, 0] - before)
                    pending[i, slot, j, c] = memory[i, j, c, 1]
                else:
                    pending[i, slot, j, c] = memory[i, j, c, 0]
            pending[i, slot, j, 3] = wrench[i, j]


@njit(cache=True)
def _gate(wrench, threshold, peak, gated):
    for i in range(wrench.shape[0]):
        force = wrench[i, 2]  # pushing is positive; what a high-pass leaves after the contact is negative
        peak[i] = max(peak[i], force)
        gated[i] = gated[i] + 1 if force > threshold[i] and force > GATE_PEAK * peak[i] else 0


@njit(cache=True)
def _accumulate(k, margin, gated, pending, forgetting, sums, yy, samples):
    slot = (k - margin) % pending.shape[1]
    for i in range(pending.shape[0]):
        if gated[i] < 2 * margin + 1:
            continue
        for j in range(6):
            x, v, one, y = pending[i, slot, j]
            s = sums[i, j]
            for c in range(SUMS):
                s[c] *= forgetting[i]
            s[0] += one * one
            s[1] += one * x
            s[2] += one * v
            s[3] += one * y
            s[4] += x * x
            s[5] += x * v
            s[6] += v * v
            s[7] += x * y
            s[8] += v * y
            yy[i, j] = forgetting[i] * yy[i, j] + y * y
            samples[i, j] += 1.0


@njit(cache=True)
def _solve(gated, margin, sums, yy, stiffness, damping, stiffness_sd, damping_sd):
    for i in range(sums.shape[0]):
        if gated[i] < 2 * margin + 1:
            continue
        for j in range(6):
            n, x, v, y, xx, xv, vv, xy, vy = sums[i, j]
            if n < MINIMUM_SAMPLES:
                continue
            xx -= x * x / n
            xv -= x * v / n
            vv -= v * v / n
            xy -= x * y / n
            vy -= v * y / n
            det = xx * vv - xv * xv
            if xx < n * MINIMUM_TRAVEL**2 or det <= 1e-10 * xx * vv:
                continue
            k = (vv * xy - xv * vy) / det
            c = (xx * vy - xv * xy) / det
            total = yy[i, j] - y * y / n
            if k * xy + c * vy < EXPLAINED * total:
                stiffness[i, j] = damping[i, j] = stiffness_sd[i, j] = damping_sd[i, j] = np.nan
                continue
            variance = max(0.0, total - k * xy - c * vy) / max(1.0, n - 3.0)
            stiffness[i, j] = k
            damping[i, j] = c
            stiffness_sd[i, j] = math.sqrt(variance * vv / det)
            damping_sd[i, j] = math.sqrt(variance * xx / det)
