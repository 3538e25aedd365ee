"""Text tables: one line of names, one row per sample. Only the wanted columns are read, block by
block. Delimiter, decimal sign and line of the names are recognised together.

Every reading (delimiter x decimal sign x line of the names) of the first lines is scored by the
cells that it makes numbers of, in lines with as many cells as there are names; the best is taken. A
wrong delimiter or decimal sign leaves text in place of numbers, a line above the names has another
number of cells, and one below them fewer lines after it.
"""

from __future__ import annotations

import codecs
import csv
import re
import tempfile
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from hiltestbed.measured.columns import (
    STAMP,
    Columns,
    match_names,
    refuse_large,
    seconds,
    unreadable,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.measured.units import split_unit, unit_named
from hiltestbed.plugins import register

if TYPE_CHECKING:
    import pyarrow as pa

    from hiltestbed.frames import Array

BLOCK = 1 << 22  # [byte] read at a time
PROBE = 1 << 20  # [byte] from which the dialect and the length of a row are estimated
PROBED = 400  # lines of it that are looked at: the first half, and others up to its end
BOMS = {
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
    codecs.BOM_UTF8: "utf-8-sig",
}
KEYS = "format: {kind: text, delimiter: ..., decimal: ..., header: LINE, encoding: ...}"
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


def _encoding(name: str) -> str:
    try:
        return codecs.lookup(name).name
    except LookupError:
        raise PydanticCustomError(
            "no_encoding",
            "is no encoding; allowed are names such as utf-8 or cp1252",
        ) from None


@register
class Text(DataFormat):
    """Text table such as CSV; what is left out is recognised."""

    kind: Literal["text"] = "text"
    suffixes: ClassVar[tuple[str, ...]] = (".csv", ".txt", ".tsv", ".dat", ".asc")
    apart: ClassVar[bool] = False

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] | None = Field(
        default=None, description='sign between the cells; " ": any number of blanks'
    )
    decimal: Literal[".", ","] | None = Field(default=None, description="decimal sign")
    header: Annotated[int, Field(ge=0)] | None = Field(
        default=None,
        description="number of the line with the names; 0: there is none, columns are 1, 2, ...",
    )
    encoding: Annotated[str, AfterValidator(_encoding)] | None = Field(
        default=None, description="such as utf-8, utf-16 or cp1252"
    )
    marks: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="texts that stand for a missing sample, such as OVL"
    )

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The columns ``wanted``. Raises InputError."""
        with path.open("rb") as file:
            head = file.read(PROBE)
        encoding = self.encoding or _encoding_of(head)
        text = head.decode(encoding, errors="replace") if encoding else ""
        if not encoding or "\0" in text:
            do = f"name the format of a binary file, such as format: {{kind: mdf}}; of text, {KEYS}"
            raise unreadable(path, "is not text", do)
        lines = re.split(r"\r\n|\n|\r", text)
        del lines[len(lines) - (len(head) == PROBE) :]  # the last may be cut
        found = self._dialect(path, lines, wanted)
        refuse = int(path.stat().st_size / (len(head) / max(1, len(lines))))
        places = match_names(path, found.names, wanted)
        refuse_large(path, refuse, len(places))
        data = self._load(path, found, encoding, places) if places else {}
        units = {name: found.units[k] for name, k in places.items() if found.units[k]}
        plain = Dialect(",", ".", (), (), 0, 0, 0, 0, 0.0)
        said = str(found) + ("" if encoding in ("utf-8", "utf-8-sig") else f", in {encoding}")
        notes = () if said == str(plain) else (f"is read as a table {said}",)
        return Columns(tuple(n.strip() for n in found.names), data, units=units, notes=notes)

    def _dialect(self, path: Path, lines: list[str], wanted: Set[str]) -> Dialect:
        half = PROBED // 2
        step = max(1, (len(lines) - half) // half)
        sample = lines[:half] + lines[half::step]
        options = sample, wanted, self.delimiter, self.decimal
        found = recognise(*options, self.header)
        rows = sum(bool(s.strip()) and not s.lstrip().startswith(COMMENTS) for s in sample)
        if found is not None and 2 * found.rows >= rows - found.first:
            return found
        if rows == 0:
            raise unreadable(path, "holds no names and no rows", "the first line names the columns")
        bare = recognise(*options, 0)
        shown = next(s for s in sample if s.strip())[:60]
        what = f"is no table of numbers below a line of names (begins with {shown!r})"
        if bare is not None and 2 * bare.rows >= rows - bare.first:
            what += f"; its rows have {bare.width} cells, {bare}, and no line above as many names"
        do = "a table with decimal commas needs another sign than commas between its cells"
        raise unreadable(path, what, f"{do}; if it is known how the file is written, give {KEYS}")

    def _load(
        self, path: Path, dialect: Dialect, encoding: str, places: dict[str, int]
    ) -> dict[str, Array]:
        import pyarrow as pa

        blocks: list[list[pa.Array]] = []
        rows = 0
        try:
            for batch in _batches(path, dialect, encoding, sorted(set(places.values()))):
                rows += batch.num_rows
                refuse_large(path, rows, len(places))
                blocks.append([batch.column(str(k)) for k in places.values()])
        except pa.ArrowInvalid as error:
            do = "each row needs as many cells as there are names"
            raise unreadable(path, f"is not a table of numbers ({error})", do) from error
        return {
            name: self._numbers(path, dialect, name, [block[j] for block in blocks])
            for j, name in enumerate(places)
        }

    def _numbers(self, path: Path, dialect: Dialect, name: str, blocks: list[pa.Array]) -> Array:
        """The numbers of a column of texts; dates and times in seconds."""
        import pyarrow as pa

        pc: Any = import_module("pyarrow.compute")  # its functions are made when it is imported
        if not blocks:
            return np.zeros(0)
        texts = pc.utf8_trim_whitespace(pa.chunked_array(blocks))
        absent = pc.is_in(texts, pa.array([*MISSING, *self.marks]))
        texts = pc.if_else(absent, pa.scalar(None, pa.string()), texts)
        known = pc.drop_null(texts)
        if len(known) and seconds(np.array([known[0].as_py()])) is not None:
            found = seconds(np.array(texts.to_pylist(), dtype=object))
            if found is not None:
                return found
        plain = pc.replace_substring_regex(texts, "[dD]", "e")  # of Fortran
        plain = pc.replace_substring(plain, ",", ".") if dialect.decimal == "," else plain
        plain = pc.replace_substring_regex(plain, r"^\+", "")
        try:
            return pc.cast(plain, pa.float64()).to_numpy()
        except pa.ArrowInvalid:
            found = ((k, t) for k, t in enumerate(texts.to_pylist()) if not _is_number(t, dialect))
            row, text = next(found)
        what = (
            f"has text in place of a number in column {name!r} (got {text!r} in row {row + 1} "
            f"below line {dialect.first})"
        )
        do = (
            f"if it marks a missing sample, give format: {{kind: text, marks: [{text!r}]}}; if it "
            f"is a number, {KEYS}"
        )
        raise unreadable(path, what, do)


def _encoding_of(head: bytes) -> str:
    """The encoding of a text by its first bytes; empty if it is no text."""
    for mark, encoding in BOMS.items():
        if head.startswith(mark):
            return encoding
    if b"\0" in head:  # every other byte of UTF-16 is zero in plain text
        pairs = np.frombuffer(head[: len(head) // 2 * 2], np.uint8).reshape(-1, 2)
        zeros = [float(share) for share in np.mean(pairs == 0, axis=0)]
        low, high = min(zeros), max(zeros)
        return "" if high < 0.9 or low > 0.1 else "utf-16-be" if zeros[0] == high else "utf-16-le"
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        return "utf-8" if error.start > len(head) - 4 else "latin-1"
    return "utf-8"


def _batches(
    path: Path, dialect: Dialect, encoding: str, places: list[int]
) -> Iterator[pa.RecordBatch]:
    """The rows as texts, block by block; columns are named by their numbers."""
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    encoding = "utf8" if encoding.startswith("utf-8") else encoding
    columns = [str(k) for k in range(max(dialect.width, len(dialect.names)))]
    kept, blank = [str(k) for k in places], dialect.delimiter == " "

    def invalid(row: Any) -> str:
        return "skip" if row.text.lstrip().startswith(COMMENTS) else "error"

    read = pa_csv.ReadOptions(
        block_size=BLOCK,
        skip_rows=dialect.first,
        column_names=columns,
        encoding="utf8" if blank else encoding,
    )
    parse = pa_csv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=invalid)
    texts = pa_csv.ConvertOptions(
        include_columns=kept, column_types=dict.fromkeys(kept, pa.string())
    )
    with tempfile.TemporaryFile() as blanks:
        if blank:  # one between the cells, and none before or after them
            with path.open(encoding=encoding, errors="replace") as file:
                blanks.writelines(" ".join(line.split()).encode() + b"\n" for line in file)
            blanks.seek(0)
        source: Any = blanks if blank else path
        with pa_csv.open_csv(source, read, parse, texts) as stream:
            yield from stream


def _is_number(text: str | None, dialect: Dialect) -> bool:
    try:
        float("nan" if text is None else re.sub("[dD]", "e", text.replace(dialect.decimal, ".")))
    except ValueError:
        return False
    return True


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
        bare = "without names: the columns are 1, 2, ..."
        place = f"names in line {self.header + 1}" if self.header >= 0 else bare
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
            rank = round(found.score, 6), len(wanted & names), place >= 0, not comment, place
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
    numbers = sum(bool(_NUMBER[decimal].fullmatch(c) or STAMP.fullmatch(c)) for c in cells)
    known = numbers + sum(cell in MISSING for cell in cells[:width])
    return _Line(tuple(cells), width, min(1.0, known / width) if numbers else 0.0, comment)


def _headers(table: Sequence[_Line], given: int | None) -> list[int]:
    """The lines that may hold the names, without numbers or with some text; -1: none does."""
    if given is not None or not table:
        return [given - 1] if given is not None and given <= len(table) else []
    numbered = next((k for k, line in enumerate(table) if line.score), -1)
    first = table[numbered]
    # names that are numbers; of two columns they may as well be a row
    columns = range(len(first.cells)) if len(first.cells) > 2 else ()
    counted = any(first.cells == tuple(str(k + start) for k in columns) for start in (0, 1))
    named = [
        k
        for k, line in enumerate(table[:HEADER_LINES])
        if line.width
        and (line.score == 0.0 or (k == numbered and (line.score < 1.0 or counted)))
        and not (k and _units(line))
    ]
    text = any(line.width and not line.comment for line in table[:numbered])
    return named if text or counted or first.score < 1.0 else [*named, -1]


def _units(line: _Line) -> bool:
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
