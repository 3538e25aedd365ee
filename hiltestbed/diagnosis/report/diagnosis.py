"""Stage "report": from a `Finding` to the `Diagnosis` that `diagnose` returns: the extended model,
both models in closed loop, the next experiment; and its folder (diagnosis.json, report.html,
extended.yaml, recording.rrd).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiltestbed.build import runnable_from
from hiltestbed.config.dataset import label_of
from hiltestbed.diagnosis.closed_loop import closed_loop, simulate_runs
from hiltestbed.diagnosis.next_run import next_experiment
from hiltestbed.diagnosis.plain import finite
from hiltestbed.diagnosis.report.evidence import channel_residuals
from hiltestbed.diagnosis.report.page import report_of
from hiltestbed.diagnosis.report.sentence import (
    learned_sentence,
    partial_sentence,
    verdict_sentence,
)
from hiltestbed.diagnosis.result import Cause, Conclusion, Finding, Learned
from hiltestbed.effects.table import EFFECTS
from hiltestbed.errors import MissingExtra
from hiltestbed.measured import MeasuredDataset
from hiltestbed.measured.remark import overrides
from hiltestbed.run_folder.folders import html_table
from hiltestbed.run_folder.store import RECORDING, whole_folder
from hiltestbed.run_folder.versions import versions
from hiltestbed.scenario import Scenario, dump_scenario, resolved

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIAGNOSIS, REPORT, EXTENDED = "diagnosis.json", "report.html", "extended.yaml"


class Diagnosis(Conclusion):
    """The result of `diagnose`: what the folder holds, and the data of its figures; attributes as
    of :class:`~hiltestbed.diagnosis.result.Conclusion`.
    """

    def __repr__(self) -> str:
        causes = ", ".join(cause.effect for cause in self.causes) or "no cause"
        return f"Diagnosis({self.name}: {self.verdict}, {causes})"

    def _repr_html_(self) -> str:
        rows = [
            (cause.effect, name, p.in_words(), f"{cause.probability:.2f}")
            for cause in self.causes
            for name, p in cause.parameters.items()
        ]
        header = ("cause", "parameter", "estimate (95 % interval)", "probability")
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
            (c.effect, name, p.estimate, p.ci95, p.unit, c.probability)
            for c in self.causes
            for name, p in c.parameters.items()
        ]
        columns = ["cause", "parameter", "estimate", "ci95", "unit", "probability"]
        return pd.DataFrame(rows, columns=columns)

    def plot(self, channel: str | None = None, axes: Axes | None = None) -> Axes:
        """A channel as measured and as predicted by its link, nominal and extended, in the run with
        the largest nominal misfit; by default the channel with the largest one.

        Raises:
            InputError: no such channel, or no link could be judged.
        """
        from hiltestbed.diagnosis.report.pictures import plot_channel  # loads Matplotlib

        return plot_channel(self.finding.series, self.compared, self.dataset.names, channel, axes)

    def to_json(self) -> dict[str, Any]:
        """The contents of diagnosis.json: plain data without infinities."""
        f = self.finding
        learned = f.learned and f.learned.to_json() | {"sentence": learned_sentence(f.learned)}
        partial = {
            "sentence": partial_sentence(f.partial, f.partial_gain),
            "causes": [c.to_json() for c in f.partial],
            "heldout": f.partial_gain and f.partial_gain.to_json(),
        }
        out = {
            "name": self.name,
            "verdict": self.verdict,
            "sentence": verdict_sentence(self),
            "link": self.link,
            "causes": [c.to_json() for c in self.causes],
            "not_judged": dict(f.not_judged),
            "left": f.left or None,
            "explained": f.explained,
            "learned": learned,
            "partial": partial,
            "residuals": [vars(r) for r in self.residuals],
            "heldout": self.heldout and self.heldout.to_json(),
            "closed_loop": self.closed_loop.to_json(),
            "next_experiment": self.next_experiment,
            "next_experiment_runs": self.experiment.runs if self.experiment else [],
            "extended_scenario": EXTENDED if f.extends else None,
            "ranking": [vars(r) for r in f.ranking],
            "certainty": [c.to_json() for c in f.certainty],
            "timing": [vars(t) for t in f.timing],
            "overridden": self.overridden,
            "unsized": dict(f.unsized),
            "isolability": [vars(i) for i in f.isolability],
            "remarks": self.remarks,
            "seconds": self.seconds,
            "versions": versions(),
        }
        return finite(out)

    def write(self, folder: str | Path) -> Path:
        """Write the diagnosis folder, which is complete if it exists, and return its path. Raises
        InputError where it cannot be written, or holds something else.
        """
        from hiltestbed.diagnosis.report.recording import write_diagnosis_recording  # rerun

        path, data = Path(folder), json.dumps(self.to_json(), indent=2, allow_nan=False)
        with whole_folder(path, mark=DIAGNOSIS) as new:
            (new / DIAGNOSIS).write_text(data + "\n", encoding="utf-8")
            text = extended_yaml(self.extended, self.finding.extension)
            (new / EXTENDED).write_text(text, encoding="utf-8")
            report_of(self).write(new / REPORT)
            write_diagnosis_recording(new / RECORDING, self)
        return path


def conclude(dataset: MeasuredDataset, finding: Finding, seconds: float | None = None) -> Diagnosis:
    """The diagnosis of a dataset; `seconds`: elapsed so far."""
    causes = finding.extension
    simulated = simulate_runs(dataset, causes)
    notes = [
        *finding.assumed,
        *(f"{link} was not judged: {why}" for link, why in finding.not_judged.items()),
        *(str(remark) for remark in dataset.remarks),
    ]
    for p in simulated:
        refused = "nominal" if p.nominal is None else "extended" if p.extended is None else ""
        if refused:
            notes.append(f"{dataset.names[p.run]}: the {refused} simulation could not be run")
    return Diagnosis(
        name=dataset.spec.name or label_of(dataset.path),
        finding=finding,
        residuals=channel_residuals(finding.series, finding.noise, bool(causes or finding.partial)),
        closed_loop=closed_loop(dataset, simulated),
        experiment=next_experiment(finding, dataset),
        extended=extended_scenario(dataset.nominal, causes),
        dataset=dataset,
        simulated=simulated,
        remarks=tuple(notes),
        overridden=overrides(dataset.remarks),
        seconds=seconds,
    )


def extended_scenario(nominal: Scenario, causes: Sequence[Cause | Learned]) -> Scenario:
    """`nominal` with the causes added to its effects; `nominal` itself where there are none.

    Raises:
        InputError: an estimate lies outside what its effect allows.
    """
    if not causes:
        return nominal
    data = resolved(nominal)
    data["effects"] = [*data["effects"], *(cause.entry() for cause in causes)]
    names = ", ".join(f"{c.effect} ({EFFECTS[c.effect].meaning().rstrip('.')})" for c in causes)
    data["description"] = f"{nominal.description} Extended with {names}.".strip()
    return runnable_from(data)


def extended_yaml(scenario: Scenario, causes: Sequence[Cause | Learned]) -> str:
    """The text of extended.yaml: the scenario, with the intervals of the estimates as a comment at
    the top.
    """
    if not causes:
        return "# Nothing was named: this is the nominal scenario.\n" + dump_scenario(scenario)
    named = [c for c in causes if isinstance(c, Cause)]
    lines = ["# Named by hiltestbed diagnose; estimate and 95 % interval:"] if named else []
    for c in named:
        lines += [f"#   {c.effect} {name}: {p.in_words()}" for name, p in c.parameters.items()]
    lines += [
        f"# Learned by hiltestbed diagnose: {c.effect}, {c.numbers} numbers"
        for c in causes
        if isinstance(c, Learned)
    ]
    return "\n".join(lines) + "\n" + dump_scenario(scenario)
