"""A finding with everything that the report derives from it, as plain records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hiltestbed.diagnosis.result import (
    Cause,
    ChannelResidual,
    ClosedLoop,
    Experiment,
    Finding,
    Heldout,
)

if TYPE_CHECKING:
    from hiltestbed.measured import MeasuredDataset
    from hiltestbed.scenario import Scenario
    from hiltestbed.signals import RunTrace


@dataclass(frozen=True)
class SimulatedRun:
    """One run, simulated: the nominal and the extended trace, None where it could not be run."""

    run: int
    nominal: RunTrace | None
    extended: RunTrace | None


@dataclass
class Conclusion:
    """A finding and what follows from it; attributes as in
    :class:`hiltestbed.diagnosis.report.diagnosis.Diagnosis`.
    """

    name: str
    finding: Finding
    residuals: tuple[ChannelResidual, ...]
    closed_loop: ClosedLoop
    experiment: Experiment | None
    extended: Scenario
    dataset: MeasuredDataset
    simulated: tuple[SimulatedRun, ...]
    remarks: tuple[str, ...] = ()
    seconds: float | None = None

    @property
    def verdict(self) -> str:
        return self.finding.verdict

    @property
    def link(self) -> str | None:
        return self.finding.link

    @property
    def causes(self) -> tuple[Cause, ...]:
        return self.finding.causes

    @property
    def heldout(self) -> Heldout | None:
        return self.finding.heldout

    @property
    def compared(self) -> str:
        """Name of the `extended` prediction of the series: the extended model, the best explanation
        that is not adequate, or none.
        """
        if self.finding.extends:
            return "extended"
        if self.finding.partial:
            return "best explanation"
        return ""

    @property
    def overridden(self) -> tuple[str, ...]:
        """A sentence on each check of the data that the dataset overrides."""
        from hiltestbed.measured.remark import overrides

        return overrides(self.dataset.remarks)

    @property
    def next_experiment(self) -> str | None:
        return self.experiment.text if self.experiment else None
