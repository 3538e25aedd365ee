"""A run as returned to the user: scenario, summary, trace, and methods to evaluate them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hiltestbed.analysis.assessment import Assessment, assess, figures_of
from hiltestbed.run_folder.folders import html_table, number
from hiltestbed.scenario import Scenario
from hiltestbed.signals import RunTrace
from hiltestbed.supervision.snapshot import Snapshot

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(repr=False)
class Run:
    """One run: the content of a run folder.

    Attributes:
        scenario: as it was run.
        summary: the contents of summary.json.
        trace: the rows, or None if none was kept.
        failure: the state some ticks before a divergence or a stop, from which that can be
            replayed.
    """

    scenario: Scenario
    summary: dict[str, Any]
    trace: RunTrace | None = None
    failure: Snapshot | None = None

    @property
    def assessment(self) -> Assessment:
        """Assessment of the figures: passive or active, warnings, what to do next."""
        return assess(self.summary)

    def __repr__(self) -> str:
        s = self.summary
        rows = "no trace" if self.trace is None else f"{len(self.trace.t)} rows"
        figures = f"cor {number(s['cor'])} (reference {number(s['cor_reference'])})"
        return f"Run({s['name']}: {s['status']}, {s['outcome']}, {figures}, {rows})"

    def _repr_html_(self) -> str:
        s = self.summary
        rows = figures_of(s)
        return html_table(
            f"{s['name']}: {s['status']}", (), rows, "; ".join(self.assessment.warnings)
        )

    def plot(self, *columns: str, axes: Axes | None = None) -> Axes:
        """Columns or groups of the trace over time (left out: the contact force along z, true,
        measured and used).

        Raises:
            InputError: no such column. ValueError: the run has no trace.
        """
        axes = self._trace().plot(
            *(columns or ("wrench_true.fz", "wrench_meas.fz", "wrench_comp.fz")), axes=axes
        )
        axes.set_title(self.summary["name"])
        return axes

    def to_pandas(self):
        """The trace as a pandas DataFrame over time, see :meth:`RunTrace.to_pandas`."""
        frame = self._trace().to_pandas()
        frame.attrs["name"] = self.summary["name"]
        return frame

    def to_xarray(self):
        """The trace as an xarray Dataset, see :meth:`RunTrace.to_xarray`."""
        dataset = self._trace().to_xarray()
        dataset.attrs["name"] = self.summary["name"]
        return dataset

    def _trace(self) -> RunTrace:
        if self.trace is None:
            raise ValueError(
                "the run has no trace: run it with hiltestbed.run, or read a folder with "
                "trace.parquet"
            )
        return self.trace
