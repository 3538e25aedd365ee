"""Measured channels beside the predictions of their links, and statistics of the residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.link_model import leftover
from hiltestbed.diagnosis.links import ModelLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.result import ChannelResidual, Series
from hiltestbed.frames import Array

UNITS = {"p": "m", "q": "1", "r": "rad", "f": "N", "t": "N m"}


def link_series(link: ModelLink, effects: Effects = ()) -> list[Series]:
    """Every channel of every run of a link.

    Args:
        effects: the named ones; those of other links do not change the prediction.
    """
    out = []
    everything = range(len(link.runs))
    before = link.predict([(i, ()) for i in everything])
    after = link.predict([(i, effects) for i in everything]) if effects else before
    for i, (run, nominal, extended) in enumerate(zip(link.runs, before, after, strict=True)):
        t = np.asarray(np.arange(len(run.measured)) * run.scenario.tick, dtype=float)
        for j in range(run.measured.shape[1]):
            name = link.channels[j]
            measured, shown, better, sigma = (
                np.ascontiguousarray(a[:, j]) for a in (run.measured, nominal, extended, run.sigma)
            )
            out.append(
                Series(name, i, t, measured, shown, better, sigma, run.touching, unit_of(name))
            )
    return out


def unit_of(channel: str) -> str:
    return UNITS.get(channel.rpartition(".")[2][:1], "")


def counted(s: Series) -> np.ndarray:
    """(N,) bool: measured, and with a known noise."""
    return np.isfinite(s.sigma) & np.isfinite(s.measured)


def in_sigma(s: Series, extended: bool = False) -> Array:
    """(N,) residual in units of the noise, NaN where not counted."""
    use = counted(s)
    prediction = s.extended if extended else s.nominal
    return np.where(use, (s.measured - prediction) / np.where(use, s.sigma, 1.0), np.nan)


def channel_residuals(
    series: Sequence[Series], noise: Mapping[str, float], extends: bool = False
) -> tuple[ChannelResidual, ...]:
    """One record a channel, over all runs.

    Args:
        noise: channel to its floor; the median of sigma where it has none.
        extends: whether something is named, so that there is an `after`.
    """
    out = []
    for channel in dict.fromkeys(s.channel for s in series):
        mine = [s for s in series if s.channel == channel]
        left = [np.where(counted(s), s.measured - s.nominal, np.nan) for s in mine]
        total = _root(np.concatenate(left))
        if total is None:
            continue
        touched = [np.logical_or.accumulate(s.touching) for s in mine]
        phases = (
            [~t for t in touched],
            [s.touching for s in mine],
            [t & ~s.touching for t, s in zip(touched, mine, strict=True)],
        )
        free, contact, after = (
            _root(np.concatenate([x[rows] for x, rows in zip(left, phase, strict=True)]))
            for phase in phases
        )
        floor = noise.get(channel)
        if floor is None:
            floor = float(np.median(np.concatenate([s.sigma[counted(s)] for s in mine])))
        better = [np.where(counted(s), s.measured - s.extended, np.nan) for s in mine]
        out.append(
            ChannelResidual(
                channel,
                total,
                floor,
                free,
                contact,
                after,
                _white(mine, False),
                mine[0].unit,
                _root(np.concatenate(better)) if extends else None,
                _white(mine, True) if extends else None,
            )
        )
    return tuple(out)


def _root(left: Array) -> float | None:
    """Root of the mean square of what is known; None without any."""
    known = left[np.isfinite(left)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def _white(series: Sequence[Series], extended: bool) -> bool:
    """Whether the variance and the variance of block means are within their limits; correlated
    samples count once.
    """
    left = [r[np.isfinite(r)] for r in (in_sigma(s, extended) for s in series)]
    return leftover([r for r in left if len(r)]).noise


def misfit(series: Sequence[Series], channel: str) -> float:
    """rms of a channel in units of its noise; 0 without samples."""
    return _root(np.concatenate([in_sigma(s) for s in series if s.channel == channel])) or 0.0
