"""The figures of the report: residual before and after, force over penetration, ranking of
hypotheses, closed loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.diagnosis.report.evidence import counted, in_sigma, misfit
from hiltestbed.diagnosis.result import (
    ChannelResidual,
    ClosedLoop,
    Heldout,
    Learned,
    Ranked,
    Series,
)
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.measured import MeasuredDataset
from hiltestbed.report.page import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED, NOMINAL, EXTENDED, FLOOR, TOUCH = "#1b2530", "#d1495b", "#0b6e99", "#8a97a3", "#f6ead6"
BAND_SIGMA = 2.0  # chosen: sigma
MAX_SHOWN = 3  # channels and runs in a figure
CONTACT_MARGIN = 0.15  # chosen: of a contact, shown on both sides of it
MIN_MISFIT_SHARE = 0.2  # chosen: of the worst channel's misfit, from which another channel is shown


def worst_channels(series: Sequence[Series]) -> list[str]:
    """The channels with the largest misfits of the nominal model, in units of their noise."""
    by_misfit = {
        channel: misfit(series, channel) for channel in dict.fromkeys(s.channel for s in series)
    }
    ordered = sorted(by_misfit, key=lambda c: -by_misfit[c])
    return [
        c for c in ordered[:MAX_SHOWN] if by_misfit[c] >= MIN_MISFIT_SHARE * by_misfit[ordered[0]]
    ]


def worst_run(series: Sequence[Series], channel: str) -> int:
    """The run with the largest misfit of a channel."""
    runs = dict.fromkeys(s.run for s in series if s.channel == channel)
    return max(runs, key=lambda run: misfit([s for s in series if s.run == run], channel))


def residuals_over_time(series: Sequence[Series], compared: str, names: Sequence[str]) -> Figure:
    """Residuals in units of the noise, for the worst channels, each in its worst run; contact
    shaded, the noise as a band.

    compared: name of the series' extended prediction; empty where there is none. names: of the
        runs.
    """
    channels = worst_channels(series)
    figure, grid = new_figure(
        9.0, 2.3 * len(channels) + 0.4, nrows=len(channels), ncols=1, squeeze=False
    )
    for axes, channel in zip(grid[:, 0], channels, strict=True):
        run = worst_run(series, channel)
        s = next(x for x in series if x.channel == channel and x.run == run)
        _shade(axes, s)
        axes.axhspan(-BAND_SIGMA, BAND_SIGMA, color=FLOOR, alpha=0.25, lw=0)
        axes.plot(s.t, in_sigma(s), color=NOMINAL, lw=0.9, label="measured less nominal")
        if compared:
            axes.plot(
                s.t, in_sigma(s, True), color=EXTENDED, lw=0.9, label=f"measured less {compared}"
            )
        axes.set_ylabel(f"{channel}\n{names[run]} [sigma]")
    _legend(grid[0, 0], above=2)
    grid[-1, 0].set_xlabel("time [s]")
    return figure


def channel_over_time(series: Sequence[Series], compared: str, names: Sequence[str]) -> Figure:
    """The worst channel, measured and predicted, around the contact, in its worst run."""
    figure, axes = new_figure(9.0, 3.2)
    plot_channel(series, compared, names, None, axes)
    return figure


def plot_channel(
    series: Sequence[Series],
    compared: str,
    names: Sequence[str],
    channel: str | None,
    axes: Axes | None,
) -> Axes:
    """A channel (None: the worst) around the contact, in its worst run; a pose, whose departure is
    small beside its travel, relative to the nominal one.

    Raises:
        InputError: no such channel.
    """
    channels = list(dict.fromkeys(s.channel for s in series))
    if not channels or (channel is not None and channel not in channels):
        raise InputError(
            f"plot: no channel {channel or ''!r}; allowed are "
            f"{', '.join(channels) or 'none: no link could be judged'}"
        )
    channel = channel or worst_channels(series)[0]
    s = next(x for x in series if x.channel == channel and x.run == worst_run(series, channel))
    if axes is None:
        import matplotlib.pyplot as plt

        _, axes = plt.subplots(figsize=(9.0, 3.2), layout="constrained")
    pose = channel.startswith("pose")
    rows = _around_contact(s)
    _shade(axes, s)
    _lines(axes, s, s.t[rows], rows, compared, pose)
    axes.set_xlim(s.t[rows][0], s.t[rows][-1])
    unit = f"m{s.unit}" if pose else s.unit
    axes.set(
        xlabel="time [s]",
        ylabel=f"{channel}{', less nominal' if pose else ''}\n{names[s.run]} [{unit}]",
    )
    _legend(axes, above=3)
    return axes


def _lines(
    axes: Axes, s: Series, x: Array, rows: np.ndarray, compared: str, pose: bool = False
) -> None:
    """Measured, nominal and extended over ``x``; a pose relative to the nominal one, in mm."""
    less, factor = (s.nominal, 1e3) if pose else (0.0, 1.0)
    ways = [
        ("measured", s.measured, {"color": MEASURED, "lw": 2.4, "alpha": 0.35}),
        ("nominal", s.nominal, {"color": NOMINAL, "lw": 1.2}),
        (compared, s.extended, {"color": EXTENDED, "lw": 1.2, "ls": "--"}),
    ]
    for label, values, style in ways:
        if label:
            axes.plot(x, (factor * (values - less))[rows], label=label, **style)


def force_against_penetration(
    series: Sequence[Series], dataset: MeasuredDataset, compared: str
) -> Figure | None:
    """Loops of the force, measured, nominal and extended, replayed on the measured pose; None where
    one of the channels is missing.
    """
    forces = {s.run: s for s in series if s.channel == "wrench_meas.fz"}
    runs = _spread(
        [
            i
            for i in forces
            if dataset.runs[i].survey.contacts and dataset.runs[i].record.has("pose_act.pz")
        ],
        dataset,
    )
    if not runs:
        return None
    figure, grid = new_figure(3.3 * len(runs) + 0.6, 3.4, nrows=1, ncols=len(runs), squeeze=False)
    for axes, i in zip(grid[0], runs, strict=True):
        run, s = dataset.runs[i], forces[i]
        rows = np.flatnonzero(s.touching & np.isfinite(s.measured))
        late = round(run.scenario.sensor.delay * run.scenario.rate)
        x = 1e3 * run.record.filled("pose_act")[np.maximum(rows - late, 0), 2]
        _lines(axes, s, x, rows, compared)
        contact = run.scenario.mechanism.contact.stiffness
        speed = abs(run.scenario.approach.velocity[2])
        axes.set_title(
            f"{run.name}: {f'{speed:.3g} m/s, ' if speed else ''}{contact:.3g} N/m", fontsize=9
        )
        axes.set_xlabel("penetration [mm]")
    grid[0, 0].set_ylabel("force along z [N]")
    _legend(grid[0, 0])
    return figure


def channels_overview(residuals: Sequence[ChannelResidual]) -> Figure:
    """rms of every channel over its noise floor, before and after."""
    shown = [r for r in residuals if r.noise_floor > 0.0]
    figure, axes = new_figure(9.0, 0.24 * len(shown) + 1.2)
    place = np.arange(len(shown))[::-1]
    before = [max(r.rms / r.noise_floor, 1e-2) for r in shown]
    axes.plot(before, place, "o", color=NOMINAL, label="nominal")
    after = {
        p: max(r.rms_extended / r.noise_floor, 1e-2)
        for p, r in zip(place, shown, strict=True)
        if r.rms_extended is not None
    }
    if after:
        axes.plot([*after.values()], [*after], "D", mfc="none", color=EXTENDED, label="extended")
    axes.axvline(1.0, color=FLOOR, lw=1)
    axes.set_xscale("log")
    axes.set_yticks(place, [r.channel for r in shown], fontsize=8)
    axes.set_xlabel("rms of the residual over the noise floor (1: only noise)")
    axes.grid(axis="x", alpha=0.3)
    _legend(axes)
    return figure


def ranking_bars(ranking: Sequence[Ranked]) -> Figure:
    """Hypotheses by their score above the best, in chi-square with penalty; with the rms on
    left-out runs.
    """
    shown = sorted((r for r in ranking if math.isfinite(r.score)), key=lambda r: r.score)[:10]
    figure, axes = new_figure(9.0, 0.36 * len(shown) + 1.2)
    place = np.arange(len(shown))[::-1]
    worse = [r.score - shown[0].score for r in shown]
    colors = [EXTENDED, *["#b9c6d0"] * (len(shown) - 1)]
    axes.barh(place, [w + 1.0 for w in worse], color=colors, height=0.65)
    axes.set_xscale("log")
    axes.set_yticks(place, [" + ".join(r.effects) or "nothing" for r in shown], fontsize=9)
    for p, w, r in zip(place, worse, shown, strict=True):
        held = "" if r.heldout is None else f"  left-out runs: {r.heldout:.3g} x noise"
        axes.text(1.15 * (w + 1.0), p, f"+{w:.3g}{held}", va="center", fontsize=8)
    axes.set_xlim(0.8, max(1e3, (worse[-1] + 1.0) ** 1.8))
    axes.set_xlabel("1 + score above the best: chi-square with the penalty for parameters")
    return figure


def heldout_bars(heldout: Heldout, names: Sequence[str]) -> Figure:
    """Each run's residual before and after, left out of the fit; ``names``: of the runs."""
    runs = sorted(heldout.per_run)
    figure, axes = new_figure(9.0, 3.0)
    place = np.arange(len(runs))
    before, after = np.array([heldout.per_run[r] for r in runs]).reshape(-1, 2).T
    axes.bar(place - 0.2, before, 0.38, color=NOMINAL, label="nominal")
    label = "extended, fitted to the other runs"
    axes.bar(place + 0.2, after, 0.38, color=EXTENDED, label=label)
    axes.axhline(1.0, color=FLOOR, lw=1)
    axes.set_xticks(place, [names[r] for r in runs], rotation=30 if len(runs) > 6 else 0)
    axes.set_ylabel("rms over noise floor")
    _legend(axes)
    return figure


