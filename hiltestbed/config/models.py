"""The shipped MJCF files, one folder per mechanism or platform, and those of the user."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from hiltestbed.config.mjcf import Packed, packed
from hiltestbed.config.trial import refuse_unfit
from hiltestbed.errors import InputError

if TYPE_CHECKING:
    import mujoco


@cache
def models_folder() -> Path:
    """The folder ``models/``: beside the package in a checkout, ``hiltestbed/_data/models`` in an
    installed wheel.
    """
    package = Path(str(files("hiltestbed")))
    for candidate in (package / "_data" / "models", package.parent / "models"):
        if (candidate / "pss33" / "pss33.xml").is_file():
            return candidate
    raise InputError(
        f"no models found in {package / '_data' / 'models'} or {package.parent / 'models'}; "
        f"reinstall hiltestbed"
    )


def load(name: str) -> mujoco.MjSpec:
    """The MJCF ``models/<name>.xml``."""
    import mujoco

    return mujoco.MjSpec.from_file(str(models_folder() / f"{name}.xml"))


def model_of(file: Path) -> Packed:
    """The model in an MJCF ``file``, the user's own only if it compiles within limits. Raises
    InputError.
    """
    found = packed(file)
    remarks_on(file)
    return found


def remarks_on(file: Path) -> tuple[str, ...]:
    """MuJoCo's remarks on a user's model; none on a shipped one. Raises InputError if it does not
    compile within limits.
    """
    return () if is_shipped(file) else refuse_unfit(file, packed(file))


def is_shipped(file: Path) -> bool:
    """Whether a file is one of the shipped models."""
    return file.resolve().is_relative_to(models_folder().resolve())


def stamp(file: Path) -> str:
    """What changes with the content of an MJCF file or of any file that it names; empty if it
    cannot be read: its fault is reported where it is used.
    """
    try:
        return packed(file).sha256
    except InputError:
        return ""
