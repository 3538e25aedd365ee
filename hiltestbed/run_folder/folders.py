"""Names and files of results folders, and the option to write figures as separate files."""

from __future__ import annotations

from collections.abc import Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa

# also write the figures of a report beside it, as PNG and SVG
FIGURES_APART: ContextVar[bool] = ContextVar("figures_apart", default=False)


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
