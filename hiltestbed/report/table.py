"""Output of `hiltestbed run` and other commands: the figures at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from hiltestbed.analysis.assessment import (
    DELAYS,
    ESTIMATES,
    assess,
    delays_of,
    estimates_of,
    figures_of,
)
from hiltestbed.process.output import console
from hiltestbed.run_folder.folders import number

if TYPE_CHECKING:
    from hiltestbed.process.doctor import Examined


def print_run(
    summary: dict[str, Any], folder: Path, recording: bool = True, elapsed: float | None = None
) -> None:
    """Prints a run's summary and folder; ``elapsed`` [s]: duration of the whole command."""
    screen = console()
    timing = summary["timing"]
    pace, factor = f"{timing['ticks']} ticks", timing["real_time_factor"]
    pace += "" if factor is None else f", {factor:.1f} times real time"
    rows = [*figures_of(summary), ("time in the loop", number(timing["wall"], 3, "s"), pace)]
    if elapsed is not None:
        note = "with start, compiling, reference and files"
        rows.append(("total time", number(elapsed, 3, "s"), note))
    title = f"{summary['name']}: {summary['status']}"
    screen.print(_table(title, ("", "", ""), rows, ("left", "right", "left")))
    for warning in assess(summary).warnings:
        screen.print(f"[bold red]warning:[/bold red] {escape(warning)}")
    if summary["delay_ledger"]:
        screen.print(_table("delays in the loop", DELAYS, delays_of(summary)))
    if found := estimates_of(summary):
        title = "identified against true; k in N/m (rx, ry, rz: N m/rad), c in N s/m (N m s/rad)"
        justify = ("left", *("right",) * 6)
        rows = [row[:-1] for row in found]
        screen.print(_table(title, ESTIMATES[:-1], rows, justify, no_wrap=True))
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
    console().print(_table(title, ("", ""), lines, ("left", "right")))
    _print_path("report", folder)


def print_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]], folder: Path | None
) -> None:
    """Prints rows of cells below a header, and the path of their report if there is one."""
    console().print(_table(title, header, rows, overflow="fold"))
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
        table = _table("runs side by side", ("", *names), rows, ("left", *["right"] * len(names)))
        for column, width in zip(table.columns, widths, strict=True):
            column.width = width
        screen.print(table)
    else:
        screen.print("[bold]runs side by side[/bold]")
        for key, *values in rows:
            lines = [f"  {name}: {value}" for name, value in zip(names, values, strict=True)]
            screen.print(key, *lines, sep="\n", soft_wrap=True, markup=False)
    _print_path("page", page)


def print_doctor(findings: Sequence[Examined]) -> None:
    """Prints the findings on an installation to standard output."""
    bad = {True: Text("no", "red"), False: Text("-")}
    rows = [(Text("ok", "green") if f.good else bad[f.needed], f.what, f.state) for f in findings]
    header, justify = ("", "", ""), ("left", "left", "left")
    console().print(_table("this installation", header, rows, justify, overflow="fold"))


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


def _table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str | Text]],
    justify: Sequence[Any] = (),
    **column: Any,
) -> Table:
    """A table; without names there is no header. ``justify`` left out: words left, numbers right;
    ``column``: options of every column.
    """
    table = Table(
        title=escape(title),
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_header=any(header),
        pad_edge=False,
    )
    for i, name in enumerate(header):
        words = any(str(row[i])[:1].isalpha() for row in rows)
        side = justify[i] if justify else "left" if words else "right"
        table.add_column(escape(name), justify=side, **column)
    for row in rows:
        table.add_row(*(escape(cell) if isinstance(cell, str) else cell for cell in row))
    return table
