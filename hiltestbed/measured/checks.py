"""The check of measured data before a diagnosis: every finding with its numbers and a proposed
fix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hiltestbed.measured.plausible import contradictions
from hiltestbed.measured.quality import clipped_samples, quantisation
from hiltestbed.measured.record import Record
from hiltestbed.measured.remark import Remark
from hiltestbed.measured.survey import Survey, look, remarks_on
from hiltestbed.scenario import Scenario
from hiltestbed.signals import GROUPS

NEEDED = ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp")


def check_run(record: Record, scenario: Scenario) -> tuple[Record, Survey, list[Remark]]:
    """The record with its clipped samples marked, its survey, and all remarks on it."""
    found = look(record, scenario)
    clipped, remarks = clipped_samples(record, found)
    remarks += contradictions(record, found, scenario)
    remarks += quantisation(record)
    wrong = any(remark.severity == "error" for remark in remarks)
    remarks += [] if wrong else remarks_on(record, found, scenario)
    if record.ticks > scenario.ticks * 1.01 + 1:
        text = f"lasts {record.t[-1]:.6g} s, longer than the scenario's {scenario.duration:.6g} s"
        remarks.append(Remark("note", record.run, "t", text, "", {"duration": float(record.t[-1])}))
    return replace(record, clipped=clipped), found, remarks


def check_dataset(
    records: Sequence[Record], names: Sequence[str], links: Mapping[str, tuple[str, ...]]
) -> list[Remark]:
    """Remarks on what the dataset lacks: links without input or output, groups with missing axes.
    ``names``: of its runs.
    """
    remarks = []
    for group in NEEDED:
        without = [record.run for record in records if not record.has(group)]
        cut = [link for link, ends in links.items() if group in ends]
        if without:
            everywhere = len(without) == len(records)
            where = (
                "in no run" if everywhere else f"not in {', '.join(names[run] for run in without)}"
            )
            text = (
                f"was measured {where}: the link{'s' if len(cut) > 1 else ''} "
                f"{' and '.join(cut)} cannot be judged there"
            )
            remarks.append(Remark("loss", None, group, text, "", {"runs": len(without)}))
        parts = {
            p
            for record in records
            if record.has(group)
            for p in GROUPS[group].columns
            if p in record.absent
        }
        if parts and any(record.has(group) for record in records):
            names = ", ".join(p.rpartition(".")[2] for p in GROUPS[group].columns if p in parts)
            text = f"lacks {names} in some or all runs; they are taken as absent"
            remarks.append(Remark("loss", None, group, text, "", {"axes": len(parts)}))
    return remarks
