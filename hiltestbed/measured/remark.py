"""What the check of measured data has to say about one channel of one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from hiltestbed.dataset import Check

Severity = Literal["error", "loss", "note"]


@dataclass(frozen=True)
class Remark:
    """One finding. Nothing is ever corrected on the strength of one: the fix is for the owner of the data to make.

    Attributes:
        severity: ``error``: a diagnosis of these data would be wrong; ``loss``: a channel, a run or samples cannot be used;
            ``note``: good to know.
        run: number of the run, or None for the whole dataset. file: that holds the run, by which messages call it.
        channel: column or group of the trace, ``t``, or empty for the run as a whole.
        text: what was found, with its numbers.
        fix: what to do, as it would stand in the dataset file where that is possible; may be empty.
        evidence: the numbers, by name.
        check: what was checked, as the dataset's ``accept`` names it; empty for an error that cannot be accepted.
    """

    severity: Severity
    run: int | None
    channel: str
    text: str
    fix: str = ""
    evidence: Mapping[str, float] = field(default_factory=dict)
    check: Check | Literal[""] = ""
    file: str = ""

    def __str__(self) -> str:
        where = "all runs" if self.run is None else self.file or f"run {self.run}"
        return (
            f"{self.severity}: {where}: {self.channel + ': ' if self.channel else ''}{self.text}{'; ' + self.remedy if self.remedy else ''}"
        )

    def accepted(self) -> Remark:
        """The same as a note: the dataset says that the data are meant to be as they are."""
        return replace(self, severity="note", text=f"{self.text} (accepted by the dataset: {self.check})")

    @property
    def remedy(self) -> str:
        """The fix, and the key with which the data are taken as they are where that is possible."""
        anyway = f"to use the data as they are, accept: [{self.check}]" if self.severity == "error" and self.check else ""
        return "; ".join(part for part in (self.fix, anyway) if part)
