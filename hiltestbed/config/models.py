"""The shipped MJCF files, one folder per mechanism or platform."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.errors import InputError
from hiltestbed.run_folder.folders import is_file

if TYPE_CHECKING:
    import mujoco

_CONTENT = (
    "body_",
    "geom_",
    "jnt_",
    "site_",
    "dof_",
    "mesh_vert",
    "mesh_face",
    "actuator_",
    "tendon_",
    "eq_",
)


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


def _assets(spec: mujoco.MjSpec) -> Iterator[tuple[object, Path]]:
    """The parts of a model that are in separate files, with their paths."""
    folder = Path(spec.modelfiledir)
    for things, below in (
        (spec.meshes, spec.meshdir),
        (spec.hfields, spec.meshdir),
        (spec.textures, spec.texturedir),
    ):
        for thing in things:
            if thing.file:
                yield thing, folder / below / thing.file


def digest(file: Path) -> str:
    """SHA-256 of the model that an MJCF file describes, to nine decimals; independent of its
    location. Raises InputError.
    """
    model = _parsed(file).compile()
    whole = hashlib.sha256(model.names)
    for name in sorted(n for n in dir(model) if n.startswith(_CONTENT)):
        array = np.asarray(getattr(model, name))
        whole.update(name.encode())
        whole.update(
            (np.round(array, 9) + 0.0).tobytes() if array.dtype.kind == "f" else array.tobytes()
        )
    return whole.hexdigest()


def stamp(file: Path) -> tuple[int, ...]:
    """Modification times of an MJCF file and each of its meshes [ns]; empty if there is no such
    file.
    """
    if not is_file(file):
        return ()
    written = file.stat().st_mtime_ns
    return (
        written,
        *(path.stat().st_mtime_ns if path.is_file() else 0 for path in _asset_files(file, written)),
    )


@lru_cache(maxsize=64)
def _asset_files(file: Path, written: int) -> tuple[Path, ...]:
    import mujoco

    try:
        return tuple(path for _, path in _assets(mujoco.MjSpec.from_file(str(file))))
    except ValueError:
        return ()  # its fault is reported where it is read


def copy_model(file: Path, folder: Path) -> Path:
    """Copies an MJCF file and everything that it needs into a new ``folder``; returns the copy.
    Raises InputError.
    """
    spec = _parsed(file)
    folder.mkdir(parents=True)
    for thing, path in list(_assets(spec)):
        name = path.name
        while (folder / name).exists() and (folder / name).read_bytes() != path.read_bytes():
            name = f"_{name}"
        shutil.copyfile(path, folder / name)
        thing.file = name  # type: ignore[attr-defined]
    spec.meshdir = spec.texturedir = ""
    (folder / file.name).write_text(spec.to_xml(), encoding="utf-8")
    return folder / file.name


def _parsed(file: Path) -> mujoco.MjSpec:
    import mujoco

    try:
        spec = mujoco.MjSpec.from_file(str(file))
        for thing, path in _assets(spec):
            if not getattr(thing, "name", "x"):
                thing.name = path.stem  # type: ignore[attr-defined]
        spec.compile()  # a model that does not compile cannot be written either
    except ValueError as error:
        raise InputError(
            f"{file}: is no MJCF that MuJoCo can read: {' '.join(str(error).split())}"
        ) from error
    return spec
