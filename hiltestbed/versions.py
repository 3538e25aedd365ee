"""Versions of everything that a number depends on."""

from __future__ import annotations

import functools
import platform
from importlib.metadata import version

PACKAGES = ("hiltestbed", "mujoco", "pin", "numpy", "scipy", "numba")


@functools.cache
def versions() -> dict[str, str]:
    """Package name to installed version, Python's own among them."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
