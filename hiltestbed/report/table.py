"""Output of `hiltestbed run` and other commands: the figures at a glance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.markup import escape
from rich.table import Table

from hiltestbed.analysis.assessment import assess, figures_of, identified
from hiltestbed.process.output import console
from hiltestbed.run_folder.folders import number

if TYPE_CHECKING:
    from hiltestbed.process.doctor import Examined


def print_run(
    summary: dict[str, Any], folder: Path, recording: bool = True, elapsed: float | None = None
) -> None:
    """Prints a run's summary and folder; ``elapsed`` [s]: duration of the whole command."""
    screen = console()
    screen.print(_figures(summary, elapsed))
    for warning in assess(summary).warnings:
        screen.print(f"[bold red]warning:[/bold red] {escape(warning)}")
    if summary["delay_ledger"]:
        screen.print(_ledger(summary["delay_ledger"]))
    found = _identified(identified(summary))
    if found.row_count:
        screen.print(found)
    look = (
        f"hiltestbed view {folder}"
        if recording
        else "run again without --no-rerun, then hiltestbed view"
    )
    screen.print(
        f"run folder: {folder}\nreport:     {folder / 'report.html'}\nlook at it: {look}",
        soft_wrap=True,
        markup=False,
    )


def print_lines(title: str, lines: list[tuple[str, str]], folder: Path | None) -> None:
    """Prints figures, and the path of their report if there is one, to standard output."""
    table = _table(title, "", ">")
    for label, value in lines:
        table.add_row(label, value)
    console().print(table)
    _print_path("report", folder)


