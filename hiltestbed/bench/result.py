"""What every benchmark leaves behind: bench.json and report.html."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltestbed.recording import whole_folder
from hiltestbed.report import Report
from hiltestbed.versions import versions

BENCH, REPORT = "bench.json", "report.html"


@dataclass
class BenchResult:
    """The outcome of a benchmark.

    Attributes:
        name: of the benchmark.
        records: one a measurement, as the benchmark defines them.
        summary: its figures.
        report: the page for people.
        lines: (label, value) pairs to print.
    """

    name: str
    records: list[dict[str, Any]]
    summary: dict[str, Any]
    report: Report
    lines: list[tuple[str, str]] = field(default_factory=list)


def write_bench(result: BenchResult, path: str | Path) -> Path:
    """Write the folder of a benchmark and return its path."""
    path = Path(path)
    content = {"name": result.name, "versions": versions(), "records": result.records, "summary": result.summary}
    with whole_folder(path, mark=BENCH) as folder:
        (folder / BENCH).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        result.report.write(folder / REPORT)
    return path
