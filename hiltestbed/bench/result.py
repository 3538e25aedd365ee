"""The output of every benchmark: bench.json and report.html."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltestbed import plugins
from hiltestbed.report.page import Report, provenance
from hiltestbed.run_folder.store import whole_folder
from hiltestbed.run_folder.versions import versions

BENCH, REPORT = "bench.json", "report.html"
Progress = Callable[[float, float], None]  # work done, and in total


def silent(done: float, total: float) -> None:
    """Shows no progress."""


@dataclass
class BenchResult:
    """The outcome of a benchmark.

    Attributes:
        name: of the benchmark.
        records: one per measurement, as the benchmark defines them.
        summary: its overall results.
        report: the HTML page.
        lines: (label, value) pairs to print.
        failed: methods of the user that could not be measured, with the reason; the command then
            ends with an error.
        command: that it is a part of, if any.
    """

    name: str
    records: list[dict[str, Any]]
    summary: dict[str, Any]
    report: Report
    lines: list[tuple[str, str]] = field(default_factory=list)
    failed: Mapping[str, str] = field(default_factory=dict)
    command: str = "bench"


def write_bench(
    result: BenchResult, path: str | Path, options: Mapping[str, object] | None = None
) -> Path:
    """Write the folder of a benchmark, called with ``options`` (as on the command line)."""
    path, options = Path(path), dict(options or {})
    made = {"options": options, "versions": versions(), "plugins": plugins.loaded()}
    content = {"name": result.name, **made, "records": result.records, "summary": result.summary}
    page = deepcopy(result.report)
    page.heading("How it was made")
    flags = [f"--{n}" if value is True else f"--{n} {value}" for n, value in options.items()]
    called = " ".join([result.command, result.name, *flags]).strip()
    rows = [("command", called), *provenance(made["versions"], made["plugins"])]
    page.table(("item", "version, or start of the SHA-256"), rows)
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    with whole_folder(path, mark=BENCH) as folder:
        (folder / BENCH).write_text(text, encoding="utf-8")
        page.write(folder / REPORT)
    return path
