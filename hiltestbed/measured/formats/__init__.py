"""Selection of the format of a data file, by its suffix or by the dataset, and reading of it.

A format is one module of this package, or of a plugin: a class that derives from
:class:`hiltestbed.measured.data_format.DataFormat`.
"""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Annotated

from hiltestbed.measured.apart import read_apart
from hiltestbed.measured.columns import Columns, unreadable
from hiltestbed.measured.data_format import FORMATS, DataFormat
from hiltestbed.plugins import OneOf
from hiltestbed.run_folder.folders import is_folder

AnyFormat = Annotated[DataFormat, OneOf(FORMATS)]


def read_columns(path: Path, wanted: Set[str], given: DataFormat | None = None) -> Columns:
    """The columns ``wanted`` that a data file contains; ``given``: its format, None: by its suffix.

    Raises InputError; MissingExtra with the install line.
    """
    form = given or format_of(path)
    if not path.is_file():
        raise unreadable(path, "is not a file", "check the name in the dataset")
    if path.stat().st_size == 0:
        do = "record the run again or take it out of the dataset"
        raise unreadable(path, "is empty (0 bytes)", do)
    return read_apart(form, path, wanted) if form.apart else form.read(path, wanted)


def format_of(path: Path) -> DataFormat:
    """The format of a file by its suffix. Raises InputError if no format has it."""
    suffix = path.suffix.lower()
    for kind, form in FORMATS.items():
        if suffix in form.suffixes:
            return form.model_validate({"kind": kind})
    allowed = ", ".join(sorted(s for form in FORMATS.values() for s in form.suffixes))
    do = (
        f"allowed: {allowed}; or name its format in the dataset, such as format: {{kind: text}} "
        f"(one of {', '.join(FORMATS)})"
    )
    raise unreadable(path, f"has a format that is not known (got suffix {path.suffix!r})", do)


def data_file(path: Path) -> Path:
    """The file of a run: ``path``, or the only MCAP file of a bag's folder."""
    files = sorted(path.glob("*.mcap")) if is_folder(path) else []
    return files[0] if len(files) == 1 else path


def no_file(path: Path) -> str:
    """What to do if ``path`` is no file."""
    if not is_folder(path):
        return f"looked for {path}"
    return (
        f"{path} is a folder with {len(list(path.glob('*.mcap')))} MCAP files; allowed is a bag "
        f"with one: `ros2 bag convert` makes it of .db3 files, or of several"
    )
