"""Stage "report": from a `Finding` to the `Diagnosis`: the extended model, both models in closed
loop, the next experiment.
"""

from __future__ import annotations

from hiltestbed.diagnosis.closed_loop import closed_loop, simulate_runs
from hiltestbed.diagnosis.report.diagnosis import Diagnosis
from hiltestbed.diagnosis.report.evidence import channel_residuals
from hiltestbed.diagnosis.report.experiments import mass_of_either_body, next_experiment
from hiltestbed.diagnosis.report.extend import extended_scenario
from hiltestbed.diagnosis.result import Finding
from hiltestbed.measured import MeasuredDataset


def conclude(dataset: MeasuredDataset, finding: Finding, seconds: float | None = None) -> Diagnosis:
    """The diagnosis of a dataset; `seconds`: elapsed so far."""
    causes = finding.extension
    simulated = simulate_runs(dataset, causes)
    notes = (
        *(f"{link} was not judged: {why}" for link, why in finding.not_judged.items()),
        *(str(remark) for remark in dataset.remarks),
    )
    notes = (*finding.assumed, *notes)
    either = mass_of_either_body(finding, dataset)
    notes = (*notes, either) if either else notes
    refused = [
        f"{dataset.runs[p.run].name}: the nominal simulation could not be run"
        for p in simulated
        if p.nominal is None
    ]
    refused += [
        f"{dataset.runs[p.run].name}: the extended simulation could not be run"
        for p in simulated
        if p.extended is None and p.nominal is not None
    ]
    return Diagnosis(
        name=dataset.spec.name or dataset.path.parent.resolve().name or dataset.nominal.name,
        finding=finding,
        residuals=channel_residuals(finding.series, finding.noise, bool(causes or finding.partial)),
        closed_loop=closed_loop(dataset, simulated),
        experiment=next_experiment(finding, dataset),
        extended=extended_scenario(dataset.nominal, causes),
        dataset=dataset,
        simulated=simulated,
        remarks=(*notes, *refused),
        seconds=seconds,
    )
