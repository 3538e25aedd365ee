"""How a text table is written: delimiter, decimal sign and line of the names, recognised together.

Every reading (delimiter x decimal sign x line of the names) of the first lines is scored by the
cells that it makes numbers of, in lines with as many cells as there are names; the best is taken.
A wrong delimiter or decimal sign leaves text in place of numbers, a line above the names has
another number of cells, and one below them fewer lines after it.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import product

from hiltestbed.measured.units import split_unit, unit_named

DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
COMMENTS = ("#", "%", "//")
HEADER_LINES = 200  # lines from the first within which the names must be
# what spreadsheets, databases and loggers write for a missing number
MISSING = ("", "-", "--", "---", "NA", "N/A", "n/a", "#N/A", "#NA", "#NV", "NaN", "nan", "NAN",
           "-nan", "-NaN", "null", "NULL", "None", "1.#IND", "-1.#IND", "1.#QNAN",
           "-1.#QNAN")  # fmt: skip
_NUMBER = {
    sign: re.compile(
        rf"[+-]?(?:\d+(?:{re.escape(sign)}\d*)?|{re.escape(sign)}\d+)(?:[eEdD][+-]?\d+)?"
        r"|[+-]?[Ii]nf(?:inity)?"
    )
    for sign in ".,"
}
_SEPARATOR = re.compile(r'"?sep=(.)"?', re.IGNORECASE)


@dataclass(frozen=True)
class Dialect:
    """A way to read a table.

    Attributes:
        delimiter: " " for any number of blanks. decimal: "." or ",".
        names: of the columns; units: as many, empty where the file states none.
        header: number of the line with the names, from 0; -1 if none has them.
        first: that of the first row. width: cells in a row. rows: lines that are read as rows, with
            as many cells as there are names; score: the sum of their parts that are numbers.
    """

    delimiter: str
    decimal: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    header: int
    first: int
    width: int
    rows: int
    score: float

    def __str__(self) -> str:
        place = f"names in line {self.header + 1}" if self.header >= 0 else "without names"
        commas = ", decimal commas" if self.decimal == "," else ""
        return (
            f"separated by {DELIMITERS.get(self.delimiter, repr(self.delimiter))}{commas}, {place}"
        )


@dataclass(frozen=True)
class _Line:
    cells: tuple[str, ...]
    width: int  # without empty cells at the end
    score: float  # part of the cells that are no text; 0 without any number
    comment: bool


def recognise(
    lines: Sequence[str],
    wanted: Set[str],
    delimiter: str | None,
    decimal: str | None,
    header: int | None,
) -> Dialect | None:
    """The best reading of the ``lines`` of a file; what is given is not sought. ``header``: number
    of the line with the names, from 1; 0: there is none. None if no reading finds a row.

    Of readings that fit equally, the one with more of the ``wanted`` names is taken, then the one
    whose names are nearest to the rows.
    """
    said = _SEPARATOR.fullmatch(lines[0].strip()) if lines else None
    if delimiter is None and said is not None:
        delimiter = said[1]
    best: tuple[tuple[float, ...], Dialect] | None = None
    for sign, mark in product(
        [delimiter] if delimiter else DELIMITERS, [decimal] if decimal else ".,"
    ):
        if sign == mark:
            continue
        table = [_line(text, sign, mark) for text in lines]
        for place in _headers(table, header):
            found = _reading(table, place, sign, mark)
            if found is None:
                continue
            names = {split_unit(name)[0] for name in found.names} | set(found.names)
            comment = place >= 0 and table[place].comment
            rank = round(found.score, 6), len(wanted & names), not comment, place
            if best is None or rank > best[0]:
                best = rank, found
    return None if best is None else best[1]


def _line(text: str, delimiter: str, decimal: str) -> _Line:
    bare = text.strip()
    comment = bare.startswith(COMMENTS)
    if delimiter == " ":
        cells = bare.split()
    else:
        cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    cells = [cell.strip() for cell in cells]
    width = len(cells)
    while width and not cells[width - 1]:
        width -= 1
    numbers = sum(_NUMBER[decimal].fullmatch(cell) is not None for cell in cells)
    known = numbers + sum(cell in MISSING for cell in cells[:width])
    return _Line(tuple(cells), width, min(1.0, known / width) if numbers else 0.0, comment)


def _headers(table: Sequence[_Line], given: int | None) -> list[int]:
    """The lines that may hold the names: without numbers, or the first with some and text."""
    if given is not None:
        return [given - 1] if given <= len(table) else []
    numbered = next((k for k, line in enumerate(table) if line.score), 0)
    return [
        k
        for k, line in enumerate(table[:HEADER_LINES])
        if line.width
        and (line.score == 0.0 or (k == numbered and line.score < 1.0))
        and not (k and _units(line))
    ]


def _units(line: _Line) -> bool:
    """Whether all cells of a line are units."""
    cells = _named(line)
    return all(unit_named(cell) is not None for cell in cells) and any(cells)


def _reading(table: Sequence[_Line], header: int, delimiter: str, decimal: str) -> Dialect | None:
    rows = [k for k in range(header + 1, len(table)) if table[k].width and not table[k].comment]
    if header < 0:
        widths = [table[k].width for k in rows if table[k].score]
        names = tuple(str(j + 1) for j in range(max(widths, key=widths.count, default=0)))
    else:
        names = _named(table[header])
    # cells at the end of a row may be left out
    fitting = [k for k in rows if table[k].score and table[k].width <= len(names)]
    if not fitting:
        return None
    first = fitting[0]
    widths = [len(table[k].cells) for k in fitting]
    width = max(widths, key=widths.count)
    names = names[:width]
    stated = next((_named(table[k]) for k in range(header + 1, first) if _units(table[k])), ())
    units = [*stated, *[""] * len(names)][: len(names)]
    found = [
        unit.strip("[]() ") or split_unit(name)[1] for unit, name in zip(units, names, strict=True)
    ]
    score = sum(table[k].score for k in fitting)
    read = delimiter, decimal, names, tuple(found), header, first, width
    return Dialect(*read, len(fitting), score)


def _named(line: _Line) -> tuple[str, ...]:
    """The names in a line; the mark of a comment before them is none of them."""
    cells = list(line.cells[: line.width])
    if line.comment and cells:
        cells[0] = cells[0].lstrip("#%/ ")
        cells = cells if cells[0] else cells[1:]
    return tuple(cells)
