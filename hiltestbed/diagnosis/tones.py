"""Stage "layout": tones in free flight: spectral lines above their surroundings, and those of them
whose phase differs between runs.

A hum whose phase is the same in all runs is an effect of the sensor. One from the mains, with which
no run is synchronised, is noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import gamma

from hiltestbed.diagnosis.settings import SIGNIFICANCE_LEVEL
from hiltestbed.frames import Array

MAX_TONES = 6  # that are sought
MIN_POWER_RATIO = 3.0  # chosen: times the power around it, in any case
# chosen: independent values of the periodograms from which the power around a line is estimated: to
# some 10 %
SURROUNDINGS = 100
# chosen: share of the power that remains in the mean over the runs if they share a phase
MIN_SHARED_POWER = 0.8
FREQUENCIES_TRIED = 41  # chosen: within a line's width


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
            power += (
                np.abs(np.fft.rfft(x / np.maximum(x.std(axis=0), 1e-300), size, axis=0)) ** 2
            ).sum(axis=1)
        at = int(np.argmax(power))
        beside = np.concatenate(
            [
                power[max(0, at - reach * width) : max(0, at - width)],
                power[at + width : at + reach * width],
            ]
        )
        if at < width or not len(beside) or power[at] < least * np.median(beside):
            break
        found.append(2.0 * math.pi * at / size)
        left = without_tones(left, found[-1:])
    return found


def _least_ratio(count: int, frequencies: int) -> float:
    """Power of a line over the median around it, which noise without lines exceeds at one of the
    ``frequencies`` by chance in
    :data:`SIGNIFICANCE_LEVEL` of all sets: the sum of ``count`` periodograms of noise follows a
    gamma distribution of that shape.
    """
    return max(
        MIN_POWER_RATIO,
        float(gamma.isf(SIGNIFICANCE_LEVEL / max(frequencies, 1), count) / gamma.median(count)),
    )


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
