"""Tones in free flight: spectral lines that stand out of what is beside them, and which of them have another phase in each run.

A hum whose phase all runs share is an effect of the sensor. One that comes with the mains, to which nobody starts a run, is noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hiltestbed.frames import Array

MOST = 6  # tones that are looked for
SHOWS = 10.0  # standard deviations by which the mean power of many periodograms has to stand out of that beside it
LEAST = 3.0  # times the power beside it, in any case
SAME_PHASE = 0.8  # of the power, that is left in the mean of the runs where they share a phase
REFINED = 41  # frequencies within a line's width, of which the best is taken


def tones_of(flat: Sequence[Array]) -> list[float]:
    """[rad] a row of the tones in readings (n, C) of each run that hold noise beside, strongest first."""
    size = 1 << (max(len(x) for x in flat) - 1).bit_length() + 1
    counted = [x for x in flat if len(x)]
    count = len(counted) * counted[0].shape[1]
    found: list[float] = []
    left = list(counted)
    for _ in range(MOST):
        power = np.zeros(size // 2 + 1)
        for x in left:
            power += (np.abs(np.fft.rfft(x / np.maximum(x.std(axis=0), 1e-300), size, axis=0)) ** 2).sum(axis=1)
        at = int(np.argmax(power))
        width = 2 * size // max(len(x) for x in counted)
        beside = np.concatenate([power[max(0, at - 5 * width) : max(0, at - width)], power[at + width : at + 5 * width]])
        if at < width or not len(beside) or power[at] < max(LEAST, 1.0 + SHOWS / math.sqrt(count)) * np.median(beside):
            break
        found.append(2.0 * math.pi * at / size)
        left = without_tones(left, found[-1:])
    return found


def without_tones(flat: Sequence[Array], tones: Sequence[float]) -> list[Array]:
    """Readings less the tones, each of its own size and phase in each run and channel."""
    if not tones:
        return list(flat)
    return [x - _part(np.arange(len(x)), x, tones) if len(x) > 2 * len(tones) else x for x in flat]


def differing(flat: Sequence[Array], tones: Sequence[float], apart: Sequence[tuple[Array, Array]]) -> tuple[float, ...]:
    """[rad] a row of those ``tones`` whose phase differs from run to run, to the precision that all rows ``apart`` from contacts allow.

    apart: of each run readings (M, C) and their rows (M,).
    """
    out = []
    longest = max(len(x) for x in flat)
    for w in tones:
        sums = np.array([np.exp(-1j * w * np.arange(len(x))) @ (x / np.maximum(x.std(axis=0), 1e-300)) for x in flat if len(x) > 10])
        shared = float(np.sum(np.abs(sums.sum(axis=0)) ** 2)) / (len(sums) * float(np.sum(np.abs(sums) ** 2)))
        if len(sums) < 2 or shared > SAME_PHASE:
            continue
        tried = w + np.linspace(-math.pi, math.pi, REFINED) / longest
        for _ in range(2):
            taken = [sum(float(np.sum(_part(rows, x - x.mean(axis=0), [v]) ** 2)) for x, rows in apart if len(x) > 10) for v in tried]
            best = float(tried[int(np.argmax(taken))])
            tried = best + (tried - tried.mean()) * (4.0 / REFINED)
        out.append(best)
    return tuple(out)


def _part(rows: Array, x: Array, tones: Sequence[float]) -> Array:
    """The tones in readings (M, C) at ``rows`` (M,)."""
    basis = np.concatenate([[np.sin(w * rows), np.cos(w * rows)] for w in tones]).T
    return np.asarray(basis @ np.linalg.lstsq(basis, x, rcond=None)[0], dtype=float)