def print_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]], folder: Path | None
) -> None:
    """Prints rows of cells below a header, and the path of their report if there is one."""
    table = _table(title)
    for name, cells in zip(header, zip(*rows, strict=True), strict=True):
        words = any(cell[:1].isalpha() for cell in cells)
        table.add_column(escape(name), justify="left" if words else "right", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console().print(table)
    _print_path("report", folder)


def _print_path(what: str, path: Path | None) -> None:
    """Prints the path of a page, or of the report in a folder, if there is one."""
    if path is not None:
        page = path / "report.html" if what == "report" else path
        console().print(f"{what}: {page}", soft_wrap=True, markup=False)


def print_comparison(
    names: Sequence[str], rows: Sequence[Sequence[str]], page: Path | None
) -> None:
    """Prints runs side by side, or one below the other if words do not fit the terminal."""
    screen = console()
    widths = _whole_words(list(zip(("", *names), *rows, strict=True)), screen.width)
    if widths:
        table = _table("runs side by side")
        for name, width in zip(("", *names), widths, strict=True):
            table.add_column(escape(name), justify="right" if name else "left", width=width)
        for row in rows:
            table.add_row(*map(escape, row))
        screen.print(table)
    else:
        screen.print("[bold]runs side by side[/bold]")
        for key, *values in rows:
            lines = [f"  {name}: {value}" for name, value in zip(names, values, strict=True)]
            screen.print(key, *lines, sep="\n", soft_wrap=True, markup=False)
    _print_path("page", page)


def print_doctor(findings: Sequence[Examined]) -> None:
    """Prints the findings on an installation to standard output."""
    table = _table("this installation", "", "", "")
    for column in table.columns:
        column.overflow = "fold"
    for found in findings:
        table.add_row(
            "[green]ok[/green]" if found.good else "[red]no[/red]" if found.needed else "-",
            escape(found.what),
            escape(found.state),
        )
    console().print(table)


def print_sweep(about: dict[str, Any], folder: Path) -> None:
    """Prints the outcome of a campaign and its results folder to standard output."""
    wall = about["wall"]
    counts = sorted(about["counts"].items(), key=lambda item: -item[1])
    lines = [
        *((status, str(count)) for status, count in counts),
        ("last session", f"{wall['last_session_cases']} cases in {wall['last_session']:.1f} s"),
        ("engine", f"{about['engine']}, chunks of {about['chunk']}"),
        ("results", str(folder / "cases.parquet")),
    ]
    print_lines(f"{about['name']}: {about['cases']} cases, {about['status']}", lines, folder)


def print_diagnosis(result: dict[str, Any], folder: Path) -> None:
    """Prints the main results of diagnosis.json and the path of the report to standard output."""
    screen = console()
    screen.print(
        f"[bold]{escape(result['name'])}: {result['verdict']}[/bold]\n{escape(result['sentence'])}",
        soft_wrap=False,
    )
    lines = list(result["overridden"])
    heldout, loop = result["heldout"], result["closed_loop"]
    if heldout:
        low, high = (100.0 * v for v in heldout["ci95"])
        gain = f"{100.0 * heldout['reduction']:.4g} % ({low:.4g} to {high:.4g} %)"
        if heldout["placebo_reduction"] is not None:
            gain += f"; with a wrong effect by {100.0 * heldout['placebo_reduction']:.3g} %"
        lines.append(f"residual on runs that were not fitted: lower by {gain}")
    if result["partial"]["sentence"]:
        lines.append(result["partial"]["sentence"])
    if result["learned"]:
        lines.append(result["learned"]["sentence"])
    if any(v is not None for v in loop["cor_measured"]):
        lines.append("coefficient of restitution, run by run:")
        sources = ("measured", "nominal", *(["extended"] if result["extended_scenario"] else []))
        for source in sources:
            lines.append(f"  {source:9s} {', '.join(number(v) for v in loop[f'cor_{source}'])}")
    if result["next_experiment"]:
        lines.append(f"next experiment: {result['next_experiment']}")
    for line in lines:
        screen.print(line, markup=False)
    _print_path("report", folder)


def _whole_words(columns: Sequence[Sequence[str]], room: int) -> list[int] | None:
    """Widths of columns of cells that break no word; None if ``room`` characters do not suffice."""
    least = [
        max(len(word) for cell in column for word in cell.split() or [""]) for column in columns
    ]
    widths = [max(map(len, column)) for column in columns]
    room -= 3 * len(columns) + 1  # spaces between the columns and at the edges
    if sum(least) > room:
        return None
    while sum(widths) > room:
        widest = max(
            (i for i in range(len(widths)) if widths[i] > least[i]), key=lambda i: widths[i]
        )
        widths[widest] -= 1
    return widths


def _figures(summary: dict[str, Any], elapsed: float | None) -> Table:
    table = _table(f"{summary['name']}: {summary['status']}", "", ">", "")
    for row in figures_of(summary):
        table.add_row(*map(escape, row))
    timing = summary["timing"]
    pace, factor = f"{timing['ticks']} ticks", timing["real_time_factor"]
    if factor is not None:
        pace += f", {factor:.1f} times real time"
    table.add_row("time in the loop", number(timing["wall"], 3, "s"), pace)
    if elapsed is not None:
        note = "with start, compiling, reference and files"
        table.add_row("total time", number(elapsed, 3, "s"), note)
    return table


def _ledger(entries: list[dict[str, Any]]) -> Table:
    table = _table("delays in the loop", "source", ">delay [ms]", ">as damping [N s/m]")
    for entry in entries:
        table.add_row(
            entry["source"], f"{1e3 * entry['delay']:+.4f}", f"{entry['equivalent_damping']:+.2f}"
        )
    return table


def _identified(axes: dict[str, dict[str, Any]]) -> Table:
    table = _table(
        "identified against true; k in N/m (rx, ry, rz: N m/rad), c in N s/m (N m s/rad)"
    )
    table.add_column("axis")
    for heading in ("k ± sd", "true", "error", "c ± sd", "true", "error"):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis, values in axes.items():
        table.add_row(axis, *against(values, "stiffness"), *against(values, "damping"))
    return table


def _table(title: str, *columns: str) -> Table:
    """An empty table; columns of numbers begin with ``>``. Without names there is no header."""
    table = Table(
        title=escape(title),
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_header=any(column.lstrip(">") for column in columns) or not columns,
        pad_edge=False,
    )
    for column in columns:
        justify = "right" if column.startswith(">") else "left"
        table.add_column(escape(column.removeprefix(">")), justify=justify)
    return table


def against(values: Mapping[str, Any], quantity: str) -> tuple[str, str, str]:
    """An identified quantity with its sd, the true value, and the error in per cent, as cells."""
    value, true, sd = (values.get(quantity + part) for part in ("", "_true", "_sd"))
    error = "" if value is None or not true else f"{100.0 * (value / true - 1.0):+z.2f} %"
    sure = "" if value is None or sd is None else f" ± {sd:.0f}" if sd >= 10.0 else f" ± {sd:.2g}"
    return number(value, 6) + sure, number(true, 6), error
