"""Short tables in HTML for notebooks: what `_repr_html_` returns."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

_CELL = 'style="text-align:right;font-variant-numeric:tabular-nums"'


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
