"""Stage "replay": what every link has, its runs and the prediction of their output.

A link predicts what was measured at its output for any list of effects. Many hypotheses on many
runs are one replay: a *lane* is a run under a list of effects.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from scipy.linalg import solve_toeplitz

from hiltestbed.diagnosis.low_pass import LowPass
from hiltestbed.diagnosis.settings import PERTURBED_COPIES
from hiltestbed.effects.base import Effect
from hiltestbed.frames import Array
from hiltestbed.replay.wrench import shifted
from hiltestbed.scenario import Scenario

Effects = Sequence[Effect]
Lane = tuple[int, Effects]  # a run, and its effects
REPLAY_BYTES = 64_000_000  # chosen: of the predictions that one replay makes


class Timing(Effect):
    """The timing of a facility that no definition states: when it samples, stamps and steps; not an
    effect of the vocabulary.

    Attributes:
        delay: [s] by which the output of a link is stamped later than believed; negative: earlier.
        before: [s] by which its input acts later, or is stamped earlier. This differs from a late
            output where the output goes on without an input, and where noise passes from input to
            output: of a compensation and a numerical model.
        obeyed: [s] by which a platform obeys its command later, on all six axes.
        old: share of the old twist in a new pose of the numerical model: 0 is semi-implicit, 1
            would be explicit Euler.
    """

    kind: Literal["later"] = "later"
    delay: float = 0.0
    before: float = 0.0
    obeyed: float = 0.0
    old: float = 0.0
    link = "sensor"

    def apply(self, p: object) -> None:
        """Nothing: the link applies the shift itself."""

    def plus(self, other: Timing) -> Timing:
        return Timing(
            **{name: value + getattr(other, name) for name, value in self.parameters().items()}
        )


NO_SHIFT = Timing()


@dataclass(frozen=True)
class LinkRun:
    """One run as a link sees it.

    Attributes:
        scenario: as believed. measured: (N, C) at the output, 0 where it was not measured.
        sigma: (N, C) its noise, infinite where not measured. touching: (N,) bool, the nominal or
            the measured contact, with its tail through the sensor.
        heavy: whether the noise has outliers, see :func:`hiltestbed.diagnosis.noise.softened`.
        steps: (C,) of a computed output, in which it is written: a residual of half a step is none;
            0: it is not.
        nuisances: (N, C, D) nuisance terms, each at one standard deviation, see
            :mod:`hiltestbed.diagnosis.nuisances`; None: there are none.
    """

    scenario: Scenario
    measured: Array
    sigma: Array
    touching: np.ndarray
    heavy: bool = False
    nuisances: Array | None = None
    steps: Array | float = 0.0

    @property
    def rows(self) -> int:
        return len(self.measured)

    @property
    def terms(self) -> Array:
        """(N, C, D) nuisance terms, D = 0 where there are none."""
        if self.nuisances is None:
            return np.zeros((*self.measured.shape, 0))
        return self.nuisances

    @property
    def weight(self) -> Array:
        """(N, C) one over the noise, 0 where not measured."""
        known = np.isfinite(self.sigma)
        return np.where(known, 1.0 / np.where(known, self.sigma, 1.0), 0.0)

    def with_nuisances(self, terms: Array) -> LinkRun:
        """The same run with further nuisance ``terms`` (N, C, D)."""
        return replace(self, nuisances=np.concatenate([self.terms, terms], axis=2))


class ModelLink(ABC):
    """One link on measured inputs.

    Attributes:
        name: of the link. channels: what was measured at its output. runs: as it sees them.
        timing: of the facility, as far as it differs from the believed one.
        rounding: (N, 3) of each run, standard deviation of the rounding errors of the input's
            positions [m]; empty: there are none.
        logged: the filter through which readings went to the record; None: none.
        noise_numbers: of the noise of the input, that were fitted.
    """

    name: str
    channels: tuple[str, ...]
    runs: Sequence[LinkRun]
    timing: Timing = NO_SHIFT
    rounding: Sequence[Array] = ()
    logged: LowPass | None = None
    noise_numbers: int = 0
    computed: bool = False  # whether the output follows from the input without a delay or noise

    def with_rounding(self, rounding: Sequence[Array]) -> Self:
        """The same link with ``rounding`` errors in its input."""
        out = copy(self)
        out.rounding = rounding
        return out

    def with_timing(self, place: Timing) -> Self:
        """The same link of a facility with the timing ``place``."""
        out = copy(self)
        out.timing = place
        return out

    def timing_with(self, effects: Effects) -> Timing:
        """The timing of the link, plus that in ``effects``."""
        place = self.timing
        for effect in effects:
            if isinstance(effect, Timing):
                place = place.plus(effect)
        return place

    @property
    def tick(self) -> float:
        """[s] of the runs."""
        return self.runs[0].scenario.tick

    def predict(self, lanes: Sequence[Lane]) -> list[Array]:
        """(N, C) predicted output of each lane."""
        size = max((self.runs[i].rows for i, _ in lanes), default=1) * len(self.channels) * 8
        chunk = max(1, REPLAY_BYTES // size)
        out: list[Array] = []
        for start in range(0, len(lanes), chunk):
            out += self._replay(lanes[start : start + chunk])
        return out

    @abstractmethod
    def _replay(self, lanes: Sequence[Lane]) -> list[Array]:
        """Predictions of some lanes in one replay."""

    def shown(self, i: int, effects: Effects = ()) -> Array:
        """(N, C) predicted output of run i."""
        return self.predict([(i, effects)])[0]

    def shown_in_all(self, effects: Effects = ()) -> list[Array]:
        """(N, C) predicted output of each run."""
        return self.predict([(i, effects) for i in range(len(self.runs))])

    def passed_from_input(self, i: int, effects: Effects) -> Array | None:
        """(N, C) variance of run i due to rounding of its input; None: that has none."""
        if not self.rounding or not self.rounding[i].any():
            return None
        return variance_among(self._with_errors(i), effects)

    def _with_errors(self, i: int) -> ModelLink:
        """Run i on its input, and on copies of it with rounding errors."""
        raise NotImplementedError(f"the input of the link {self.name} has no rounding errors")

    def weights(self, i: int) -> Array | None:
        """(N, C) one over the deviations by which :meth:`whitened` divides; None: it does not."""
        return None

    def smoothing(self, effects: Effects) -> float:
        """Share of the noise of the input that is left where ``effects`` interpolate it: a
        hypothesis that smooths the noise would else explain it (W. A. Fuller, Measurement Error
        Models, 1987).
        """
        return 1.0

    def noisier(self, left: Sequence[tuple[int, Array]]) -> ModelLink:
        """The same link with as much noise of its input as departures (N, C) of its runs show."""
        return self

    def whitened(self, i: int, left: Array) -> Array | None:
        """(N, C) departures ``left`` (N, C) of run i from the prediction, white and in units of the
        noise, where errors of the input go on in the output; None: they do not.
        """
        return None

    def colour(self) -> Array | None:
        """(P + 1,) prediction-error filter that whitens the output's noise; None: it is white."""
        return None

    def doubt(self, i: int, effects: Effects) -> Array | None:
        """(N, C) uncertainty of the prediction by how a facility divides its tick; None: none."""
        return None


