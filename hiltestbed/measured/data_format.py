"""What a format of measured data is: its options in a dataset, its suffixes, and its reader."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import ClassVar

from hiltestbed.config.validation import Strictly
from hiltestbed.measured.columns import Columns
from hiltestbed.plugins import Registry, placeholder


class DataFormat(Strictly):
    """Base of every format. A class needs a docstring and the parts named in :data:`PARTS`; its
    fields are the options that a dataset file may give for it.

    Attributes:
        suffixes: of the files that are read by it without being told, in lower case.
        apart: whether it reads in a process of its own, because its parser may crash, hang or trust
            any size in the file.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "read")

    kind: str
    suffixes: ClassVar[tuple[str, ...]] = ()
    apart: ClassVar[bool] = True

    @placeholder
    def read(self, path: Path, wanted: Set[str]) -> Columns:
        """The columns ``wanted`` of a file. Raises InputError, or MissingExtra."""
        raise NotImplementedError


FORMATS: Registry[DataFormat] = Registry(
    "data format", DataFormat, ("hiltestbed.measured.formats",)
)
