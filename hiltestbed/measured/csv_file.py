"""CSV: one header line, one row per sample. Only the wanted columns are read, block by block."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hiltestbed.measured.columns import Columns, refuse_large, unreadable
from hiltestbed.measured.units import UNITS

BLOCK = 1 << 22  # [byte] read at a time
PROBE = 1 << 20  # [byte] from which the length of a row is estimated
HEADER_LIMIT = 1 << 16
DELIMITERS = ",;\t"


@dataclass(frozen=True)
class _Dialect:
    names: tuple[str, ...]
    skip: int  # lines before the header
    delimiter: str
    decimal: str
    encoding: str
    rows: int  # estimate
    first: tuple[str, ...] = ()  # cells of the first row below the header


def read(path: Path, wanted: Set[str]) -> Columns:
    """The columns ``wanted`` of a CSV file; lines before the header that start with # are skipped.
    Raises InputError.
    """
    import pyarrow as pa
    import pyarrow.csv as pa_csv

    dialect = _dialect(path)
    columns = [name for name in dialect.names if name in wanted]
    repeated = [name for name, times in Counter(columns).items() if times > 1]
    if repeated:
        raise unreadable(
            path,
            f"has a column more than once (got {', '.join(repeated)})",
            "rename or remove the second",
        )
    if not columns:
        return Columns(dialect.names, {})
    _refuse_units(path, dialect)
    refuse_large(path, dialect.rows, len(columns))
    blocks: list[list[np.ndarray]] = []
    try:
        with pa_csv.open_csv(
            path,
            pa_csv.ReadOptions(block_size=BLOCK, skip_rows=dialect.skip, encoding=dialect.encoding),
            pa_csv.ParseOptions(delimiter=dialect.delimiter),
            pa_csv.ConvertOptions(
                include_columns=columns,
                column_types={name: pa.float64() for name in columns},
                decimal_point=dialect.decimal,
            ),
        ) as stream:
            rows = 0
            for batch in stream:
                rows += batch.num_rows
                refuse_large(path, rows, len(columns))
                blocks.append(
                    [batch.column(j).to_numpy(zero_copy_only=False) for j in range(len(columns))]
                )
    except pa.ArrowInvalid as error:
        do = "each row needs as many cells as the header, each a number"
        raise unreadable(path, f"is not a table of numbers ({error})", do) from error
    data = {
        name: np.concatenate([block[j] for block in blocks]) if blocks else np.zeros(0)
        for j, name in enumerate(columns)
    }
    return Columns(dialect.names, data)


def _dialect(path: Path) -> _Dialect:
    """The format of the file, from its first lines."""
    with path.open("rb") as file:
        head = file.read(PROBE)
    try:
        head.decode("utf-8-sig")
        encoding = "utf8"
    except UnicodeDecodeError as error:
        encoding = "utf8" if error.start > len(head) - 4 else "latin-1"
    if b"\0" in head[:HEADER_LIMIT]:
        raise unreadable(
            path, "is not text", "a CSV file is text; give a binary file the suffix of its format"
        )
    text = head.decode("utf-8-sig" if encoding == "utf8" else encoding, errors="replace")
    lines = text.splitlines()
    skip = next(
        (i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), None
    )
    if skip is None:
        raise unreadable(path, "holds no header and no rows", "the first line names the columns")
    header = lines[skip]
    delimiter = max(DELIMITERS, key=header.count)
    names = tuple(next(csv.reader([header], delimiter=delimiter)))
    if all(_is_number(name) for name in names):
        raise unreadable(
            path,
            f"has no header (got {header[:60]!r} as first line)",
            "name the columns in the first line",
        )
    body = lines[skip + 1 :]
    decimal = "," if delimiter != "," and body and re.search(r"\d,\d", body[0]) else "."
    per_row = len(text.encode()) / max(1, len(lines))
    first = tuple(next(csv.reader(body[:1], delimiter=delimiter), ()))
    return _Dialect(
        names, skip, delimiter, decimal, encoding, int(path.stat().st_size / per_row), first
    )


def _refuse_units(path: Path, dialect: _Dialect) -> None:
    """Raises InputError for a row of units below the header: what to do with them."""
    cells = [cell.strip() for cell in dialect.first]
    if not any(cells) or any(cell and _is_number(cell.replace(",", ".")) for cell in cells):
        return
    line, shown = (
        dialect.skip + 2,
        ", ".join(repr(cell) for cell in cells[:8]) + (", ..." if len(cells) > 8 else ""),
    )
    convertible = {unit for si, known in UNITS.items() for unit in known if unit != si}
    named = zip(dialect.names, (cell.strip("[]()") for cell in cells), strict=False)
    column, unit = next(
        ((name, cell) for name, cell in named if cell in convertible), (dialect.names[-1], "kN")
    )
    what = (
        f"has text in place of numbers in line {line}, as a row of units below the names "
        f"(got {shown})"
    )
    do = (
        f"delete this line, and give units that are not SI under channels: {{CHANNEL: "
        f'{{column: "{column}", unit: {unit}}}}}'
    )
    raise unreadable(path, what, do)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
