"""A finding of the check of measured data about one channel of one run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from hiltestbed.config.dataset import Check

Severity = Literal["error", "loss", "note"]


@dataclass(frozen=True)
class Remark:
    """One finding. The program never corrects data because of a finding: the fix is left to the
    owner of the data. Made by :func:`error`, :func:`loss` and :func:`note`.

    Attributes:
        severity: ``error``: a diagnosis of these data would be wrong; ``loss``: a channel, a run or
            samples cannot be used; ``note``: for information.
        run: number of the run, or None for the whole dataset. file: its name in messages.
        channel: column or group of the trace, ``t``, or empty for the run as a whole.
        text: the finding, with its numbers.
        fix: what to do, if possible in the syntax of the dataset file; may be empty.
        check: the word for it in the dataset's ``accept``; empty if it cannot be accepted.
        overridden: whether it was an error that the dataset accepts.
    """

    severity: Severity
    run: int | None
    channel: str
    text: str
    fix: str = ""
    check: Check | Literal[""] = ""
    file: str = ""
    overridden: bool = False

    def __str__(self) -> str:
        where = "all runs" if self.run is None else self.file or f"run {self.run}"
        channel = f"{self.channel}: " if self.channel else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.severity}: {where}: {channel}{self.text}{remedy}"

    def accepted(self) -> Remark:
        """The same finding as a note: the dataset declares that the data are correct."""
        text = f"{self.text} (accepted by the dataset: {self.check})"
        return replace(self, severity="note", text=text, overridden=True)

    @property
    def finding(self) -> tuple[object, ...]:
        """What the remark says, whichever channel it is about."""
        fix = self.fix.replace(self.channel, "CHANNEL")
        return self.severity, self.run, self.file, self.text, fix, self.check

    @property
    def remedy(self) -> str:
        """The fix, and the key that accepts the data unchanged if that is possible."""
        acceptable = self.severity == "error" and self.check
        anyway = f"to use the data as they are, accept: [{self.check}]" if acceptable else ""
        return "; ".join(part for part in (self.fix, anyway) if part)


def error(check: Check | Literal[""], run: int | None, channel: str, text: str, fix: str) -> Remark:
    """A finding with which a diagnosis would be wrong; ``check``: the word that accepts it."""
    return Remark("error", run, channel, text, fix, check)


def loss(run: int | None, channel: str, text: str, fix: str = "") -> Remark:
    """A finding by which a channel, a run or samples cannot be used."""
    return Remark("loss", run, channel, text, fix)


def note(run: int | None, channel: str, text: str, fix: str = "") -> Remark:
    return Remark("note", run, channel, text, fix)


def together(remarks: Iterable[Remark]) -> list[Remark]:
    """The remarks, those that differ in their channel only as one, at the place of the first."""
    groups: dict[tuple[object, ...], list[Remark]] = {}
    for remark in remarks:
        groups.setdefault(remark.finding, []).append(remark)
    out = []
    for first, *others in groups.values():
        more = list(dict.fromkeys(r.channel for r in others if r.channel != first.channel))
        also = f"; likewise for {', '.join(more)}" if more and first.channel in first.fix else ""
        channel = ", ".join([first.channel, *more])
        out.append(replace(first, channel=channel, fix=first.fix + (also if first.fix else "")))
    return out


def overrides(remarks: Iterable[Remark]) -> tuple[str, ...]:
    """A sentence on each check that a dataset overrides: which data, and what is assumed."""
    found: dict[str, list[Remark]] = {}
    for remark in remarks:
        if remark.overridden:
            found.setdefault(remark.check, []).append(remark)
    out = []
    for check, alike in found.items():
        channels = ", ".join(dict.fromkeys(r.channel for r in alike))
        runs = ", ".join(dict.fromkeys(r.file or f"run {r.run}" for r in alike))
        out.append(
            f"The dataset overrides a check (accept: [{check}]): {channels} in {runs}. The data "
            "are used as they were recorded: nothing is turned, scaled or exchanged. They are "
            "assumed to be right, and the estimates on these channels are worth no more than that."
        )
    return tuple(out)
