"""Stage "replay": the link compensation: wrench_meas to wrench_comp."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import lfilter, savgol_filter

from hiltestbed.compensation.input import InputParameters
from hiltestbed.diagnosis.links.base import (
    Effects,
    Lane,
    LinkRun,
    ModelLink,
    Timing,
    moved,
    padded,
    smoothed,
    whitening_filter,
)
from hiltestbed.diagnosis.settings import BLOCK_ROWS, CORRELATED_ROWS, MODEL_ERROR
from hiltestbed.effects.log import LogParameters
from hiltestbed.frames import Array
from hiltestbed.replay import moves_linearly, replay_compensation
from hiltestbed.replay.compensation import central_rates, reads_rates
from hiltestbed.replay.wrench import shifted
from hiltestbed.signals import GROUPS

IMPULSE = 1e9  # [N] that exceeds any dead zone
COLOUR_ORDER = 12  # of the filter that makes noise behind a compensation white
RESPONSE_ROWS = 400  # chosen: within which the response to an impulse decays
# of a straight line, whose slope has sqrt(12/(n^3 - n)) = 0.13 of the noise of a row
SLOPE_ROWS = 9


class CompensationLink(ModelLink):
    """The believed compensation, and the loop's dead zone before it."""

    name = "compensation"
    computed = True
    channels = GROUPS["wrench_comp"].columns

    def __init__(
        self,
        runs: Sequence[LinkRun],
        wrenches: Sequence[Array],
        records: Mapping[str, Sequence[Array]],
    ) -> None:
        """wrenches: (N, 6) wrench_meas of each run. records: pose_act, pose_cmd and their twists,
        as far as the method reads them.
        """
        self.runs, self.wrenches = runs, wrenches
        self._sources = records
        self._records = {name: padded(values) for name, values in records.items()}

    def with_central_rates(self) -> CompensationLink | None:
        """The same link with twist_act by central differences, in place of the slope of the tick
        that ends; None where the method reads no rate, the rate is on record, or A moves uniformly
        within a tick, so that the slope is the rate.
        """
        scenarios = [r.scenario for r in self.runs]
        reads = any(reads_rates(s.compensation, s.mechanism) for s in scenarios)
        linear = all(moves_linearly(s.rig) for s in scenarios)
        if "twist_act" in self._sources or linear or not reads:
            return None
        pairs = zip(scenarios, self._sources["pose_act"], strict=True)
        rates = [central_rates(s.approach, s.tick, poses) for s, poses in pairs]
        records = {**self._sources, "twist_act": rates}
        return CompensationLink(self.runs, self.wrenches, records).with_timing(self.timing)

    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        run = [i for i, _ in lanes]
        found = replay_compensation(
            [self.runs[i].scenario for i in run],
            [InputParameters().with_effects(effects) for _, effects in lanes],
            {name: values[run] for name, values in self._records.items()},
            padded([self._reading(i, effects) for i, effects in lanes]),
            np.arange(len(lanes)),
        )
        return [
            self._between(i, wrench[: self.runs[i].rows], self.timing_with(effects))
            for wrench, (i, effects) in zip(found, lanes, strict=True)
        ]

    def _between(self, i: int, shown: Array, timing: Timing) -> Array:
        """(N, C) prediction of run i with a late output, or an early input.

        A linear response to an input between two rows lies between the rows of the output, noise
        included; interpolation lowers that noise.
        """
        tick, given = self.runs[i].scenario.tick, self.runs[i].measured
        out = moved(shown, timing.delay / tick)
        return given - (moved(given, -timing.before / tick) - out) if timing.before else out

    def _reading(self, i: int, effects: Effects) -> Array:
        """(N, 6) the wrench that the loop used: later rows of a record that is stamped late. Where
        that was read again, a force changes with the time, and the noise of a row stays with it.
        """
        log, wrench = LogParameters().with_effects(effects), self.wrenches[i]
        if not log.skew:
            return wrench
        rows = log.skew / self.tick
        if not log.reread:
            return shifted(wrench, rows)
        return shifted(wrench + (rows - round(rows)) * _slope(wrench), round(rows))

    def doubt(self, i: int, effects: Effects) -> Array | None:
        """Of a record that was read again: between two rows a reading may bend as it will, and one
        physical force read twice differs as two models of it do.
        """
        log, wrench = LogParameters().with_effects(effects), self.wrenches[i]
        if not (log.skew and log.reread):
            return None
        rows = log.skew / self.tick
        bend = np.abs(np.diff(wrench, axis=0, append=wrench[-1:]) - _slope(wrench))
        between = 0.5 * maximum_filter1d(bend, SLOPE_ROWS, axis=0)  # half a row from the nearest
        variance = between**2 + BLOCK_ROWS * (MODEL_ERROR * wrench) ** 2
        return np.sqrt(self.passed(shifted(variance, round(rows))))

    def noise_gain(self) -> float:
        """Factor on white noise of the readings in the first run; 1 where not linear."""
        answer = self._answer
        return 1.0 if answer is None else float(np.linalg.norm(answer))

    def colour(self) -> Array | None:
        """What the log alone adds to a reading passes through the compensation: its noise has the
        spectrum of the compensation's response to an impulse.
        """
        answer = self._answer
        if answer is None:
            return None
        n = len(answer)
        lags = np.correlate(answer, answer, "full")[n - 1 : n + COLOUR_ORDER]
        return whitening_filter(lags)

    def smoothing(self, effects: Effects) -> float:
        timing = self.timing_with(effects)
        log = LogParameters().with_effects(effects)
        shifts = (log.skew * (not log.reread), timing.delay, timing.before)
        return math.prod(smoothed(s / self.tick) for s in shifts)

    def passed(self, variance: Array) -> Array:
        """(N, 6) variance of the output due to that of the readings, both (N, 6); of what is not
        linear it is taken to be alike over :data:`CORRELATED_ROWS`.
        """
        answer = self._answer
        if answer is None or not variance.any():
            return variance if answer is not None else CORRELATED_ROWS * variance
        return np.asarray(lfilter(answer[RESPONSE_ROWS // 4 :] ** 2, 1.0, variance, axis=0))

    @property
    def linear(self) -> bool:
        """Whether it responds linearly to the readings alone."""
        return self._answer is not None

    @cached_property
    def _answer(self) -> Array | None:
        """(RESPONSE_ROWS,) response of the first run to an impulse; None where not linear."""
        scenario = self.runs[0].scenario
        if scenario.compensation.force.reads != {"wrench"}:
            return None
        impulse = np.zeros((1, RESPONSE_ROWS, 6))
        # not at the start, which a method may take for the past
        impulse[0, RESPONSE_ROWS // 4] = IMPULSE
        found = replay_compensation(
            [scenario], [InputParameters()], {}, impulse, np.zeros(1, dtype=int)
        )
        return found[0, :, 0] / IMPULSE


def _slope(wrench: Array) -> Array:
    """(N, 6) change in a row, of the line through the rows around it."""
    return np.asarray(savgol_filter(wrench, SLOPE_ROWS, 1, deriv=1, axis=0))
