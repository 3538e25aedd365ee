"""Stage "layout": the low-pass filter that a logger puts before its converter, identified from the
force that the loop computed with.

Such a filter acts on the record alone: the loop used the unfiltered force. So a linear compensation
of the recorded force gives what the loop computed, wrench_comp, passed once through that filter. A
Butterworth filter is sought that maps the one to the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy import signal
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize, minimize_scalar

from hiltestbed.frames import Array
from hiltestbed.replay.wrench import shifted

ORDERS = (1, 2, 3, 4, 5, 6, 8)
CUTOFFS = (0.01, 0.02, 0.05, 0.12, 0.3)  # chosen: [1/row] at which a search starts
MIN_CUTOFF, MAX_CUTOFF = 0.004, 0.45  # chosen: [1/row]
MAX_LATE_ROWS = 40.0  # chosen: [rows] by which stamps may be off as well
MAX_INTERPOLATED_ROWS = 3  # chosen: of two channels together, by which interpolation may shift one
# chosen: of the variances of second differences, filtered over unfiltered, for a search to begin
MAX_ROUGHNESS_RATIO = 0.5
# chosen: of the rms difference, with the filter over without it: 1 % of the variance
MAX_RMS_RATIO = 0.1
# chosen: share of the delay; twice the error seen on healthy rigs, 0.2 and 0.3 %
DELAY_ERROR = 0.005
STARTS_PER_ORDER = 3  # chosen: starts of the search
NELDER_MEAD_OPTIONS = {"xatol": 1e-3, "fatol": 1e-9, "maxiter": 150}
RESPONSE_PERIODS = 2.0  # chosen: periods of the cut-off over which the filter responds to a jump
EARLIEST = -1.5  # [rows] of a stamp: a row, by which loggers stamp early, and half a tick
END_ROWS = 20  # chosen: at both ends that depend on rows outside the record


@dataclass(frozen=True)
class LowPass:
    """A Butterworth filter.

    Attributes:
        order: of it. cutoff: [1/row]. prompt: whether the stamps are corrected for its delay at low
            frequency. part: [rows] of further delay, less than one.
    """

    order: int
    cutoff: float
    prompt: bool = True
    part: float = 0.0

    def __call__(self, values: Array) -> Array:
        """``values`` (N, C), filtered."""
        sections, settled = self._designed
        early = (self.delay if self.prompt else 0.0) - self.part
        ahead = math.ceil(max(early, 0.0)) + 1
        held = np.concatenate([values, np.repeat(values[-1:], ahead, axis=0)])
        state = settled[:, :, None] * held[0]
        through = np.asarray(signal.sosfilt(sections, held, axis=0, zi=state)[0])
        rows = np.arange(len(values)) + early
        low = np.clip(np.floor(rows).astype(int), 0, len(held) - 2)
        part = np.clip(rows - low, 0.0, 1.0)[:, None]
        return np.asarray(through[low] + part * (through[low + 1] - through[low]), dtype=float)

    @cached_property
    def _designed(self) -> tuple[Array, Array]:
        """Its second-order sections, and their state under a constant input of one: once for all
        runs, since it takes several times as long as to filter a run.
        """
        sections = np.asarray(signal.butter(self.order, self.cutoff, fs=1.0, output="sos"))
        return sections, np.asarray(signal.sosfilt_zi(sections))

    @property
    def delay(self) -> float:
        """[rows] at low frequency: half the sum of 1/Q of its poles, over tan(pi cutoff)."""
        angles = math.pi * (2.0 * np.arange(self.order) + 1.0) / (2.0 * self.order)
        return float(np.sum(np.sin(angles))) / (2.0 * math.tan(math.pi * self.cutoff))

    @property
    def delay_error(self) -> float:
        """[rows] standard deviation of the delay, which follows from a fit."""
        return DELAY_ERROR * self.delay

    @property
    def colour(self) -> float:
        """Root of the spectral density of unit filtered white noise at low frequency."""
        ratio = np.tan(math.pi * np.linspace(0.0, 0.5, 4096, endpoint=False))
        power = 1.0 / (1.0 + (ratio / math.tan(math.pi * self.cutoff)) ** (2 * self.order))
        return 1.0 / math.sqrt(float(np.mean(power)))

    @property
    def stride(self) -> int:
        """Rows after which filtered noise is independent."""
        return max(1, round(0.5 / self.cutoff))

    def words(self, rate: float) -> str:
        """The filter in a sentence; ``rate`` [Hz] of the rows."""
        stamps = "removed from" if self.prompt else "in"
        return (
            f"the force went to the log through a low-pass of order {self.order} at "
            f"{self.cutoff * rate:.3g} Hz that the loop did not have, with its delay {stamps} the "
            f"stamps: the predictions are filtered alike"
        )

    def missed(self, values: Array) -> Array:
        """(N, C) uncertainty of the filtered ``values`` (N, C): the difference to a filter of the
        next order, rms over its response time. Infinite at the end, where the record would have to
        go on.
        """
        width = round(RESPONSE_PERIODS / self.cutoff) | 1
        other = replace(self, order=self.order + 1)
        square = uniform_filter1d((other(values) - self(values)) ** 2, width, axis=0)
        out = np.sqrt(np.maximum(square, 0.0))
        if self.prompt:
            out[len(out) - math.ceil(self.delay) :] = np.inf
        return out


def low_pass_between(
    before: Sequence[Array], behind: Sequence[Array], known: Sequence[np.ndarray]
) -> LowPass | None:
    """The filter that turns ``before`` (N, C) into ``behind`` (N, C) in each run, on rows that are
    ``known`` (N,).

    None where no Butterworth filter does, or interpolation between two rows does better: the
    difference has another origin.
    """
    counted = [k.copy() for k in known]
    for k in counted:
        k[:END_ROWS] = k[max(len(k) - END_ROWS, 0) :] = False
    if not any(k.any() for k in counted):
        return None
    inside = np.concatenate([b[k] for b, k in zip(before, counted, strict=True)])
    size = np.sqrt(np.mean(inside**2, axis=0))
    if not (size > 0.0).any():
        return None
    size = np.where(size > 0.0, size, np.inf)
    before, behind = ([x / size for x in xs] for xs in (before, behind))
    rough = [
        sum(float(np.sum(np.diff(x, 2, axis=0)[k[2:]] ** 2)) for x, k in pairs)
        for pairs in (zip(xs, counted, strict=True) for xs in (before, behind))
    ]
    if rough[1] > MAX_ROUGHNESS_RATIO * rough[0]:
        return None

    def left(filtered: Sequence[Array]) -> float:
        each = zip(behind, filtered, counted, strict=True)
        return float(sum(np.sum((b - f)[k] ** 2) for b, f, k in each))

    def misfit(order: int, x: Array) -> float:
        late = float(np.clip(x[1], -MAX_LATE_ROWS, MAX_LATE_ROWS))
        one = LowPass(order, _cutoff(x[0]), part=late)
        return left([one(b) for b in before])

    found: tuple[float, int, Array] = (math.inf, 0, np.zeros(2))
    for order in ORDERS:
        cost = partial(misfit, order)
        late = {c: (0.0, LowPass(order, c).delay) for c in CUTOFFS}
        starts = [np.array([math.log(c), rows]) for c in CUTOFFS for rows in late[c]]
        for start in sorted(starts, key=cost)[:STARTS_PER_ORDER]:
            best: Any = minimize(cost, start, method="Nelder-Mead", options=NELDER_MEAD_OPTIONS)
            if best.fun < found[0]:
                found = (float(best.fun), order, best.x)
    least, order, x = found
    if least > MAX_RMS_RATIO**2 * left(before) or least > _interpolated(before, left):
        return None
    one = LowPass(order, _cutoff(x[0]))
    shift = float(x[1])
    # stamps may be late by any time (log.skew), and early by what loggers are
    late = min((x for x in (shift, shift - one.delay) if x > EARLIEST), key=abs, default=shift)
    return replace(one, prompt=late == shift, part=late if abs(late) < 1.0 else 0.0)


def _interpolated(values: Sequence[Array], left: Callable[[Sequence[Array]], float]) -> float:
    """The least that is ``left`` where stamps lie between rows, by any number of rows."""

    def misfit(late: float) -> float:
        return left([shifted(v, -late, held=False) for v in values])

    found: list[Any] = [
        minimize_scalar(misfit, bounds=(n, n + 1.0), method="bounded")
        for n in range(-MAX_INTERPOLATED_ROWS, MAX_INTERPOLATED_ROWS)
    ]
    return min(float(f.fun) for f in found)


def _cutoff(logarithm: float) -> float:
    """The cutoff [cycles per row] within its bounds, however far a search without bounds goes."""
    return math.exp(min(max(logarithm, math.log(MIN_CUTOFF)), math.log(MAX_CUTOFF)))
