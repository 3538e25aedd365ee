"""The figures of the report: residual before and after, force over penetration, learned curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from hiltestbed.diagnosis.certainty import Certainty, Profile
from hiltestbed.diagnosis.report.evidence import counted, in_sigma, misfit
from hiltestbed.diagnosis.result import (
    Heldout,
    Learned,
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
CHI2_95 = float(chi2.isf(0.05, 1))  # of one parameter
PROFILE_TOP = 5.0  # chosen: times CHI2_95: up to which a profile is drawn
PROFILES_PER_ROW = 3  # in the figure
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


def profile_figure(profiles: Sequence[Profile]) -> Figure:
    columns = min(PROFILES_PER_ROW, len(profiles))
    rows = -(-len(profiles) // columns)
    figure, grid = new_figure(
        3.2 * columns + 0.4, 2.5 * rows + 0.2, nrows=rows, ncols=columns, squeeze=False
    )
    for axes, profile in zip(grid.ravel(), profiles, strict=False):
        _profile(axes, profile)
    for axes in grid.ravel()[len(profiles) :]:
        axes.set_visible(False)
    for axes in grid[:, 0]:
        axes.set_ylabel("cost above its minimum")
    return figure


def _profile(axes: Axes, p: Profile) -> None:
    axes.axvspan(*p.ci95, color=EXTENDED, alpha=0.12, lw=0)
    axes.axhline(CHI2_95, color=FLOOR, lw=1, ls="--")
    axes.plot(p.values, p.rise, "o-", ms=3.5, color=EXTENDED, lw=1.3)
    axes.plot([p.estimate], [0.0], "D", ms=6, color=NOMINAL)
    low, high = float(p.values[0]), float(p.values[-1])
    margin = 0.08 * (high - low) or 1e-3 * max(abs(p.estimate), 1e-12)
    axes.set_xlim(low - margin, high + margin)
    for bound, beyond in ((p.bounds[0], low - margin), (p.bounds[1], high + margin)):
        if low - margin <= bound <= high + margin:
            axes.axvspan(
                min(bound, beyond),
                max(bound, beyond),
                facecolor="none",
                edgecolor=NOMINAL,
                hatch="////",
                lw=0,
            )
    axes.set_ylim(
        min(-0.05 * PROFILE_TOP * CHI2_95, 1.1 * float(p.rise.min())), PROFILE_TOP * CHI2_95
    )
    axes.set_title(p.label, fontsize=9)
    axes.set_xlabel(f"[{p.unit}]" if p.unit not in ("", "-") else "value", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.locator_params(axis="x", nbins=4)
    axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4), useMathText=True)


def correlation_figure(c: Certainty) -> Figure:
    """The matrix with its numbers, blue and red for the two signs."""
    names, count = [p.label for p in c.profiles], len(c.profiles)
    size = 0.62 * count + 2.4
    figure, axes = new_figure(size + 1.4, size)
    drawn = axes.imshow(c.correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    for i in range(count):
        for j in range(count):
            value = float(c.correlation[i, j])
            text, dark = ("?" if np.isnan(value) else f"{value:.2f}"), abs(value) > 0.6
            axes.text(
                j, i, text, ha="center", va="center", fontsize=8, color="white" if dark else "black"
            )
    axes.set_xticks(range(count), names, rotation=40, ha="right", fontsize=8)
    axes.set_yticks(range(count), names, fontsize=8)
    figure.colorbar(drawn, ax=axes, shrink=0.8, label="correlation")
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
