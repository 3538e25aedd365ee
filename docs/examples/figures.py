"""The figures of docs/real-data.md, from what `hiltestbed diagnose` makes of the two examples
beside this file.

    HILTESTBED_DATA=... python docs/examples/figures.py [so101_servo] [friction_damper]

Writes the diagnosis folders to results/ and the pictures to docs/.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import hiltestbed
from hiltestbed.diagnosis.report.diagnosis import Diagnosis
from hiltestbed.diagnosis.report.pictures import (
    EXTENDED,
    MEASURED,
    NOMINAL,
    force_against_penetration,
    heldout_bars,
    learned_curves,
)
from hiltestbed.diagnosis.result import Series
from hiltestbed.report.page import new_figure

HERE = Path(__file__).resolve().parent
DOCS = HERE.parent
DPI = 80
ARM = 0.01  # [m] at which the servo's angle stands as an arc
# [s] of each run of the servo, and of the chirp's end
WINDOWS = {0: (8.0, 24.0), 1: (23.5, 26.5), 2: (95.0, 115.0)}
FAST = (112.0, 115.0)


def servo(diagnosis: Diagnosis) -> None:
    """The angle in a window of each motion: measured, nominal, best explanation."""
    series = {s.run: s for s in diagnosis.finding.series if s.channel == "pose_act.px"}
    panels = [
        (series[0], WINDOWS[0]),
        (series[0], FAST),
        (series[1], WINDOWS[1]),
        (series[2], WINDOWS[2]),
    ]
    figure, grid = new_figure(9.0, 5.4, nrows=2, ncols=2, squeeze=False)
    for axes, (s, window) in zip(grid.ravel(), panels, strict=True):
        _lines(axes, s, window, diagnosis.compared)
        axes.set_title(f"run {s.run}: {diagnosis.dataset.runs[s.run].record.file.stem}", fontsize=9)
    grid[0, 0].legend(fontsize=8, frameon=False)
    for axes in grid[:, 0]:
        axes.set_ylabel("angle [rad]")
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    figure.savefig(DOCS / "real-data-servo.png", dpi=DPI)


def _lines(axes, s: Series, window: tuple[float, float], compared: str) -> None:
    rows = (s.t >= window[0]) & (s.t <= window[1])
    for values, style in (
        (s.measured, {"color": MEASURED, "lw": 2.4, "alpha": 0.35, "label": "measured"}),
        (s.nominal, {"color": NOMINAL, "lw": 1.0, "label": "nominal"}),
        (s.extended, {"color": EXTENDED, "lw": 1.1, "ls": "--", "label": compared}),
    ):
        axes.plot(s.t[rows], values[rows] / ARM, **style)


def damper(diagnosis: Diagnosis) -> None:
    """Force against displacement of both records."""
    figure = force_against_penetration(
        diagnosis.finding.series, diagnosis.dataset, diagnosis.compared
    )
    if figure is not None:
        figure.set_size_inches(8.0, 3.8)
        figure.axes[0].get_legend().remove()
        figure.legend(
            *figure.axes[0].get_legend_handles_labels(),
            loc="outside upper center",
            ncols=3,
            fontsize=8,
            frameon=False,
        )
        for axes, run in zip(figure.axes, diagnosis.dataset.runs, strict=True):
            axes.set_title(run.record.file.stem, fontsize=9)
            axes.set_xlabel("displacement [mm]")
        figure.savefig(DOCS / "real-data-damper.png", dpi=DPI)


def gain(diagnosis: Diagnosis, name: str) -> None:
    """Each record's residual when it was left out of the fit, and the law where one was learned
    that carries over to other runs.
    """
    learned = diagnosis.finding.learned
    if learned is not None and not learned.carries_over:
        learned = None
    worth = learned.heldout if learned is not None else diagnosis.finding.partial_gain
    if worth is not None:
        heldout_bars(worth, diagnosis.dataset.names).savefig(
            DOCS / f"real-data-{name}-gain.png", dpi=DPI
        )
    if learned is not None:
        learned_curves(learned).savefig(DOCS / f"real-data-{name}-law.png", dpi=DPI)


EXAMPLES: Mapping = {"so101_servo": (servo, "servo"), "friction_damper": (damper, "damper")}


def main(names: list[str]) -> None:
    """The figures of the examples that are named, of both where none is."""
    for name in names or list(EXAMPLES):
        picture, short = EXAMPLES[name]
        diagnosis = hiltestbed.diagnose(HERE / name / "dataset.yaml")
        diagnosis.write(Path("results") / name)
        picture(diagnosis)
        gain(diagnosis, short)


if __name__ == "__main__":
    main(sys.argv[1:])
