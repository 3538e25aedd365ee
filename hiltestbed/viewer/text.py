"""The figures of a run, as a text panel beside the scene."""

from __future__ import annotations

from typing import Any

from hiltestbed.analysis.assessment import assess, monitored
from hiltestbed.run_folder.result import Run


def figures(run: Run) -> str:
    """Markdown: description of the run, its figures, and the identified values."""
    summary, scenario = run.summary, run.scenario
    lines = [
        f"# {summary['name']}",
        "",
        scenario.description or "",
        "",
        "| figure | value |",
        "|---|---:|",
    ]
    rows: list[tuple[str, Any, str]] = [
        ("coefficient of restitution", summary["cor"], ""),
        ("reference: no delay, ideal tracking", summary["cor_reference"], ""),
        ("ln of their ratio", summary["cor_log_error"], ""),
        ("peak force", summary["peak_force"], "N"),
        ("contact time", summary["contact_duration"], "s"),
        ("energy made by the rig", summary["energy_generated"], "J"),
    ]
    if "outcome" in summary:
        lines.append(f"| outcome | {summary['outcome'].replace('_', ' ')} |")
    lines += [f"| {name} | {_number(value, unit)} |" for name, value, unit in rows]
    if (seen := monitored(summary)) is not None:
        lines.append(f"| process monitoring | {' '.join(seen)} |")
    if summary["status"] != "completed":
        lines += ["", f"**{summary['status']}**: {summary['stop_reason']}"]
    lines += [
        "",
        f"Energy: {assess(summary).energy}.",
        *(f"**Warning:** {warning}." for warning in assess(summary).warnings),
    ]
    return "\n".join(
        [*lines, "", *_ledger(summary["delay_ledger"]), "", *_identified(summary["identification"])]
    )


def _ledger(entries: list[dict[str, Any]]) -> list[str]:
    if not entries:
        return []
    lines = ["| delay from | ms | as damping, N s/m |", "|---|---:|---:|"]
    return lines + [
        f"| {e['source']} | {1e3 * e['delay']:+.3f} | {e['equivalent_damping']:+.1f} |"
        for e in entries
    ]


def _identified(identification: dict[str, Any]) -> list[str]:
    found = {axis: a for axis, a in identification.items() if a["stiffness"] is not None}
    if not found:
        return []
    lines = ["| axis | stiffness | true | damping | true |", "|---|---:|---:|---:|---:|"]
    for axis, a in found.items():
        unit = "N m/rad" if axis.startswith("r") else "N/m"
        damping = unit.replace("/", " s/")
        values = [
            _number(a[k], u)
            for k, u in zip(
                ("stiffness", "stiffness_true", "damping", "damping_true"),
                (unit, unit, damping, damping),
                strict=True,
            )
        ]
        lines.append(f"| {axis} | {' | '.join(values)} |")
    return lines


def _number(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.4g} {unit}".strip()
