"""Runs side by side: the keys in which their scenarios differ, and the effect on the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiltestbed.errors import InputError, of_extra, printable
from hiltestbed.report.curves import PALETTE
from hiltestbed.run_folder.folders import html_table, number
from hiltestbed.run_folder.result import Run
from hiltestbed.run_folder.store import read_run
from hiltestbed.scenario import resolved

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURES = {  # figure of the summary, by its dotted keys, to its unit
    "cor": "",
    "cor_reference": "",
    "cor_log_error": "",
    "energy_generated": "J",
    "peak_force": "N",
    "contact_duration": "s",
    "tracking_error": "m",
    "stability.net_damping": "N s/m, N m s/rad",  # the latter if the direction is a rotation
    "stability.largest_delay": "s",
}
TEXTS = ("status", "outcome", "stability.direction")
SILENT = ("name", "description")  # keys without influence on a run


@dataclass(frozen=True, repr=False)
class Comparison:
    """Runs in columns.

    Attributes:
        names: of the runs, made unique. runs: the runs.
        differences: dotted scenario key to its value in each run; only keys in which they differ.
        figures: figure of the summary to its value in each run.
    """

    names: tuple[str, ...]
    runs: tuple[Run, ...]
    differences: dict[str, list[Any]]
    figures: dict[str, list[Any]]

    def __repr__(self) -> str:
        return (
            f"Comparison({', '.join(self.names)}; different: "
            f"{', '.join(self.differences) or 'nothing'})"
        )

    def _repr_html_(self) -> str:
        return html_table("Runs side by side", ("", *self.names), self.rows())

    def rows(self) -> list[list[str]]:
        """Every row as text: the keys that differ, then the figures."""
        texts = self.differences | {n: v for n, v in self.figures.items() if n in TEXTS}
        words = [
            [key, *("-" if v is None else str(v) for v in values)] for key, values in texts.items()
        ]
        numbers = [
            [f"{name} [{FIGURES[name]}]" if FIGURES[name] else name, *(number(v) for v in values)]
            for name, values in self.figures.items()
            if name in FIGURES
        ]
        passive = ["energy", *(run.assessment.energy for run in self.runs)]
        return [*words, *numbers, passive]

    def to_pandas(self) -> Any:
        """A DataFrame with one row per run. Raises MissingExtra."""
        pd = of_extra("pandas", "to_pandas()", "pandas")
        return pd.DataFrame(self.differences | self.figures, index=pd.Index(self.names, name="run"))

    def plot(self, column: str = "wrench_true.fz", axes: Axes | None = None) -> Axes:
        """A column of every run's trace. Raises UnknownColumn; ValueError without a trace."""
        for i, (name, run) in enumerate(zip(self.names, self.runs, strict=True)):
            axes = run.plot(column, axes=axes)
            line = axes.lines[-1]
            line.set(label=name, color=PALETTE[i % len(PALETTE)])
        assert axes is not None  # there are at least two runs
        axes.set_title(column)
        axes.legend(loc="best", fontsize=8)
        return axes


def compare(runs: Sequence[Run | str | Path]) -> Comparison:
    """Put runs, or run folders, side by side.

    Raises:
        InputError: fewer than two, or a folder without a run.
    """
    if len(runs) < 2:
        raise InputError(f"compare: too few runs (got {len(runs)}); allowed are two or more")
    read = tuple(run if isinstance(run, Run) else read_run(run) for run in runs)
    flat = [_flat(resolved(run.scenario)) for run in read]
    keys = [key for key in dict.fromkeys(key for one in flat for key in one) if key not in SILENT]
    differences = {
        key: [one.get(key) for one in flat]
        for key in keys
        if any(one.get(key) != flat[0].get(key) for one in flat[1:])
    }
    figures = {name: [_figure(run.summary, name) for run in read] for name in (*TEXTS, *FIGURES)}
    labels = [
        run.summary["name"] if isinstance(given, Run) else printable(Path(given).name)
        for given, run in zip(runs, read, strict=True)
    ]
    names = (
        label if not (before := labels[:i].count(label)) else f"{label} ({before + 1})"
        for i, label in enumerate(labels)
    )
    return Comparison(tuple(names), read, differences, figures)


def _flat(data: Any, path: str = "") -> dict[str, Any]:
    """Nested data as dotted key to value; lists of numbers stay whole."""
    if isinstance(data, Mapping):
        items = data.items()
    elif isinstance(data, list) and any(isinstance(v, Mapping) for v in data):
        items = enumerate(data)
    else:
        return {path: data}
    return {
        key: value
        for name, below in items
        for key, value in _flat(below, f"{path}.{name}" if path else str(name)).items()
    }


def _figure(summary: Mapping[str, Any], name: str) -> Any:
    """The figure with the dotted ``name``; None if a part of the path is None or absent."""
    found: Any = summary
    for key in name.split("."):
        found = None if found is None else found.get(key)
    return found


def write_comparison(comparison: Comparison, path: Path) -> None:
    """The comparison as one HTML page with the contact forces over time.

    Raises:
        InputError: the page cannot be written.
    """
    from hiltestbed.report.page import Report, new_figure

    report = Report("Runs side by side")
    changed = ", ".join(comparison.differences) or "nothing but the name"
    report.lead(f"{len(comparison.runs)} runs that differ in {changed}.")
    report.table(("", *comparison.names), comparison.rows())
    for name, run in zip(comparison.names, comparison.runs, strict=True):
        for warning in run.assessment.warnings:
            report.text(f"{name}: {warning}.")
    if all(run.trace is not None for run in comparison.runs):
        for column in ("wrench_true.fz", "pose_act.pz"):
            figure, axes = new_figure(8.0, 3.4)
            comparison.plot(column, axes=axes)
            report.figure(figure, f"{column} of every run; shaded: in contact.")
    try:
        report.write(path)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose another --out"
        ) from None
