"""Stage "report": from a `Finding` to the `Diagnosis`: the extended model, both models in closed
loop, the next experiment.
"""

from __future__ import annotations

from hiltestbed.config.dataset import label_of
from hiltestbed.diagnosis.closed_loop import closed_loop, simulate_runs
from hiltestbed.diagnosis.next_run import next_experiment
from hiltestbed.diagnosis.report.diagnosis import Diagnosis
from hiltestbed.diagnosis.report.evidence import channel_residuals
from hiltestbed.diagnosis.report.extend import extended_scenario
from hiltestbed.diagnosis.result import Finding
from hiltestbed.measured import MeasuredDataset

MAX_MASS_FACTOR = 100.0  # chosen: no mass is wrong by more


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
        name=dataset.spec.name or label_of(dataset.path),
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


def mass_of_either_body(finding: Finding, dataset: MeasuredDataset) -> str | None:
    """Where a body's mass is named: which factor on the other body's mass looks the same.

    The relative pose depends on 1/mu = 1/m_chaser + 1/m_target only, about the centres of mass; a
    factor with 1/m > 1/mu has no counterpart.
    """
    for cause in finding.causes:
        if cause.effect == "dynamics.mass":
            entry, bodies = cause.entry(), dataset.nominal.spacecraft
            mass = {"chaser": bodies.chaser.mass, "target": bodies.target.mass}
            body, other = entry["body"], "target" if entry["body"] == "chaser" else "chaser"
            rest = 1.0 / mass[other] + (1.0 / float(entry["factor"]) - 1.0) / mass[body]
            if rest > 0.0:
                factor = 1.0 / (rest * mass[other])
                # a foundation is no candidate
                if not 1.0 / MAX_MASS_FACTOR < factor < MAX_MASS_FACTOR:
                    return None
                return (
                    f"the relative pose depends on the reduced mass only: a factor of "
                    f"{factor:.4g} on the {other}'s mass looks the same"
                )
    return None
