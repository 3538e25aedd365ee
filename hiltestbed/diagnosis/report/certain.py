"""The section of the report on the uncertainty of the estimates: profiles, correlations, bounds
that were met.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.diagnosis.certainty import Certainty, Profile
from hiltestbed.diagnosis.plain import LINK_NAMES
from hiltestbed.diagnosis.report.pictures import EXTENDED, FLOOR, NOMINAL
from hiltestbed.report.page import Report, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CHI2_95 = 3.84  # derived: of chi-square, 95 % of one parameter
PROFILE_TOP = 5.0  # chosen: times CHI2_95: up to which a profile is drawn
STRONG_CORRELATION = 0.95  # chosen: from which one estimate means nothing without the other
PROFILES_PER_ROW = 3  # in the figure


def certainty_section(report: Report, certainties: Sequence[Certainty]) -> None:
    """Add the section; nothing where no effect was fitted."""
    profiles = [p for c in certainties for p in c.profiles]
    if not profiles:
        return
    report.heading("Uncertainty of the estimates")
    for sentence in (*bounds_met(profiles), *tied(certainties)):
        report.text(sentence)
    report.figure(
        profile_figure(profiles),
        "Cost of holding a parameter at another value while the other parameters of its link "
        "follow: chi-square above its minimum, in units of the misfit per sample. Dashed: 3.84, "
        "the 95 % of an exact model. Shaded: the 95 % interval, which is wider where the runs "
        "contradict each other or the noise is correlated. Hatched: beyond the bounds of the "
        "search.",
    )
    for c in certainties:
        if len(c.profiles) > 1:
            report.figure(
                correlation_figure(c),
                f"Correlation of the estimates on the link {LINK_NAMES.get(c.link, c.link)}: near "
                "1 or -1 the data determine a combination of the two, not each by itself.",
            )


def bounds_met(profiles: Sequence[Profile]) -> list[str]:
    """A sentence for each estimate at a bound of the search."""
    out = []
    for p in profiles:
        if p.met is not None:
            at, unit = (
                p.bounds[0 if p.met == "lowest" else 1],
                "" if p.unit == "-" else f" {p.unit}",
            )
            out.append(
                f"{p.label} is at the {p.met} value that was searched, {at:.4g}{unit}: the data "
                "favour a value beyond it, which means another effect, or a size that was not "
                "thought possible. Its estimate is not reliable."
            )
    return out or ["No estimate is at a bound of its search."]


def tied(certainties: Sequence[Certainty]) -> list[str]:
    """A sentence for the most correlated pair of estimates of each link."""
    out = []
    for c in certainties:
        if (pair := c.strongest()) is not None:
            a, b, size = pair
            then = (
                "only a combination of them is determined"
                if abs(size) >= STRONG_CORRELATION
                else "each is determined by itself"
            )
            alike = (
                f"The most correlated estimates on the link "
                f"{LINK_NAMES.get(c.link, c.link)} are {a.label} and {b.label}"
            )
            out.append(f"{alike}, at {size:+.3f}: {then}.")
    return out


def profile_figure(profiles: Sequence[Profile]) -> Figure:
    """The cost against the value of each parameter."""
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
