"""HDF5: every numeric dataset with one or two dimensions, named by its path with dots:
``/wrench_meas/fz`` is ``wrench_meas.fz``; a field of a compound dataset likewise; and MATLAB .mat:
numeric variables and fields of structs (``wrench_meas.fz``), version 4 to 7 by SciPy and 7.3, which
is HDF5, by h5py.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.measured.columns import (
    Arrays,
    Columns,
    is_under,
    refuse_large,
    whole,
)
from hiltestbed.measured.data_format import DataFormat
from hiltestbed.plugins import register

FILL = ("_FillValue", "missing_value")  # NetCDF's attributes for missing samples
UNIT = ("units", "unit")
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


@register
class Hdf5(DataFormat):
    """HDF5, with its links; attributes give units and fill values."""

    kind: Literal["hdf5"] = "hdf5"
    suffixes: ClassVar[tuple[str, ...]] = (".h5", ".hdf5", ".nc")

    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The columns ``wanted``, rows along the longer axis. Raises InputError, MissingExtra."""
        return read_datasets(path, wanted, rows=0)


def read_datasets(path: Path, wanted: Set[str], rows: int) -> Columns:
    """The columns ``wanted`` of an HDF5 file; ``rows``: the axis that usually has them."""
    try:
        import h5py
    except ImportError as error:
        raise MissingExtra(f"{path}: HDF5", "hdf5") from error
    arrays = Arrays(rows)
    with whole(path, "HDF5", "copy or record it again"), h5py.File(path, "r") as file:
        _collect(arrays, "", file, ())
        return arrays.columns(path, wanted)


def _collect(arrays: Arrays, name: str, item: Any, around: tuple[Any, ...]) -> None:
    """Add the datasets at and below ``item``, through links, but not those ``around`` it again."""
    if not hasattr(item, "dtype"):
        for key in item if hasattr(item, "keys") and item not in around else ():
            inner = f"{name}.{key}" if name else key
            if key.startswith("#"):  # MATLAB's own
                continue
            try:
                _collect(arrays, inner, item[key], (*around, item))
            except KeyError:
                arrays.others[inner] = _broken_link(item.get(key, getlink=True))
    elif item.attrs.get("MATLAB_empty", 0):  # the numbers are the size of the variable
        arrays.add(name, np.zeros(0))
    elif item.dtype.names:
        for field in item.dtype.names:
            _collect(arrays, f"{name}.{field}", _Field(item, field, {}), around)
    elif item.dtype.kind in "biufOS" and item.shape is not None:
        arrays.add(name, item, _unit(item.attrs), _fill(item.attrs))


@dataclass(frozen=True)
class _Field:
    """A field of a compound dataset, as a dataset of its own."""

    table: Any
    field: str
    attrs: Any

    @property
    def dtype(self) -> np.dtype:
        return self.table.dtype[self.field].base

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.table.shape, *self.table.dtype[self.field].shape)

    def __getitem__(self, index: Any) -> Any:
        return self.table[self.field][index]


def _broken_link(link: Any) -> str:
    target = f"{link.path!r}" + (f" in {link.filename!r}" if hasattr(link, "filename") else "")
    return f"is a link to {target}, which is not there; copy the file that it names beside this one"


def _unit(attrs: Any) -> str:
    unit = next((attrs[key] for key in UNIT if key in attrs), "")
    return unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)


def _fill(attrs: Any) -> tuple[float, ...]:
    found = [np.ravel(attrs[key]) for key in FILL if key in attrs]
    return tuple(float(v) for values in found for v in values if values.dtype.kind in "biuf")


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

    with whole(path, "MATLAB", "save it again, with -v7 or -v7.3", MatReadError):
        variables = {name: shape for name, shape, _ in scipy.io.whosmat(path)}
        used = {v for v in variables if any(is_under(n, v) for n in wanted)}
        needed = [v for v, shape in variables.items() if v in used or shape == (1, 1)]
        refuse_large(path, sum(int(np.prod(variables[v])) for v in needed), 1)
        content = scipy.io.loadmat(path, variable_names=needed, simplify_cells=True)
        arrays = Arrays()
        for name in needed:
            _collect_variables(name, content[name], arrays)
        return arrays.columns(path, wanted, (name for name in variables if name not in needed))


def _collect_variables(name: str, value: Any, arrays: Arrays) -> None:
    """Collect the numeric arrays below ``value``; fields of structs are named with dots."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _collect_variables(f"{name}.{key}", inner, arrays)
        return
    array = np.atleast_1d(np.asarray(value))
    if array.dtype.kind in "biufc":
        arrays.add(name, array)