def smoothed(rows: float) -> float:
    """Share of white noise that is left at ``rows`` between samples, by linear interpolation."""
    part = abs(rows) % 1.0
    return math.hypot(part, 1.0 - part)


def perturbed(poses: Array, sigma: Array) -> list[Array]:
    """Poses (N, 7), and copies of them whose positions have white errors of standard deviation
    ``sigma`` (N, 3) [m].

    The errors are always the same, so that few copies show what effects make of them.
    """
    rng = np.random.default_rng(0)
    errors = [sigma * rng.standard_normal(sigma.shape) for _ in range(PERTURBED_COPIES)]
    return [poses, *(np.column_stack([poses[:, :3] + e, poses[:, 3:]]) for e in errors)]


def variance_among(copies: ModelLink, effects: Effects) -> Array:
    """(N, C) variance of the output of the runs of ``copies`` about that of the first."""
    exact, *others = copies.shown_in_all(effects)
    return np.asarray(np.mean([np.square(other - exact) for other in others], axis=0))


def whitening_filter(lags: Array) -> Array:
    """(P + 1,) prediction-error filter of noise with these autocorrelations (P + 1,), by the
    Yule-Walker equations.
    """
    return np.concatenate([[1.0], -solve_toeplitz(lags[:-1], lags[1:])])


def padded(arrays: Sequence[Array]) -> Array:
    """``(R, N, ...)`` of arrays of different length, the last row of each held."""
    longest = max(len(a) for a in arrays)
    return np.stack([padded_by(a, longest - len(a)) for a in arrays])


def padded_by(values: Array, rows: int) -> Array:
    """``values`` (N, ...) with the last one held for further ``rows``."""
    return np.concatenate([values, np.repeat(values[-1:], rows, axis=0)])


def moved(values: Array, rows: float) -> Array:
    """``values`` (N, C) as they were ``rows`` before, interpolated or extrapolated linearly."""
    return shifted(values, -rows, held=False) if rows else values


def flat_channels(group: str) -> tuple[str, ...]:
    """The names of the columns of :func:`flat_pose` for a pose of a group."""
    return tuple(f"{group}.{part}" for part in ("px", "py", "pz", "rx", "ry", "rz"))


def flat_pose(pose: Array) -> Array:
    """(N, 6) position [m] and rotation vector [rad], for small angles, of poses (N, 7)."""
    sign = np.where(pose[..., 6:] < 0, -1.0, 1.0)
    return np.concatenate([pose[..., :3], 2.0 * sign * pose[..., 3:6]], axis=-1)
