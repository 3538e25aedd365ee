"""Versions of the packages on which results depend, and the code that made them."""

from __future__ import annotations

import functools
import hashlib
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from hiltestbed import plugins
from hiltestbed.config.gallery import shipped

PACKAGES = ("hiltestbed", "mujoco", "pin", "numpy", "scipy", "numba")
_ROOT = Path(__file__).parents[1]  # the package


@functools.cache
def versions() -> dict[str, str]:
    """Package name to installed version, including Python."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def provenance() -> dict[str, str]:
    """:func:`versions`, and the SHA-256 of the package's own sources and models, and of each loaded
    plugin: a version alone does not tell what an edited tree computes.
    """
    users = {f"plugin {Path(name).name}": code for name, code in plugins.loaded().items()}
    return versions() | {"hiltestbed's code": code_sha256()} | users


def differences(expected: Mapping[str, str]) -> str:
    """What differs here from an ``expected`` :func:`provenance`, in words; empty if nothing."""
    own = provenance()
    return ", ".join(
        f"{name} {own.get(name, 'none')[:12]} (expected {value[:12]})"  # the beginning of a hash
        for name, value in expected.items()
        if own.get(name) != value
    )


@functools.cache
def code_sha256() -> str:
    """SHA-256 of every file of the package and of the shipped models, except for what is made by
    running it.
    """
    seen = hashlib.sha256()
    for root in (_ROOT, shipped("models")):  # a wheel has the models in the package
        for file in sorted(root.rglob("*")):
            if "__pycache__" not in file.parts and file.is_file():
                seen.update(
                    str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0"
                )
    return seen.hexdigest()
