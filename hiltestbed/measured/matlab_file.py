"""MATLAB .mat: numeric variables and fields of structs (``wrench_meas.fz``), version 4 to 7 by
SciPy and 7.3, which is HDF5, by h5py.
"""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed.measured.columns import (
    BROKEN,
    Columns,
    as_numbers,
    refuse_large,
    split_matrix,
    unreadable,
)
from hiltestbed.measured.hdf5_file import read_datasets

if TYPE_CHECKING:
    from hiltestbed.frames import Array

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read(path: Path, wanted: Set[str]) -> Columns:
    """The columns ``wanted`` of a .mat file, rows along the first axis of a matrix. Raises
    InputError, MissingExtra.
    """
    if _is_hdf5(path):
        return read_datasets(path, wanted, _rows_last, transposed=True)
    return _read_version_5(path, wanted)


def _is_hdf5(path: Path) -> bool:
    """Version 7.3 has 512 bytes of its own before the HDF5 signature."""
    with path.open("rb") as file:
        head = file.read(520)
    return head[512:] == HDF5_SIGNATURE or head.startswith(HDF5_SIGNATURE)


def _rows_last(dataset: Any, index: tuple[int, ...]) -> Array:
    """One column of a MATLAB matrix, which is column-major and so appears transposed in HDF5."""
    return dataset[index[0], :] if index else dataset[()].reshape(-1)


def _read_version_5(path: Path, wanted: Set[str]) -> Columns:
    import scipy.io
    from scipy.io.matlab import MatReadError

    try:
        variables = {name: shape for name, shape, _ in scipy.io.whosmat(path)}
        needed = [
            v
            for v, shape in variables.items()
            if shape == (1, 1) or any(n == v or n.startswith(f"{v}.") for n in wanted)
        ]
        refuse_large(path, sum(int(np.prod(variables[v])) for v in needed), 1)
        content = scipy.io.loadmat(path, variable_names=needed, simplify_cells=True)
    except (MatReadError, *BROKEN) as error:
        raise unreadable(
            path, f"is not a whole MATLAB file ({error})", "save it again, with -v7 or -v7.3"
        ) from error
    found: dict[str, tuple[np.ndarray, tuple[int, ...]]] = {}
    for name in needed:
        _collect(name, content[name], found)
    names = (*found, *(name for name in variables if name not in needed))
    data = {
        n: as_numbers(path, n, a[:, i[0]] if i else a.reshape(-1))
        for n, (a, i) in found.items()
        if n in wanted
    }
    return Columns(names, data)


def _collect(name: str, value: Any, found: dict[str, tuple[np.ndarray, tuple[int, ...]]]) -> None:
    """Collect the numeric arrays below ``value``; fields of structs are named with dots."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _collect(f"{name}.{key}", inner, found)
        return
    array = np.atleast_1d(np.asarray(value))
    if array.dtype.kind in "biufc":
        found.update({column: (array, index) for column, index in split_matrix(name, array.shape)})
