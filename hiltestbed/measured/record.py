"""One measured run on the ticks of the loop, with a mask of the samples that were measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import savgol_filter

from hiltestbed.frames import Array
from hiltestbed.measured.noise import FREE_MINIMUM, last_digit
from hiltestbed.signals import GROUPS

MEASURED_GROUPS = ("pose_cmd", "pose_act", "twist_cmd", "twist_act", "wrench_meas", "wrench_comp")
# derived: steps between neighbours of a smooth signal that lie one step apart; two apart are a jump
WITHIN_STEP = 1.5
# chosen: of a local cubic: a third of independent rounding errors is left, and a vibration of 50
# rows keeps 99 %
SMOOTHED_ROWS = 17
# chosen: steps between a sample and the local cubic: half a step by rounding, the rest by the error
# of the cubic
MAX_ROUNDED = 0.75
# derived: of a pose, missing samples in a row that a cubic spline bridges. Bodies have mass: at a
# touch the acceleration steps by c v/mu, and the spline is off by at most that times the square of
# the gap over 16: 3e-8 m for 300 N s/m, 0.03 m/s, 400 kg and 5 samples of 1 kHz
MAX_BRIDGED = 5
# rows by which a channel may be off: loggers stamp each up to a row early or late, of two channels
# two in all, and what is measured of it is right to a quarter
LOGGER = 2.25
IDENTITY = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Record:
    """One run of a dataset.

    Attributes:
        run: its number in the dataset. file: from which it was read.
        t: ``(ticks,)`` [s], ``tick/rate``, from 0 to the last tick that the file reaches.
        data: group to ``(ticks, parts)``, SI units; NaN where not ``valid``. Groups without any
            column are left out.
        valid: group to ``(ticks, parts)``: the file has a sample within half a tick.
        absent: columns of MEASURED_GROUPS that the file lacks, or that were lost.
        sample_rate: [Hz] of the file.
        steps: quantised column to its step.
        digits: column that was written with few significant digits to their number.
        bends: group whose rows are not the loop's ticks to ``(ticks, parts)`` difference of a
            smooth curve through the samples from linear interpolation.
        sampled: column whose ticks were interpolated to the noise of the original samples, as white
            noise of as many samples as there are ticks with the same total.
    """

    run: int
    file: Path
    t: Array
    data: dict[str, Array]
    valid: dict[str, NDArray[np.bool_]]
    absent: tuple[str, ...] = ()
    sample_rate: float = 0.0
    steps: dict[str, float] = field(default_factory=dict)
    digits: dict[str, int] = field(default_factory=dict)
    bends: dict[str, Array] = field(default_factory=dict)
    sampled: dict[str, float] = field(default_factory=dict)

    @property
    def ticks(self) -> int:
        return len(self.t)

    def has(self, name: str) -> bool:
        """Whether the record has a column, or any column of a group."""
        return name in self.data if name in GROUPS else name in self.columns()

    def whole(self, group: str) -> bool:
        """Whether the record has every sample of the columns of a group that were measured."""
        return group in self.data and all(
            self.measured(c).all() for c in GROUPS[group].columns if c not in self.absent
        )

    def columns(self) -> tuple[str, ...]:
        return tuple(c for name in self.data for c in GROUPS[name].columns if c not in self.absent)

    def column(self, name: str) -> Array:
        """``(ticks,)`` of one column, NaN where not measured; KeyError if the record lacks it."""
        group, part = place(name)
        return self.data[group][:, part]

    def measured(self, name: str) -> NDArray[np.bool_]:
        """``(ticks,)``: where a column was measured."""
        group, part = place(name)
        return self.valid[group][:, part]

    def with_group(self, group: str, values: Array) -> Record:
        """The same with ``(ticks, parts)`` values of a group that are known exactly."""
        own = GROUPS[group].columns
        return replace(
            self,
            data=self.data | {group: values},
            valid=self.valid | {group: np.ones(values.shape, dtype=bool)},
            steps={n: v for n, v in self.steps.items() if n not in own},
            digits={n: v for n, v in self.digits.items() if n not in own},
            bends={n: v for n, v in self.bends.items() if n != group},
        )

    def rounding(self, group: str) -> Array:
        """``(ticks, parts)`` 1 sigma of the rounding error of samples written with few significant
        digits; 0 for those with many.
        """
        size = np.abs(np.nan_to_num(self.data[group]))
        out = np.zeros_like(size)
        for j, name in enumerate(GROUPS[group].columns):
            if name in self.digits:
                nonzero = size[:, j] > 0.0
                steps = last_digit(size[nonzero, j], self.digits[name])
                out[nonzero, j] = steps / math.sqrt(12.0)
        return out

    def filled(self, group: str) -> Array:
        """``(ticks, parts)`` without NaN, as the input of a model; not for residuals, which count
        only where ``valid``.

        Gaps are interpolated linearly, short gaps of a pose by a cubic spline; ticks between the
        rows of a log with another clock are on a smooth curve (quaternions are normalised). Before
        the first and after the last sample the value is held; positions before the first sample are
        extrapolated uniformly. Absent axes are zero, an absent attitude is the identity. A command
        that was logged in steps or with few digits is interpolated between the centres of equal
        values that are one step apart (a larger jump was commanded), then smoothed where a smooth
        command, rounded, would be what is on record.
        """
        columns = [self._bridged(group, j) for j in range(self.data[group].shape[1])]
        if group == "pose_cmd":
            rounded = zip(columns, self._command_steps().T, strict=True)
            columns = [_without_rounding(column, step)[0] for column, step in rounded]
        values = np.column_stack(columns) + self.bends.get(group, 0.0)
        if group.startswith("pose"):
            bridged = ~self.valid[group][:, 3:].all(axis=1) | (group in self.bends)
            attitude = values[bridged, 3:]
            norm = np.linalg.norm(attitude, axis=1, keepdims=True)
            unit = attitude / np.where(norm > 0, norm, 1.0)
            values[bridged, 3:] = np.where(norm > 0, unit, IDENTITY)
        return values

    def unsmoothed(self) -> Array:
        """``(ticks, 3)`` 1 sigma of rounding of the command, 0 where :meth:`filled` smooths it."""
        out = self._command_steps()[:, :3] / math.sqrt(12.0)
        for j, sigma in enumerate(out.T):
            smoothed = _without_rounding(self._bridged("pose_cmd", j), math.sqrt(12.0) * sigma)[1]
            out[smoothed, j] = 0.0
        return out

    def _command_steps(self) -> Array:
        """``(ticks, parts)`` step of the command: its last digit, or quantisation; or 0."""
        steps = np.array([self.steps.get(name, 0.0) for name in GROUPS["pose_cmd"].columns])
        return np.maximum(math.sqrt(12.0) * self.rounding("pose_cmd"), steps)

    def _bridged(self, group: str, j: int) -> Array:
        """``(ticks,)`` of one column with its gaps filled."""
        values, known = self.data[group][:, j].copy(), self.valid[group][:, j]
        pose = group.startswith("pose")
        if not known.any():
            values[:] = ((0.0,) * 3 + IDENTITY)[j] if pose else 0.0
        if known.all() or not known.any():
            return values
        t, samples = self.t[known], values[known]
        values = np.interp(self.t, t, samples)
        short = self.lost(group) & ~self.in_long_gaps(group)
        if pose and short.any() and known.sum() > MAX_BRIDGED:
            values[short] = CubicSpline(t, samples)(self.t[short])
        if pose and j < 3 and not known[0] and len(t) > 1:  # at the speed of the first samples
            slope = np.polyfit(t[:FREE_MINIMUM] - t[0], samples[:FREE_MINIMUM], 1)[0]
            before = self.t < t[0]
            values[before] = samples[0] + slope * (self.t[before] - t[0])
        return values

    def lost(self, group: str) -> NDArray[np.bool_]:
        """``(ticks,)``: samples of ``group`` that are missing between others, or at an end.

        Ticks between two samples of a log that is slower than the loop do not count as missing, nor
        do absent columns.
        """
        known = np.all(
            [self.measured(c) for c in GROUPS[group].columns if c not in self.absent], axis=0
        )
        stride = math.ceil(self.rate / self.sample_rate - 1e-6) if self.sample_rate else 1
        at = np.flatnonzero(known)
        missing = np.zeros(self.ticks, dtype=bool)
        for before, after in zip(np.r_[-1, at], np.r_[at, self.ticks], strict=True):
            if after - before > stride + (stride > 1):
                missing[before + 1 : after] = True
        return missing

    @property
    def rate(self) -> float:
        """[Hz] of the ticks."""
        return float((self.ticks - 1) / self.t[-1]) if self.ticks > 1 else 1.0

    def in_long_gaps(self, group: str) -> NDArray[np.bool_]:
        """``(ticks,)``: missing samples, more than MAX_BRIDGED in a row or at an end."""
        missing = self.lost(group)
        for start, end in stretches(missing):
            if start > 0 and end < self.ticks and end - start <= MAX_BRIDGED:
                missing[start:end] = False
        return missing

    def unknown(self, group: str, memory: float | None = None) -> NDArray[np.bool_]:
        """``(ticks,)``: the output of a block here depends on missing samples of ``group``; of a
        pose, on those that no spline bridges.

        Args:
            memory: [s] for which the block's output depends on its input; None: forever, as for an
                integral.
        """
        missing = self.in_long_gaps(group) if group.startswith("pose") else self.lost(group)
        lasting = self.ticks if memory is None else round(memory * self.rate)
        rows = np.arange(self.ticks)
        last = np.maximum.accumulate(np.where(missing, rows, -1))
        return (last >= 0) & (rows - last <= lasting)


def stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """The first row of each stretch of successive True values, and the one after its last."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False]))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def place(column: str) -> tuple[str, int]:
    """Group and part number of a column of the trace."""
    group, _, part = column.rpartition(".")
    return group, GROUPS[group].parts.index(part)


