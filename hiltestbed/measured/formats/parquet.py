"""Parquet through pyarrow; only the wanted columns are read."""

from __future__ import annotations

from collections.abc import Set
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from hiltestbed.measured.columns import (
    Arrays,
    Columns,
    as_numbers,
    is_under,
    match_names,
    refuse_large,
    whole,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register

if TYPE_CHECKING:
    import pyarrow as pa

UNIT = (b"unit", b"units")  # keys of a field's metadata


@register
class Parquet(DataFormat):
    """Parquet: columns, fields of structs, and lists of one length; metadata give units."""

    kind: Literal["parquet"] = "parquet"
    suffixes: ClassVar[tuple[str, ...]] = (".parquet", ".pq")
    apart: ClassVar[bool] = False

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The columns ``wanted``; a null is a missing sample. Raises InputError."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        with whole(path, "Parquet", "copy or record it again", pa.ArrowException):
            with pq.ParquetFile(path) as file:
                names = file.schema_arrow.names
                places = match_names(path, names, wanted)
                types = enumerate(file.schema_arrow.types)
                nested = [k for k, kind in types if pa.types.is_nested(kind)]
                nested = [k for k in nested if any(is_under(w, names[k]) for w in wanted)]
                indices = list(dict.fromkeys([*places.values(), *nested]))
                refuse_large(path, file.metadata.num_rows, len(indices))
                # names may be there twice: whoever maps others need not mind
                table = file.read([names[k] for k in indices]) if indices else None
            return _columns(path, wanted, names, places, table)


def _columns(
    path: Path, wanted: Set[str], names: list[str], places: dict[str, int], table: pa.Table | None
) -> Columns:
    arrays = Arrays()
    called = {names[k]: name for name, k in places.items()}
    columns = zip(table.schema, table.columns, strict=True) if table is not None else ()
    for field, column in columns:
        name = str(field.name)
        _add(path, arrays, called.get(name, name), field, column, wanted)
    return arrays.columns(path, wanted, (n for n in names if n not in arrays.places))


def _add(
    path: Path, arrays: Arrays, name: str, field: Any, column: pa.ChunkedArray, wanted: Set[str]
) -> None:
    """Add the wanted columns in a column: itself, the fields of a struct, or the items of lists."""
    import pyarrow as pa

    pc: Any = import_module("pyarrow.compute")  # its functions are made when it is imported
    metadata = field.metadata or {}
    unit = next((metadata[key].decode("utf-8", "replace") for key in UNIT if key in metadata), "")
    if pa.types.is_struct(field.type):
        for inner, values in zip(field.type, column.flatten(), strict=True):
            _add(path, arrays, f"{name}.{inner.name}", inner, values, wanted)
    elif pa.types.is_nested(field.type):
        lengths = np.unique(pc.list_value_length(column).to_numpy())
        if len(lengths) == 1 and not column.null_count:
            flat = as_numbers(path, name, pc.list_flatten(column).to_numpy())
            arrays.add(name, flat.reshape(-1, int(lengths[0])), unit)
        else:
            arrays.others[name] = (
                f"holds lists of {lengths.min():g} to {lengths.max():g} items; allowed are lists "
                f"of one length: store each channel as a column of its own"
                if len(lengths)
                else "holds no lists"
            )
    elif name in wanted:
        arrays.add(name, as_numbers(path, name, column.to_numpy()), unit)
