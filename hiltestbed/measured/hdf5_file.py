"""HDF5: every numeric dataset with one or two dimensions, named by its path with dots:
``/wrench_meas/fz`` is ``wrench_meas.fz``.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hiltestbed.errors import MissingExtra
from hiltestbed.measured.columns import (
    BROKEN,
    Columns,
    as_numbers,
    refuse_large,
    split_matrix,
    unreadable,
)

if TYPE_CHECKING:
    from hiltestbed.frames import Array


def read(path: Path, wanted: Set[str]) -> Columns:
    """The columns ``wanted`` of an HDF5 file, rows along the first axis. Raises InputError,
    MissingExtra.
    """
    return read_datasets(path, wanted, rows_first)


def rows_first(dataset: Any, index: tuple[int, ...]) -> Array:
    """One column of a dataset ``(rows, columns)``."""
    return dataset[:, index[0]] if index else dataset[()].reshape(-1)


def read_datasets(
    path: Path,
    wanted: Set[str],
    take: Callable[[Any, tuple[int, ...]], Array],
    transposed: bool = False,
) -> Columns:
    """The columns ``wanted``, each extracted from its dataset by ``take``; ``transposed``: rows are
    along the last axis.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtra(f"{path}: HDF5", "hdf5") from error
    try:
        with h5py.File(path, "r") as file:
            found = _columns(file, h5py.Dataset, transposed)
            here = [name for name in found if name in wanted]
            refuse_large(path, max((max(found[n][0].shape) for n in here), default=0), len(here))
            data = {name: as_numbers(path, name, take(*found[name])) for name in here}
    except BROKEN as error:
        raise unreadable(
            path, f"is not a whole HDF5 file ({error})", "copy or record it again"
        ) from error
    return Columns(tuple(found), data)


def _columns(file: Any, kind: type, transposed: bool) -> dict[str, tuple[Any, tuple[int, ...]]]:
    """Column name to its dataset and its index in it."""
    found: dict[str, tuple[Any, tuple[int, ...]]] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, kind) and item.dtype.kind in "biufO" and not name.startswith("#"):  # type: ignore[attr-defined]
            shape = item.shape[::-1] if transposed else item.shape  # type: ignore[attr-defined]
            found.update(
                {
                    column: (item, index)
                    for column, index in split_matrix(name.replace("/", "."), shape)
                }
            )

    file.visititems(visit)
    return found
