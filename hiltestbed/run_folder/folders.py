"""Names and files of results folders, and the option to write figures as separate files; and short
tables in HTML, as `_repr_html_` returns them.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextvars import ContextVar
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

# also write the figures of a report beside it, as PNG and SVG
FIGURES_APART: ContextVar[bool] = ContextVar("figures_apart", default=False)
_CELL = 'style="text-align:right;font-variant-numeric:tabular-nums"'


def parquet_table(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The table in a Parquet file, or some ``columns``; Arrow itself opens only UTF-8 names."""
    import pyarrow.parquet as pq

    with path.open("rb") as file:
        return pq.read_table(file, columns=columns)


def is_file(path: Path) -> bool:
    """Whether a file exists; False for a name that the file system does not accept."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether a folder exists; False for a name that the file system does not accept."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def free_folder(path: Path) -> Path:
    """`path`, or the first of path-2, path-3, ... that does not exist."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


def safe_name(name: str) -> str:
    """The name of a scenario or a campaign, made valid as a folder name."""
    return (
        "".join(c if c.isalnum() or c in "-_." else "-" for c in name).strip(".-")[:100]
        or "unnamed"
    )


def html_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
) -> str:
    """A table with a title above it and a note below it; everything is escaped."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(
        "<tr>"
        + "".join(
            f"<td{' ' + _CELL if i else ''}>{escape(str(cell))}</td>" for i, cell in enumerate(row)
        )
        + "</tr>"
        for row in rows
    )
    below = f"<div>{escape(note)}</div>" if note else ""
    top = f"<tr>{head}</tr>" if header else ""
    return f"<div><b>{escape(title)}</b><table>{top}{body}</table>{below}</div>"


def number(value: float | None, digits: int = 4, unit: str = "") -> str:
    """A number with its unit, a dash for None."""
    return "-" if value is None else f"{value:.{digits}g} {unit}".rstrip()
