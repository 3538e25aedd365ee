"""Selection of the reader by the suffix of a file. A reader is imported when needed, the fragile
ones in a separate process.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from importlib import import_module
from pathlib import Path

from hiltestbed.errors import InputError
from hiltestbed.measured.apart import read_apart
from hiltestbed.measured.columns import Columns, unreadable

Reader = Callable[[Path, Set[str]], Columns]
# their parsers may crash, hang or trust any size in the file
FRAGILE = ("hdf5_file", "matlab_file", "mdf_file", "tdms_file", "mcap_file")

READERS = {
    ".csv": "csv_file",
    ".txt": "csv_file",
    ".tsv": "csv_file",
    ".parquet": "parquet_file",
    ".pq": "parquet_file",
    ".h5": "hdf5_file",
    ".hdf5": "hdf5_file",
    ".mat": "matlab_file",
    ".mf4": "mdf_file",
    ".mdf": "mdf_file",
    ".tdms": "tdms_file",
    ".mcap": "mcap_file",
}


def read_columns(path: Path, wanted: Set[str]) -> Columns:
    """The columns ``wanted`` that a data file contains. Raises InputError; MissingExtra with the
    install line.
    """
    module = READERS.get(path.suffix.lower())
    if module is None:
        allowed = ", ".join(READERS)
        raise unreadable(
            path,
            f"has a format that is not known (got suffix {path.suffix!r})",
            f"allowed: {allowed}",
        )
    if not path.is_file():
        raise unreadable(path, "is not a file", "check the name in the dataset")
    if path.stat().st_size == 0:
        raise unreadable(
            path, "is empty (0 bytes)", "record the run again or take it out of the dataset"
        )
    if module in FRAGILE:
        return read_apart(module, path, wanted)
    return reader(module)(path, wanted)


def reader(module: str) -> Reader:
    """The function ``read(path, wanted)`` of one of READERS. Raises InputError for any other
    module.
    """
    if module not in READERS.values():
        raise InputError(
            f"reader {module!r}: is not known; allowed: {', '.join(sorted(set(READERS.values())))}"
        )
    return import_module(f"hiltestbed.measured.{module}").read
