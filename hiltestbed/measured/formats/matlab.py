"""MATLAB .mat: numeric variables and fields of structs (``wrench_meas.fz``), version 4 to 7 by
SciPy and 7.3, which is HDF5, by h5py.
"""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from hiltestbed.measured.columns import (
    BROKEN,
    Arrays,
    Columns,
    is_under,
    refuse_large,
    unreadable,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.measured.formats.hdf5 import read_datasets
from hiltestbed.plugins import register

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


@register
class Matlab(DataFormat):
    """MATLAB .mat of any version: variables and fields of structs."""

    kind: Literal["matlab"] = "matlab"
    suffixes: ClassVar[tuple[str, ...]] = (".mat",)

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The columns ``wanted``, rows along the longer axis. Raises InputError, MissingExtra."""
        if _is_hdf5(path):  # matrices are column-major, and so appear transposed in HDF5
            return read_datasets(path, wanted, rows=1)
        return _read_version_5(path, wanted)


def _is_hdf5(path: Path) -> bool:
    """Version 7.3 has 512 bytes of its own before the HDF5 signature."""
    with path.open("rb") as file:
        head = file.read(520)
    return head[512:] == HDF5_SIGNATURE or head.startswith(HDF5_SIGNATURE)


def _read_version_5(path: Path, wanted: Set[str]) -> Columns:
    import scipy.io
    from scipy.io.matlab import MatReadError

    try:
        variables = {name: shape for name, shape, _ in scipy.io.whosmat(path)}
        used = {v for v in variables if any(is_under(n, v) for n in wanted)}
        needed = [v for v, shape in variables.items() if v in used or shape == (1, 1)]
        refuse_large(path, sum(int(np.prod(variables[v])) for v in needed), 1)
        content = scipy.io.loadmat(path, variable_names=needed, simplify_cells=True)
    except (MatReadError, *BROKEN) as error:
        what = f"is not a whole MATLAB file ({error})"
        raise unreadable(path, what, "save it again, with -v7 or -v7.3") from error
    arrays = Arrays()
    for name in needed:
        _collect(name, content[name], arrays)
    return arrays.columns(path, wanted, (name for name in variables if name not in needed))


def _collect(name: str, value: Any, arrays: Arrays) -> None:
    """Collect the numeric arrays below ``value``; fields of structs are named with dots."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _collect(f"{name}.{key}", inner, arrays)
        return
    array = np.atleast_1d(np.asarray(value))
    if array.dtype.kind in "biufc":
        arrays.add(name, array)
