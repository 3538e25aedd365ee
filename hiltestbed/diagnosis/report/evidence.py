"""Measured channels beside the predictions of their links, and statistics of the residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.link_model import leftover
from hiltestbed.diagnosis.links import ModelLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.result import ChannelResidual, Series
from hiltestbed.frames import Array

FREE, CONTACT, AFTER = "free", "contact", "after"
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
    """The unit of a column of the trace."""
    return UNITS.get(channel.rpartition(".")[2][:1], "")


def counted(s: Series) -> np.ndarray:
    """(N,) bool: measured, and with a known noise."""
    return np.isfinite(s.sigma) & np.isfinite(s.measured)


def in_sigma(s: Series, extended: bool = False) -> Array:
    """(N,) residual in units of the noise, NaN where not counted."""
    use = counted(s)
    prediction = s.extended if extended else s.nominal
    return np.where(use, (s.measured - prediction) / np.where(use, s.sigma, 1.0), np.nan)


def phases(s: Series) -> dict[str, np.ndarray]:
    """(N,) bool for each phase: before the first touch, in contact, and apart after it."""
    touched = np.logical_or.accumulate(s.touching)
    return {FREE: ~touched, CONTACT: s.touching, AFTER: touched & ~s.touching}


def channel_residuals(
    series: Sequence[Series], noise: Mapping[str, float] | None = None, extends: bool = False
) -> tuple[ChannelResidual, ...]:
    """One record a channel, over all runs.

    Args:
        noise: channel to its floor; the median of sigma where it has none.
        extends: whether something is named, so that there is an `after`.
    """
    out = []
    for channel in dict.fromkeys(s.channel for s in series):
        mine = [s for s in series if s.channel == channel]
        floor = (noise or {}).get(channel)
        if floor is None:
            floor = _floor(mine)
        by_phase = {
            p: _rms(mine, lambda s, p=p: counted(s) & phases(s)[p]) for p in (FREE, CONTACT, AFTER)
        }
        total = _rms(mine, counted)
        if total is None:
            continue
        out.append(
            ChannelResidual(
                channel,
                total,
                floor,
                by_phase[FREE],
                by_phase[CONTACT],
                by_phase[AFTER],
                _white(mine, False),
                mine[0].unit,
                _rms(mine, counted, True) if extends else None,
                _white(mine, True) if extends else None,
            )
        )
    return tuple(out)


def _rms(
    series: Sequence[Series], rows: Callable[[Series], np.ndarray], extended: bool = False
) -> float | None:
    squares, samples = 0.0, 0
    for s in series:
        use = rows(s)
        left = (s.measured - (s.extended if extended else s.nominal))[use]
        squares += float(left @ left)
        samples += len(left)
    return float(np.sqrt(squares / samples)) if samples else None


def _floor(series: Sequence[Series]) -> float:
    known = np.concatenate([s.sigma[counted(s)] for s in series])
    return float(np.median(known)) if len(known) else 0.0


def _white(series: Sequence[Series], extended: bool) -> bool:
    """Whether the variance and the variance of block means are within their limits; correlated
    samples count once.
    """
    left = [r[np.isfinite(r)] for r in (in_sigma(s, extended) for s in series)]
    return leftover([r for r in left if len(r)]).noise


def misfit(series: Sequence[Series], channel: str, extended: bool = False) -> float:
    """rms of a channel in units of its noise; 0 without samples."""
    left = np.concatenate(
        [in_sigma(s, extended) for s in series if s.channel == channel] or [np.zeros(0)]
    )
    left = left[np.isfinite(left)]
    return float(np.sqrt(np.mean(left**2))) if len(left) else 0.0
