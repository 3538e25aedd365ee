"""Figures of a campaign: the response over two keys, the stability boundary."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.build import runnable_from
from hiltestbed.campaign.columns import CaseGroup
from hiltestbed.campaign.schema import LoadedCampaign, Variation
from hiltestbed.config.validation import description_of
from hiltestbed.config.yaml_source import key_path
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.report.curves import PALETTE
from hiltestbed.report.page import new_figure
from hiltestbed.scenario import Scenario, resolved
from hiltestbed.sensor.parameters import SensorParameters

HARMLESS = (
    "approach.gap",
    "approach.velocity",
    "sensor.noise",
    "sensor.torque_noise",
    "identification",
    "seed",
    "duration",
    "name",
)
UNITS = {"energy_generated": "J", "peak_force": "N", "contact_duration": "s", "tracking_error": "m"}
# |ln(e/e_ref)| up to which the colour scale is linear: 1 % of the rebound speed
LINEAR_BELOW = 0.01
MESH = 24  # points per side at which the boundary is evaluated
BANDS = 16  # parts of a key over which a band is drawn


def heat_maps(
    campaign: LoadedCampaign,
    keys: tuple[str, str],
    inputs: tuple[Array, Array],
    figures: dict[str, Array],
    name: str,
    choices: Sequence[CaseGroup],
    worst: bool = False,
):
    """Figure `name` over two keys, `(n,)` each, one map per choice, on one colour scale:
    (matplotlib figure, boundary drawn).

    A cell shows the mean of its cases, or with ``worst`` the value of largest magnitude. The
    boundary is drawn where it applies.
    """
    columns = 2 if len(choices) == 4 else min(3, len(choices))
    lines = -(-len(choices) // columns)
    size = (8.0, 5.2) if len(choices) == 1 else (3.6 * columns + 1.0, 3.1 * lines)
    picture, axes = new_figure(
        *size, nrows=lines, ncols=columns, squeeze=False, sharex=True, sharey=True
    )
    spans = [
        _edges(campaign.spec.vary[key], values) for key, values in zip(keys, inputs, strict=True)
    ]
    (x_edges, x_log), (y_edges, y_log) = spans
    edges = (x_edges, y_edges)

    def cells_of(choice: CaseGroup, name: str, worst: bool) -> Any:
        mine = choice.cases
        return _cells((inputs[0][mine], inputs[1][mine]), edges, figures[name][mine], worst)

    cells = [cells_of(choice, name, worst) for choice in choices]
    filled = np.concatenate([np.abs(cell.compressed()) for cell in cells])
    limit = (float(np.quantile(filled, 0.98)) if filled.size else 0.0) or 1.0
    lowest = min((float(cell.min()) for cell in cells if cell.count()), default=0.0)
    scale: dict[str, Any] = {"vmin": lowest, "vmax": limit, "cmap": "cividis"}
    if name == "cor_log_error":
        from matplotlib.colors import SymLogNorm

        limit = max(limit, 2.0 * LINEAR_BELOW)
        norm = SymLogNorm(LINEAR_BELOW, vmin=-limit, vmax=limit, base=10)
        scale = {"norm": norm, "cmap": "RdBu_r"}
    boundary = _boundary(campaign, keys, edges, (x_log, y_log))
    for axis, choice, cell in zip(axes.flat, choices, cells, strict=False):
        mesh = axis.pcolormesh(x_edges, y_edges, cell.T, **scale)
        _scale(axis.xaxis, x_log, x_edges)
        _scale(axis.yaxis, y_log, y_edges)
        axis.set(xlim=(x_edges[0], x_edges[-1]), ylim=(y_edges[0], y_edges[-1]))
        axis.set_title(textwrap.fill(choice.label, 34), fontsize=9)
        if boundary is not None:
            x, y, margins = boundary
            labels = ("contact that stays closed", "one bounce, e = 1")
            for level, style, label in zip(margins, ("-", "--"), labels, strict=True):
                line = {"colors": "black", "linestyles": style, "linewidths": 1.6}
                axis.contour(x, y, level, levels=[0.0], **line)
                axis.plot([], [], "k" + style, label=label)
            _draw_neutral(axis, edges, cells_of(choice, "cor", worst=False))
    _hide(axes, len(choices))
    # the lowest map of each column
    for axis in list(axes.flat)[max(0, len(choices) - columns) : len(choices)]:
        axis.set_xlabel(with_unit(keys[0], campaign))
        axis.tick_params(labelbottom=True)
    for axis in axes[:, 0]:
        axis.set_ylabel(with_unit(keys[1], campaign))
    if boundary is not None:
        axes[0, 0].legend(loc="upper right", title="the rig adds energy beyond", fontsize=8)
    extend = "both" if filled.size and filled.max() > limit else "neither"
    picture.colorbar(mesh, ax=axes, label=with_unit(name), extend=extend)
    return picture, boundary is not None


def marginals(
    campaign: LoadedCampaign,
    inputs: dict[str, Array],
    figure: Array,
    name: str,
    choices: Sequence[CaseGroup],
):
    """Median and 5 to 95 % band of a figure ``(n,)`` over each key alone, one line per choice."""
    columns = min(3, len(inputs))
    lines = -(-len(inputs) // columns)
    picture, axes = new_figure(
        3.6 * columns + 0.6, 2.9 * lines, nrows=lines, ncols=columns, squeeze=False, sharey=True
    )
    for axis, (key, values) in zip(axes.flat, inputs.items(), strict=False):
        edges, log = _edges(campaign.spec.vary[key], values, BANDS)
        for i, choice in enumerate(choices):
            good = choice.cases & np.isfinite(figure)
            x, y, cell = values[good], figure[good], _cell(edges, values[good])
            filled = [
                (float(np.median(x[cell == k])), *np.quantile(y[cell == k], [0.05, 0.5, 0.95]))
                for k in np.unique(cell)
            ]
            if filled:
                at, low, middle, high = np.array(filled).T
                color = PALETTE[i % len(PALETTE)]
                axis.fill_between(at, low, high, color=color, alpha=0.15, linewidth=0)
                axis.plot(at, middle, "o-", color=color, markersize=2.5, label=choice.label)
        _scale(axis.xaxis, log, edges)
        axis.set(xlabel=with_unit(key, campaign))
        if name == "cor_log_error":
            axis.axhline(0.0, color="#8894a0", linewidth=0.8)
    _hide(axes, len(inputs))
    for axis in axes[:, 0]:
        axis.set_ylabel(with_unit(name))
    if len(choices) > 1:
        picture.legend(
            *axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
        )
    return picture


def _hide(axes: np.ndarray, used: int) -> None:
    """Hide the panels beyond the first ``used``."""
    for axis in list(axes.flat)[used:]:
        axis.set_visible(False)


def _cell(edges: Array, values: Array) -> np.ndarray:
    """Index of the cell between two ``edges`` for each value."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _scale(axis: Any, log: bool, edges: Array) -> None:
    """A linear scale with few ticks, or a logarithmic one, denser for less than a decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    if not log:
        axis.set_major_locator(MaxNLocator(6))
        return
    getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
    wide = edges[-1] > 8.0 * edges[0]
    subs = (1.0, 2.0, 5.0) if wide else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)

    def text(value: float, _: int) -> str:
        return f"{value:g}" if 1e-3 <= value < 1e4 else f"{value:.0e}".replace("e+0", "e")

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(text))


def with_unit(name: str, campaign: LoadedCampaign | None = None) -> str:
    """A figure, or a scenario key of a campaign, with its unit, if any, in brackets."""
    unit = UNITS.get(name, "")
    if not unit and campaign is not None:
        described = description_of(Scenario, resolved(campaign.nominal), key_path(name))
        unit = described.partition("[")[2].partition("]")[0]
    return f"{name} [{unit}]" if unit and unit != "-" else name


def _cells(inputs: tuple[Array, Array], edges: tuple[Array, Array], figure: Array, worst: bool):
    """Mean of the cases in each cell, or the value of largest magnitude; masked in empty cells."""
    good = np.isfinite(figure)
    places = [values[good] for values in inputs]
    if worst:
        at = [_cell(e, p) for e, p in zip(edges, places, strict=True)]
        cells = np.full((len(edges[0]) - 1, len(edges[1]) - 1), np.nan)
        order = np.argsort(np.abs(figure[good]), kind="stable")
        # of several in one cell the last assignment wins: the largest
        cells[at[0][order], at[1][order]] = figure[good][order]
        return np.ma.masked_invalid(cells)
    counts = np.histogram2d(*places, bins=edges)[0]
    sums = np.histogram2d(*places, bins=edges, weights=figure[good])[0]
    return np.ma.masked_array(sums, counts == 0) / np.maximum(counts, 1)


def _draw_neutral(axes: Any, edges: tuple[Array, Array], cor: Any) -> None:
    """The line where the cases themselves have e = 1."""
    x, y = (np.sqrt(e[1:] * e[:-1]) if e[0] > 0 else 0.5 * (e[1:] + e[:-1]) for e in edges)
    if cor.count() and cor.min() < 1.0 < cor.max() and min(cor.shape) > 2:
        axes.contour(x, y, cor.T, levels=[1.0], colors="black", linestyles=":", linewidths=2.4)
        axes.plot([], [], color="black", linestyle=":", linewidth=2.4, label="e = 1 in the cases")


def _edges(variation: Variation, values: Array, most: int = 64) -> tuple[Array, bool]:
    """Edges of the cells along a key, from its lowest to its highest value; whether logarithmic."""
    levels = np.unique(values)
    log = variation.log_uniform is not None or bool(
        levels[0] > 0 and levels.size > 2 and np.ptp(np.diff(np.log(levels))) < 1e-6
    )
    if levels.size == 1:
        return levels[0] + np.array([-0.5, 0.5]) * (abs(levels[0]) or 1.0), False
    if levels.size <= most:
        places = np.log(levels) if log else levels
        middles = 0.5 * (places[1:] + places[:-1])
        inner = np.exp(middles) if log else middles
        return np.concatenate([levels[:1], inner, levels[-1:]]), log
    cells = int(np.clip(np.sqrt(values.size) / 3, 8, min(40, most)))
    return (np.geomspace if log else np.linspace)(
        levels[0], levels[-1] * (1 + 1e-12), cells + 1
    ), log


def _boundary(
    campaign: LoadedCampaign,
    keys: tuple[str, str],
    edges: tuple[Array, Array],
    logs: tuple[bool, bool],
):
    """(x, y, margins (2, MESH, MESH)) of the closed forms, zero where the rig starts to add energy;
    None if they do not apply or no boundary lies within the edges.
    """
    others = [key for key in campaign.spec.vary if key not in keys]
    if not boundary_applies(campaign.nominal) or not all(
        key.startswith(HARMLESS) for key in others
    ):
        return None
    x, y = (
        (np.geomspace if log else np.linspace)(e[0], e[-1], MESH)
        for e, log in zip(edges, logs, strict=True)
    )
    margins = np.full((2, MESH, MESH), np.nan)
    for j, i in np.ndindex(MESH, MESH):
        try:
            changed = {keys[0]: float(x[i]), keys[1]: float(y[j])}
            scenario = runnable_from(campaign.source, changed)
            margins[:, j, i] = boundary_margin(scenario) if boundary_applies(scenario) else np.nan
        except InputError:
            continue
    return (x, y, margins) if np.nanmin(margins) < 0 < np.nanmax(margins) else None


def boundary_applies(scenario: Scenario) -> bool:
    """Whether the closed forms hold: linear contact, pure delay, bare loop, ideal tracking."""
    sensor = scenario.sensor
    return (
        scenario.mechanism.flat
        and scenario.rig.platform.tracking == "ideal"
        and scenario.compensation.force.kind == "none"
        and sensor.lowpass is None
        and sensor.time_constant is None
        and not any(scenario.approach.offset)
        and all(
            effect.kind in ("sensor.delay", "contact.stiffness", "contact.damping")
            for effect in scenario.effects
        )
    )


def boundary_margin(scenario: Scenario) -> tuple[float, float]:
    """The delay beyond the limits of closed contact and bounce [s]; positive: energy is added."""
    delay = SensorParameters.believed(scenario.sensor).with_effects(scenario.effects).delay
    contact = SpringDamper(*acting_along_z(scenario.impact), effective_mass(scenario.spacecraft))
    return delay - contact.critical_delay, delay - contact.neutral_delay
