"""Parquet through pyarrow; only the wanted columns are read."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

from hiltestbed.measured.columns import BROKEN, Columns, as_numbers, refuse_large, unreadable


def read(path: Path, wanted: Set[str]) -> Columns:
    """The columns ``wanted`` of a Parquet file; a null is a missing sample. Raises InputError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            names = tuple(file.schema_arrow.names)
            columns = [name for name in names if name in wanted]
            refuse_large(path, file.metadata.num_rows, len(columns))
            table = file.read(columns)
    except (pa.ArrowException, *BROKEN) as error:
        raise unreadable(
            path, f"is not a whole Parquet file ({error})", "copy or record it again"
        ) from error
    data = {name: as_numbers(path, name, table.column(name).to_numpy()) for name in columns}
    return Columns(names, data)
