"""The shipped MJCF files, one folder per mechanism or platform, and those of the user."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hiltestbed.config.gallery import shipped
from hiltestbed.config.mjcf import PackedMjcf, packed
from hiltestbed.config.trial import refuse_unfit
from hiltestbed.errors import InputError

if TYPE_CHECKING:
    import mujoco


def models_folder() -> Path:
    """The folder ``models/``."""
    return shipped("models")


def load(name: str) -> mujoco.MjSpec:
    """The MJCF ``models/<name>.xml``."""
    import mujoco

    return mujoco.MjSpec.from_file(str(models_folder() / f"{name}.xml"))


def model_of(file: Path) -> PackedMjcf:
    """The model in an MJCF ``file``; raises InputError if a user's does not fit the limits."""
    found = packed(file)
    remarks_on(file)
    return found


def remarks_on(file: Path) -> tuple[str, ...]:
    """MuJoCo's remarks on a user's model. Raises InputError if it does not fit the limits."""
    return () if is_shipped(file) else refuse_unfit(file, packed(file))


def is_shipped(file: Path) -> bool:
    """Whether a file is one of the shipped models."""
    return file.resolve().is_relative_to(models_folder().resolve())


def stamp(file: Path) -> str:
    """What changes with an MJCF file or any file that it names; empty if it cannot be read."""
    try:
        return packed(file).sha256
    except InputError:
        return ""