def learned_curves(learned: Learned) -> Figure:
    """The curves of a learned law with the samples to which each was fitted."""
    over = {
        "penetration": ("penetration", "force added"),
        "rate": ("rate", "force added"),
        "stretch": ("stretch of the slider", "force added"),
        "spring": ("penetration", "factor on the spring added"),
        "spring_rate": ("rate", "factor on the spring added"),
        "reading": ("true value", "reading"),
        "step": ("time since a step of the command", "response"),
    }
    figure, grid = new_figure(
        3.3 * len(learned.curves) + 0.6, 3.2, nrows=1, ncols=len(learned.curves), squeeze=False
    )
    for axes, curve in zip(grid[0], learned.curves, strict=True):
        milli = curve.units[0].startswith("m")
        factor, unit = (1e3, f"m{curve.units[0]}") if milli else (1.0, curve.units[0])
        if len(curve.data):
            x, y = curve.data.T
            axes.plot(factor * x, y, ".", ms=1.5, color=MEASURED, alpha=0.3, label="data")
        x, y = curve.knots.T
        axes.plot(factor * x, y, "o-", ms=4, color=EXTENDED, lw=1.4, label="learned")
        x, y = over.get(curve.over, (curve.over, learned.effect))
        axes.set(xlabel=f"{x} [{unit}]", ylabel=f"{y} [{curve.units[1]}]")
        axes.grid(alpha=0.3)
    _legend(grid[0, 0])
    return figure


