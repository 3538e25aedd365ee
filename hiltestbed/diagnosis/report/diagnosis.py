"""What `diagnose` returns: a conclusion that can be shown, plotted and written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiltestbed.diagnosis.conclusion import Conclusion
from hiltestbed.errors import MissingExtra

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Diagnosis(Conclusion):
    """The result of `diagnose`: what the folder holds, and the data of its figures.

    Attributes:
        finding: verdict, link, causes, evidence. residuals, closed_loop, experiment: what follows
            from it.
        dataset, extended: the data, and the scenario with the named effects (the nominal one where
            nothing was named).
        simulated: the simulations of each run.
    """

    def __repr__(self) -> str:
        causes = ", ".join(cause.effect for cause in self.causes) or "no cause"
        return f"Diagnosis({self.name}: {self.verdict}, {causes})"

    def _repr_html_(self) -> str:
        from hiltestbed.run_folder.folders import html_table

        rows = [
            (cause.effect, name, p.text(), p.unit, f"{cause.probability:.2f}")
            for cause in self.causes
            for name, p in cause.parameters.items()
        ]
        header = ("cause", "parameter", "estimate and 95 % interval", "unit", "probability")
        return html_table(f"{self.name}: {self.verdict}", header, rows, self.next_experiment or "")

    def to_pandas(self) -> Any:
        """A DataFrame, a row a parameter of a cause: estimate, 95 % interval, unit, probability.
        Raises MissingExtra.
        """
        try:
            import pandas as pd
        except ImportError:
            raise MissingExtra("to_pandas()", "pandas") from None
        rows = [
            {
                "cause": c.effect,
                "parameter": name,
                "estimate": p.estimate,
                "ci95": p.ci95,
                "unit": p.unit,
                "probability": c.probability,
            }
            for c in self.causes
            for name, p in c.parameters.items()
        ]
        return pd.DataFrame(
            rows, columns=["cause", "parameter", "estimate", "ci95", "unit", "probability"]
        )

    def plot(self, channel: str | None = None, axes: Axes | None = None) -> Axes:
        """A channel as measured and as predicted by its link, nominal and extended, in the run with
        the largest nominal misfit.

        Args:
            channel: by default the one with the largest misfit.

        Raises:
            InputError: no such channel, or no link could be judged.
        """
        from hiltestbed.diagnosis.report.pictures import plot_channel  # loads Matplotlib

        return plot_channel(self.finding.series, self.compared, self.dataset.names, channel, axes)

    def to_json(self) -> dict[str, Any]:
        """The contents of diagnosis.json: plain data without infinities."""
        from hiltestbed.diagnosis.report.folder import diagnosis_json

        return diagnosis_json(self)

    def write(self, folder: str | Path) -> Path:
        """Write the diagnosis folder. Raises InputError where it cannot be written."""
        from hiltestbed.diagnosis.report.folder import write_diagnosis

        return write_diagnosis(self, folder)
