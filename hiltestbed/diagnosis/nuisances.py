"""Stage "layout": nuisance terms of each run: baseline wander, and tones in free flight whose phase
differs between runs, as those of the mains; a hum of one phase in all runs is an effect of the
sensor.

Their amplitudes in a run are not known, but how large they are as a rule is: as large as they
differ between the runs. Misfits are whitened by the covariance of noise and nuisances together, at
no cost for each hypothesis. What the runs have in common beyond that remains a misfit: a baseline
that wanders by 0.1 N from run to run does not hide a bias of 2 N.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from scipy.stats import chi2, gamma
from scipy.stats import f as fisher

from hiltestbed.diagnosis.settings import SIGNIFICANCE_LEVEL, SIGNIFICANT
from hiltestbed.frames import Array

# chosen: of the polynomials; three quarters of a slow period are a quintic to half a percent
BASELINE_DEGREE = 5
# of a run, from which its baseline is estimated: the scatter of ten rows a number, to a quarter
MIN_BASELINE_ROWS = 10 * (1 + BASELINE_DEGREE)
MAX_TONES = 6  # that are sought
MIN_POWER_RATIO = 3.0  # chosen: times the power around it, in any case
# chosen: independent values of the periodograms from which the power around a line is estimated: to
# some 10 %
SURROUNDINGS = 100
# chosen: share of the power that remains in the mean over the runs if they share a phase
MIN_SHARED_POWER = 0.8
FREQUENCIES_TRIED = 41  # chosen: within a line's width


class Aside:
    """Nuisance terms ``columns`` (N, C, D) of one run under the ``weight`` (N, C) of its misfits,
    one over the noise, each at one standard deviation, with an amplitude in each channel.

    With unit noise and terms U = Q S V^T in units of it, (1 + U U^T)^(-1/2) = 1 - Q (1 - (1 +
    S^2)^(-1/2)) Q^T whitens the misfits.
    """

    def __init__(self, weight: Array, columns: Array) -> None:
        self.weight, self.columns = weight, columns
        self._inverse = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0.0)
        terms = np.moveaxis(columns * weight[:, :, None], 1, 0)  # (C, N, D)
        self._basis, s, _ = np.linalg.svd(terms, full_matrices=False)
        self._share = 1.0 - 1.0 / np.hypot(1.0, s)  # of a misfit, that whitening takes away

    def under(self, weight: Array) -> Aside:
        """The same terms under other weights (N, C)."""
        return Aside(weight, self.columns)

    @property
    def log_determinant(self) -> float:
        """Half the logarithm by which the terms raise the determinant of the covariance."""
        return -float(np.sum(np.log1p(-self._share)))

    def of(self, left: Array) -> Array:
        """``(N, C)`` part of misfits (N, C) that whitening takes away."""
        if not self.columns.shape[2]:
            return np.zeros_like(left)
        along = np.einsum("cnd,nc->cd", self._basis, self.weight * left) * self._share
        return np.einsum("cnd,cd->nc", self._basis, along) * self._inverse


def baseline_terms(places: Array, degree: int) -> Array:
    """``(N, D)`` polynomials at places (N,) from -1 to 1."""
    return np.asarray(legendre.legvander(places, degree), dtype=np.float64)


def wander_between(free: Sequence[tuple[Array, Array]], spread: Array) -> Array | None:
    """(D, C) standard deviation of the baselines' coefficients between runs; None where their
    shapes differ by no more than chance.

    It is larger than that of the coefficients on hand, so far that what the runs share passes for a
    cause as rarely as noise does, however few they are: F(1, n - 1) and not chi-square is the
    distribution of its square.

    Args:
        free: of each run, rows (M,) scaled from -1 to 1 and readings there (M, C). spread: (C,)
            standard deviation of the noise, as it acts on smooth departures.
    """
    found, errors = [], []
    for at, readings in free:
        if len(at) < MIN_BASELINE_ROWS or not (spread > 0.0).all():
            continue
        # stable where rows are close together
        q, r = np.linalg.qr(baseline_terms(at, BASELINE_DEGREE))
        inverse = np.linalg.inv(r)
        found.append(inverse @ (q.T @ readings))
        errors.append(np.sqrt((inverse**2).sum(axis=1))[:, None] * spread)
    if len(found) < 2:
        return None
    coefficients, error = np.array(found), np.array(errors)
    weight = 1.0 / error**2
    shared = (weight * coefficients).sum(axis=0) / weight.sum(axis=0)
    freedom = (len(found) - 1) * shared[1:].size  # an offset has no shape
    apart = (weight * (coefficients - shared) ** 2)[:, 1:]
    if float(np.sum(apart)) <= float(chi2.isf(SIGNIFICANCE_LEVEL, freedom)):
        return None
    few = fisher.isf(SIGNIFICANCE_LEVEL, 1, len(found) - 1) / SIGNIFICANT
    return np.asarray(np.sqrt(few * coefficients.var(axis=0, ddof=1)))


def tones_of(flat: Sequence[Array]) -> list[float]:
    """[rad] a row of the tones in noisy readings (n, C) of each run, strongest first."""
    # so fine that a tone is removed to a hundredth of its power
    size = 1 << (max(len(x) for x in flat) - 1).bit_length() + 3
    counted = [x for x in flat if len(x)]
    count = len(counted) * counted[0].shape[1]
    longest = max(len(x) for x in counted)
    least, width = _least_ratio(count, longest // 2), 2 * size // longest
    reach = 1 + max(4, math.ceil(SURROUNDINGS / (4 * count)))
    found: list[float] = []
    left = list(counted)
    for _ in range(MAX_TONES):
        power = np.zeros(size // 2 + 1)
        for x in left:
            spectrum = np.fft.rfft(x / np.maximum(x.std(axis=0), 1e-300), size, axis=0)
            power += (np.abs(spectrum) ** 2).sum(axis=1)
        at = int(np.argmax(power))
        below = power[max(0, at - reach * width) : max(0, at - width)]
        beside = np.concatenate([below, power[at + width : at + reach * width]])
        if at < width or not len(beside) or power[at] < least * np.median(beside):
            break
        found.append(2.0 * math.pi * at / size)
        left = without_tones(left, found[-1:])
    return found


def _least_ratio(count: int, frequencies: int) -> float:
    """Power of a line over the median around it, which noise without lines exceeds at one of the
    ``frequencies`` by chance in :data:`SIGNIFICANCE_LEVEL` of all sets: the sum of ``count``
    periodograms of noise follows a gamma distribution of that shape.
    """
    least = gamma.isf(SIGNIFICANCE_LEVEL / max(frequencies, 1), count) / gamma.median(count)
    return max(MIN_POWER_RATIO, float(least))


def without_tones(
    flat: Sequence[Array], tones: Sequence[float], rows: Sequence[Array] | None = None
) -> list[Array]:
    """Readings (n, C) less the tones, each with its own amplitude and phase in each run and
    channel; ``rows``: (n,) their numbers, where these are not successive.
    """
    if not tones:
        return list(flat)
    at = rows if rows is not None else [np.arange(len(x), dtype=float) for x in flat]
    return [
        x - _part(r, x - x.mean(axis=0), tones) if len(x) > 2 * len(tones) else x
        for x, r in zip(flat, at, strict=True)
    ]


def phases_differ(
    flat: Sequence[Array], tones: Sequence[float], apart: Sequence[tuple[Array, Array]]
) -> tuple[float, ...]:
    """[rad] a row of those ``tones`` whose phase differs between runs, refined on all rows
    ``apart`` from contacts.

    apart: of each run rows (M,) and the readings (M, C) there.
    """
    out = []
    longest = max(len(x) for x in flat)
    for w in tones:
        sums = np.array(
            [
                np.exp(-1j * w * np.arange(len(x))) @ (x / np.maximum(x.std(axis=0), 1e-300))
                for x in flat
                if len(x) > 10
            ]
        )
        shared = float(np.sum(np.abs(sums.sum(axis=0)) ** 2)) / (
            len(sums) * float(np.sum(np.abs(sums) ** 2))
        )
        if len(sums) < 2 or shared > MIN_SHARED_POWER:
            continue
        tried = w + np.linspace(-math.pi, math.pi, FREQUENCIES_TRIED) / longest
        for _ in range(2):
            taken = [
                sum(
                    float(np.sum(_part(rows, x - x.mean(axis=0), [v]) ** 2))
                    for rows, x in apart
                    if len(x) > 10
                )
                for v in tried
            ]
            best = float(tried[int(np.argmax(taken))])
            tried = best + (tried - tried.mean()) * (4.0 / FREQUENCIES_TRIED)
        out.append(best)
    return tuple(out)


def _part(rows: Array, x: Array, tones: Sequence[float]) -> Array:
    """The tones in readings (M, C) at ``rows`` (M,)."""
    basis = np.concatenate([[np.sin(w * rows), np.cos(w * rows)] for w in tones]).T
    return np.asarray(basis @ np.linalg.lstsq(basis, x, rcond=None)[0], dtype=float)