def closed_loop_figures(loop: ClosedLoop, extends: bool) -> Figure | None:
    """Restitution and peak force of each run: measured, nominal, extended; None where neither was
    measured.
    """
    labels = {"cor": "coefficient of restitution", "peak_force": "peak force [N]"}
    names = [name for name in labels if any(getattr(f, name) is not None for f in loop.measured)]
    if not names:
        return None
    figure, grid = new_figure(4.5 * len(names), 3.2, nrows=1, ncols=len(names), squeeze=False)
    sources = [
        ("measured", loop.measured, "s", MEASURED, 9),
        ("nominal", loop.nominal, "o", NOMINAL, 6),
    ]
    sources += [("extended", loop.extended, "D", EXTENDED, 5)] if extends else []
    for axes, name in zip(grid[0], names, strict=True):
        for source, rows, marker, color, size in sources:
            values = [np.nan if v is None else v for v in (getattr(f, name) for f in rows)]
            fill = "none" if source == "measured" else color
            axes.plot(loop.runs, values, marker, ms=size, mfc=fill, color=color, label=source)
        axes.set(xlabel="run", ylabel=labels[name], xticks=list(loop.runs))
        axes.grid(alpha=0.3)
    _legend(grid[0, 0])
    return figure


def _legend(axes: Axes, above: int = 0) -> None:
    """``above``: columns of one above the axes; 0: within them."""
    where = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": above} if above else {}
    axes.legend(fontsize=8, frameon=False, **where)


def _shade(axes: Axes, s: Series) -> None:
    edges = np.flatnonzero(np.diff(np.r_[False, s.touching, False].astype(int))).reshape(-1, 2)
    for start, end in edges:
        axes.axvspan(
            float(s.t[start]), float(s.t[min(end, len(s.t) - 1)]), color=TOUCH, lw=0, zorder=0
        )


def _around_contact(s: Series) -> np.ndarray:
    inside = np.flatnonzero(s.touching)
    if not len(inside):
        return np.flatnonzero(counted(s)) if counted(s).any() else np.arange(len(s.t))
    margin = int(CONTACT_MARGIN * (inside[-1] - inside[0])) + 5
    return np.arange(max(0, inside[0] - margin), min(len(s.t), inside[-1] + margin))


def _spread(runs: Sequence[int], dataset: MeasuredDataset) -> list[int]:
    """At most MAX_SHOWN runs, from the slowest to the fastest."""
    ordered = sorted(runs, key=lambda i: abs(dataset.runs[i].scenario.approach.velocity[2]))
    places = np.linspace(0, len(ordered) - 1, min(MAX_SHOWN, len(ordered))).astype(int)
    return [ordered[j] for j in np.unique(places)]
