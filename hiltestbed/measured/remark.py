"""A finding of the check of measured data about one channel of one run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from hiltestbed.config.dataset import Check

Severity = Literal["error", "loss", "note"]


@dataclass(frozen=True)
class Remark:
    """One finding. The program never corrects data because of a finding: the fix is left to the
    owner of the data.

    Attributes:
        severity: ``error``: a diagnosis of these data would be wrong; ``loss``: a channel, a run or
            samples cannot be used;
            ``note``: for information.
        run: number of the run, or None for the whole dataset. file: of the run, its name in
            messages.
        channel: column or group of the trace, ``t``, or empty for the run as a whole.
        text: the finding, with its numbers.
        fix: what to do, if possible in the syntax of the dataset file; may be empty.
        evidence: the numbers, by name.
        check: the word for it in the dataset's ``accept``; empty for an error that cannot be
            accepted.
        overridden: whether it was an error that the dataset accepts.
    """

    severity: Severity
    run: int | None
    channel: str
    text: str
    fix: str = ""
    evidence: Mapping[str, float] = field(default_factory=dict)
    check: Check | Literal[""] = ""
    file: str = ""
    overridden: bool = False

    def __str__(self) -> str:
        where = "all runs" if self.run is None else self.file or f"run {self.run}"
        return (
            f"{self.severity}: {where}: "
            f"{self.channel + ': ' if self.channel else ''}{self.text}"
            f"{'; ' + self.remedy if self.remedy else ''}"
        )

    def accepted(self) -> Remark:
        """The same finding as a note: the dataset declares that the data are correct."""
        return replace(
            self,
            severity="note",
            text=f"{self.text} (accepted by the dataset: {self.check})",
            overridden=True,
        )

    @property
    def finding(self) -> tuple[object, ...]:
        """What the remark says, whichever channel it is about."""
        return (
            self.severity,
            self.run,
            self.file,
            self.text,
            self.fix.replace(self.channel, "CHANNEL"),
            self.check,
        )

    @property
    def remedy(self) -> str:
        """The fix, and the key that accepts the data unchanged if that is possible."""
        anyway = (
            f"to use the data as they are, accept: [{self.check}]"
            if self.severity == "error" and self.check
            else ""
        )
        return "; ".join(part for part in (self.fix, anyway) if part)


def together(remarks: Iterable[Remark]) -> list[Remark]:
    """The remarks, those that differ in their channel only as one that names all of them, at the
    place of the first.
    """
    groups: dict[tuple[object, ...], list[Remark]] = {}
    for remark in remarks:
        groups.setdefault(remark.finding, []).append(remark)
    return [_joined(group) for group in groups.values()]


def _joined(alike: list[Remark]) -> Remark:
    first, channels = alike[0], list(dict.fromkeys(remark.channel for remark in alike))
    if len(channels) == 1:
        return first
    fix = (
        f"{first.fix}; likewise for {', '.join(channels[1:])}"
        if first.fix and first.channel in first.fix
        else first.fix
    )
    return replace(first, channel=", ".join(channels), fix=fix)


def overrides(remarks: Iterable[Remark]) -> tuple[str, ...]:
    """A sentence on each check that a dataset overrides: on which data, and what is assumed of
    them.
    """
    found: dict[str, list[Remark]] = {}
    for remark in remarks:
        if remark.overridden:
            found.setdefault(remark.check, []).append(remark)
    return tuple(_override(check, alike) for check, alike in found.items())


def _override(check: str, alike: list[Remark]) -> str:
    channels, runs = (
        ", ".join(dict.fromkeys(found))
        for found in ((r.channel for r in alike), (r.file or f"run {r.run}" for r in alike))
    )
    return (
        f"The dataset overrides a check (accept: [{check}]): {channels} in {runs}. The data are "
        "used as they were recorded: nothing is turned, scaled or exchanged. They are assumed to "
        "be right, and the estimates on these channels are worth no more than that."
    )
