"""Stage "replay": the link dynamics: wrench_comp through the numerical model to pose_cmd."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from hiltestbed.compiled.jit import njit
from hiltestbed.diagnosis.links.base import (
    Lane,
    LinkRun,
    ModelLink,
    flat_channels,
    flat_pose,
    moved,
    padded,
)
from hiltestbed.diagnosis.settings import LEVER_ARM
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import approach_states
from hiltestbed.numerical_model.parameters import DynamicsParameters, stack
from hiltestbed.replay import Departing, replay_model

GAIN_ROWS = 10  # over which the response to an impulse is averaged
# noise of a recorded wrench that is tried first: of the rms of the wrench, and of its reading; next
# to none, a share of a thousandth and of a hundredth, a level of a hundredth; and trials from there
NOISE_STARTS = ((1e-6, 1e-6), (1e-6, 1e-3), (1e-6, 1e-2), (1e-2, 1e-6))
NOISE_TRIALS = 80
ARMS = np.array([1.0] * 3 + [LEVER_ARM] * 3)  # noise of forces to that of torques [m]


class DynamicsLink(ModelLink):
    """The numerical model: position, and attitude as a small rotation vector."""

    name = "dynamics"
    channels = flat_channels("pose_cmd")

    def __init__(self, runs: Sequence[LinkRun], wrenches: Sequence[Array]) -> None:
        """wrenches: (N, 6) wrench_comp of each run, whose `measured` is as of `flat_pose`."""
        self.runs = runs
        self._wrenches = padded(wrenches)
        self._errors = [np.zeros((r.rows, 6)) for r in runs]
        self._filters: list[tuple[Array, Array]] | None = None

    def with_input_errors(self, variance: Sequence[Array]) -> DynamicsLink:
        """The same link on recorded wrenches whose errors have a ``variance`` (N, 6) in each run:
        rows that are not on record, written digits, noise that only the log has.

        They change the twists, so that a departure from the believed motion goes on. It is whitened
        by the innovations of a Kalman filter with the places and speeds of all channels as its
        state, which takes in one channel of a row after the other (R. E. Kalman, J. Basic Eng. 82,
        1960; G. J. Bierman, Factorization Methods, 1977): a force moves and turns a body at once.
        """
        out, gains = copy(self), self._gains()
        out._errors = list(variance)
        out._filters = [
            _innovations(np.ascontiguousarray(v), gains, r.sigma**2)
            for v, r in zip(variance, self.runs, strict=True)
        ]
        return out

    def noisier(self, left: Sequence[tuple[int, Array]]) -> DynamicsLink:
        """With noise of the recorded wrenches that makes the departures most likely."""
        sizes = [self._wrenches[i, : self.runs[i].rows] ** 2 for i, _ in left]
        gains = self._gains()
        floor = np.sqrt(max(float(s.mean()) for s in sizes))

        def variance(i: int, numbers: Array) -> Array:
            level, share = np.exp(numbers)
            own = self._wrenches[i, : self.runs[i].rows] ** 2
            return self._errors[i] + (level * ARMS) ** 2 + share**2 * own

        def cost(numbers: Array) -> float:
            total = 0.0
            for i, x in left:
                filters = _innovations(variance(i, numbers), gains, self.runs[i].sigma ** 2)
                z, w = _whiten(x, *filters), filters[1]
                total += float(np.sum(z * z)) - 2.0 * float(np.sum(np.log(w[w > 0.0])))
            return total

        starts = [np.log([level * floor, share]) for level, share in NOISE_STARTS]
        found = minimize(
            cost, min(starts, key=cost), method="Nelder-Mead", options={"maxfev": NOISE_TRIALS}
        )
        out = self.with_input_errors([variance(i, found.x) for i in range(len(self.runs))])
        out.noise_numbers = len(found.x)
        return out

    def _gains(self) -> Array:
        """(6, 6) change of each channel in a tick, per unit of each part of the wrench."""
        out, rows = np.empty((6, 6)), min(GAIN_ROWS, self.runs[0].rows - 1)
        still = np.zeros((rows + 1, 6))
        runs = [replace(self.runs[0], measured=still, sigma=np.ones_like(still))]
        base = DynamicsLink(runs, [still]).shown(0)
        for j in range(6):
            pushed = still.copy()
            pushed[0, j] = 1.0
            out[:, j] = (DynamicsLink(runs, [pushed]).shown(0) - base)[rows] / (rows + 1)
        return out

    def weights(self, i: int) -> Array | None:
        return None if self._filters is None else self._filters[i][1]

    def whitened(self, i: int, left: Array) -> Array | None:
        return None if self._filters is None else _whiten(left, *self._filters[i])

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = np.array([i for i, _ in lanes])
        departures = stack([DynamicsParameters().with_effects(effects) for _, effects in lanes])
        scenarios = [self.runs[i].scenario for i in run]
        start = approach_states(s.approach for s in scenarios)
        departing = Departing([s.spacecraft for s in scenarios], start, self.tick, departures)
        places = [self.timing_with(effects) for _, effects in lanes]
        wrenches, driven = self._wrenches, run
        if any(place.before for place in places):
            pairs = zip(run, places, strict=True)
            wrenches = np.stack([moved(self._wrenches[i], p.before / self.tick) for i, p in pairs])
            driven = np.arange(len(lanes))
        old = np.array([place.old for place in places])
        poses = flat_pose(replay_model(departing, wrenches, driven, old))
        each = zip(poses, places, run, strict=True)
        return [moved(x[: self.runs[i].rows], p.delay / self.tick) for x, p, i in each]


@njit(cache=True)
def _innovations(variance, gains, noise):
    """Of wrenches whose errors have a ``variance`` (N, 6) and change the twists by ``gains`` (C, 6)
    in a tick, and outputs with variances ``noise`` (N, C): (N, C, 2 C) gains of the filter, and
    (N, C) one over the deviation of the innovation; 0 where the noise is infinite.
    """
    rows, count = noise.shape
    follow, weight = np.zeros((rows, count, 2 * count)), np.zeros((rows, count))
    p = np.zeros((2 * count, 2 * count))  # covariance of places, and of speeds after them
    for k in range(rows):
        for i in range(count):
            for j in range(count):
                for n in range(variance.shape[1]):
                    p[count + i, count + j] += gains[i, n] * variance[k, n] * gains[j, n]
        for i in range(2 * count):
            for j in range(count):
                p[i, j] += p[i, count + j]
        for i in range(count):
            for j in range(2 * count):
                p[i, j] += p[count + i, j]
        for c in range(count):
            if np.isfinite(noise[k, c]):
                s = p[c, c] + noise[k, c]
                weight[k, c] = 1.0 / math.sqrt(s)
                for i in range(2 * count):
                    follow[k, c, i] = p[i, c] / s
                for i in range(2 * count):
                    for j in range(2 * count):
                        p[i, j] -= s * follow[k, c, i] * follow[k, c, j]
    return follow, weight


@njit(cache=True)
def _whiten(left, follow, weight):
    """(N, C) innovations of departures (N, C), over their deviations."""
    rows, count = left.shape
    out, x = np.zeros_like(left), np.zeros(2 * count)
    for k in range(rows):
        for c in range(count):
            x[c] += x[count + c]
        for c in range(count):
            if weight[k, c] > 0.0:
                e = left[k, c] - x[c]
                for i in range(2 * count):
                    x[i] += follow[k, c, i] * e
                out[k, c] = e * weight[k, c]
    return out
