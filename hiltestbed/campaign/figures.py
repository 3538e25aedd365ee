"""Pictures of a campaign: the response over two keys with the stability boundary over it, and distributions."""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed.campaign.boundary import applies, margin
from hiltestbed.campaign.schema import LoadedCampaign, Variation
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.report import new_figure
from hiltestbed.scenario import Scenario, scenario_from
from hiltestbed.validation import unit_of

HARMLESS = ("approach.gap", "approach.velocity", "sensor.noise", "sensor.torque_noise", "identification", "seed", "duration", "name")
MESH = 24  # points a side at which the boundary is judged


UNITS = {"energy_generated": "J", "peak_force": "N", "contact_duration": "s", "tracking_error": "m"}


def heat_map(campaign: LoadedCampaign, keys: tuple[str, str], inputs: tuple[Array, Array], figures: dict[str, Array], name: str):
    """The mean of figure `name` over two keys, `(n,)` each, with the boundary where it applies: (matplotlib figure, boundary drawn)."""
    picture, axes = new_figure(8.0, 5.2)
    (x_edges, x_log), (y_edges, y_log) = (_edges(campaign.spec.vary[key], values) for key, values in zip(keys, inputs, strict=True))
    mean = _cell_means(inputs, (x_edges, y_edges), figures[name])
    limit = float(np.quantile(np.abs(mean.compressed()), 0.98)) if mean.count() else 0.0
    scale = {"vmin": -(limit or 1.0), "vmax": limit or 1.0, "cmap": "RdBu_r"} if name == "cor_log_error" else {"cmap": "viridis"}
    mesh = axes.pcolormesh(x_edges, y_edges, mean.T, **scale)
    picture.colorbar(mesh, ax=axes, label=with_unit(name))
    axes.set(xlabel=with_unit(keys[0]), ylabel=with_unit(keys[1]))
    axes.set(xscale="log" if x_log else "linear", yscale="log" if y_log else "linear")
    drawn = _draw_boundary(axes, campaign, keys, (x_edges, y_edges), (x_log, y_log))
    if drawn:
        _draw_neutral(axes, (x_edges, y_edges), _cell_means(inputs, (x_edges, y_edges), figures["cor"]))
        axes.set(xlim=(x_edges[0], x_edges[-1]), ylim=(y_edges[0], y_edges[-1]))
        axes.legend(loc="upper right", title="the rig gives energy beyond")
    return picture, drawn


def with_unit(name: str) -> str:
    """A figure or a scenario key with its unit in brackets, where it has one."""
    unit = UNITS.get(name) or unit_of(Scenario, name)
    return f"{name} [{unit}]" if unit else name


def _cell_means(inputs: tuple[Array, Array], edges: tuple[Array, Array], figure: Array):
    """Mean of the cases in each cell, masked where there is none."""
    good = np.isfinite(figure)
    places = [values[good] for values in inputs]
    counts = np.histogram2d(*places, bins=edges)[0]
    sums = np.histogram2d(*places, bins=edges, weights=figure[good])[0]
    return np.ma.masked_invalid(np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0))


def _draw_neutral(axes: Any, edges: tuple[Array, Array], cor: Any) -> None:
    """Where the cases themselves return the speed that they came with."""
    x, y = (np.sqrt(e[1:] * e[:-1]) if e[0] > 0 else 0.5 * (e[1:] + e[:-1]) for e in edges)
    if cor.count() and cor.min() < 1.0 < cor.max() and min(cor.shape) > 2:
        axes.contour(x, y, cor.T, levels=[1.0], colors="#0a7d32", linestyles=":", linewidths=2.4)
        axes.plot([], [], color="#0a7d32", linestyle=":", linewidth=2.4, label="e = 1 in the cases")


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
    return True


def distributions(figures: dict[str, Array]):
    """Histograms of the named figures, each `(n,)`, the middle 99 % of each."""
    picture, axes = new_figure(9.0, 2.6 * ((len(figures) + 2) // 3), nrows=(len(figures) + 2) // 3, ncols=3, squeeze=False)
    for axis, (name, values) in zip(axes.flat, figures.items(), strict=False):
        good = values[np.isfinite(values)]
        if good.size:
            low, high = np.quantile(good, [0.005, 0.995])
            axis.hist(good, bins=40, range=(low, high if high > low else low + 1e-9 + abs(low)), color="#0b6e99")
        axis.set(xlabel=with_unit(name), yticks=[])
    for axis in list(axes.flat)[len(figures) :]:
        axis.set_visible(False)
    return picture
