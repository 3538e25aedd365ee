"""The MJCF files that ship with the package, one folder a mechanism or a platform."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from hiltestbed.errors import InputError

if TYPE_CHECKING:
    import mujoco


@cache
def models_folder() -> Path:
    """The folder ``models/``: beside the package in a checkout, ``hiltestbed/_data/models`` in an installed wheel."""
    package = Path(str(files("hiltestbed")))
    for candidate in (package / "_data" / "models", package.parent / "models"):
        if (candidate / "pss33" / "pss33.xml").is_file():
            return candidate
    raise InputError(f"no models found in {package / '_data' / 'models'} or {package.parent / 'models'}; reinstall hiltestbed")


def load(name: str) -> mujoco.MjSpec:
    """The MJCF ``models/<name>.xml``."""
    import mujoco

    return mujoco.MjSpec.from_file(str(models_folder() / f"{name}.xml"))