def _between_steps(values: Array, step: Array) -> Array:
    """``(n,)`` values interpolated between the centres of equal ones; larger jumps stay."""
    starts = np.flatnonzero(np.r_[True, values[1:] != values[:-1]])
    ends = np.r_[starts[1:], len(values)] - 1
    usual = WITHIN_STEP * np.maximum(step[ends[:-1]], step[starts[1:]])
    jumps = np.abs(np.diff(values[starts])) > usual
    before, after = ends[:-1][jumps], starts[1:][jumps]
    knots = np.concatenate([0.5 * (starts + ends), before, after])
    known = values[np.concatenate([starts, before, after])]
    order = np.argsort(knots, kind="stable")
    return np.interp(np.arange(len(values)), knots[order], known[order])


def _without_rounding(values: Array, step: Array) -> tuple[Array, NDArray[np.bool_]]:
    """``(n,)`` values less their rounding to a ``step`` (n,), and where a curve replaces them."""
    if not step.any():
        return values, np.zeros(len(values), dtype=bool)
    smooth, within = _within_steps(_between_steps(values, step), step)
    rounded = np.clip(smooth, values - 0.5 * step, values + 0.5 * step)
    return np.where(within, rounded, smooth), within


def _within_steps(values: Array, step: Array) -> tuple[Array, NDArray[np.bool_]]:
    """``(n,)`` values smoothed by local cubics (A. Savitzky, M. J. E. Golay, Anal. Chem. 36, 1964)
    where all rows of a window then lie within the rounding to one ``step`` (n,), and where that is;
    the values as they are elsewhere.
    """
    if len(values) < SMOOTHED_ROWS:
        return values, np.zeros(len(values), dtype=bool)
    smooth = np.asarray(savgol_filter(values, SMOOTHED_ROWS, 3))
    close = (np.abs(values - smooth) <= MAX_ROUNDED * step).astype(np.uint8)
    varies, coarsens = (
        maximum_filter1d(x, SMOOTHED_ROWS) > minimum_filter1d(x, SMOOTHED_ROWS)
        for x in (values, step)
    )
    within = (minimum_filter1d(close, SMOOTHED_ROWS) > 0) & ~coarsens
    return np.where(within & varies, smooth, values), within
