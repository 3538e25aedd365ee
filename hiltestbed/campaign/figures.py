"""Pictures of a campaign: the response over two keys with the stability boundary over it, and distributions."""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed.campaign.boundary import applies, margin
from hiltestbed.campaign.schema import LoadedCampaign, Variation
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.report import new_figure
from hiltestbed.scenario import scenario_from

HARMLESS = ("approach.gap", "approach.velocity", "sensor.noise", "sensor.torque_noise", "identification", "seed", "duration", "name")
MESH = 24  # points a side at which the boundary is judged


def heat_map(campaign: LoadedCampaign, keys: tuple[str, str], inputs: tuple[Array, Array], figure: Array, name: str):
    """The mean of `figure` `(n,)` over two keys `(n,)` each, with the boundary where it applies: (matplotlib figure, boundary drawn)."""
    picture, axes = new_figure(8.0, 5.2)
    good = np.isfinite(figure)
    (x_edges, x_log), (y_edges, y_log) = (_edges(campaign.spec.vary[key], values) for key, values in zip(keys, inputs, strict=True))
    bins = (x_edges, y_edges)
    counts = np.histogram2d(inputs[0][good], inputs[1][good], bins=bins)[0]
    sums = np.histogram2d(inputs[0][good], inputs[1][good], bins=bins, weights=figure[good])[0]
    mean = np.ma.masked_invalid(np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0))
    signed = name.startswith("cor_log_error")
    limit = float(np.quantile(np.abs(mean.compressed()), 0.98)) if mean.count() else 1.0
    scale = {"vmin": -limit, "vmax": limit, "cmap": "RdBu_r"} if signed else {"cmap": "viridis"}
    mesh = axes.pcolormesh(x_edges, y_edges, mean.T, **scale)
    picture.colorbar(mesh, ax=axes, label=name)
    axes.set(xlabel=keys[0], ylabel=keys[1], xscale="log" if x_log else "linear", yscale="log" if y_log else "linear")
    drawn = _draw_boundary(axes, campaign, keys, (x_edges, y_edges), (x_log, y_log))
    return picture, drawn


def _edges(variation: Variation, values: Array) -> tuple[Array, bool]:
    """Edges of the cells along a key, and whether it goes by ratio."""
    levels = np.unique(values)
    log = variation.log_uniform is not None or bool(levels[0] > 0 and levels.size > 2 and np.ptp(np.diff(np.log(levels))) < 1e-6)
    if levels.size <= 64:
        places = np.log(levels) if log else levels
        middles = 0.5 * (places[1:] + places[:-1])
        first, last = (places[0] - 0.5, places[0] + 0.5) if levels.size == 1 else (2 * places[0] - middles[0], 2 * places[-1] - middles[-1])
        edges = np.concatenate([[first], middles, [last]])
        return (np.exp(edges) if log else edges), log
    cells = int(np.clip(np.sqrt(values.size) / 3, 8, 40))
    return (np.geomspace if log else np.linspace)(levels[0], levels[-1] * (1 + 1e-12), cells + 1), log


def _draw_boundary(axes: Any, campaign: LoadedCampaign, keys: tuple[str, str], edges: tuple[Array, Array], logs: tuple[bool, bool]) -> bool:
    """Contours where the closed forms say that the rig starts to give energy, other keys as in the campaign's scenario."""
    others = [key for key in campaign.spec.vary if key not in keys]
    if not applies(campaign.nominal) or not all(key.startswith(HARMLESS) for key in others):
        return False
    x, y = ((np.geomspace if log else np.linspace)(e[0], e[-1], MESH) for e, log in zip(edges, logs, strict=True))
    margins = np.full((2, MESH, MESH), np.nan)
    for i, first in enumerate(x):
        for j, second in enumerate(y):
            try:
                scenario = scenario_from(campaign.source, {keys[0]: float(first), keys[1]: float(second)})
                margins[:, j, i] = margin(scenario) if applies(scenario) else np.nan
            except (InputError, ValueError):
                continue
    if not (np.nanmin(margins) < 0 < np.nanmax(margins)):
        return False
    for level, style, label in zip(margins, ("-", "--"), ("contact that stays closed", "one bounce, e = 1"), strict=True):
        axes.contour(x, y, level, levels=[0.0], colors="black", linestyles=style, linewidths=1.6)
        axes.plot([], [], "k" + style, label=label)
    axes.legend(loc="upper right", title="rig gives energy beyond")
    return True


def distributions(figures: dict[str, Array]):
    """Histograms of the named figures, each `(n,)`, the middle 99 % of each."""
    picture, axes = new_figure(9.0, 2.6 * ((len(figures) + 2) // 3), nrows=(len(figures) + 2) // 3, ncols=3, squeeze=False)
    for axis, (name, values) in zip(axes.flat, figures.items(), strict=False):
        good = values[np.isfinite(values)]
        if good.size:
            low, high = np.quantile(good, [0.005, 0.995])
            axis.hist(good, bins=40, range=(low, high if high > low else low + 1e-9 + abs(low)), color="#0b6e99")
        axis.set(xlabel=name, yticks=[])
    for axis in list(axes.flat)[len(figures) :]:
        axis.set_visible(False)
    return picture
