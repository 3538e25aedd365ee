"""Versions of the packages on which results depend."""

from __future__ import annotations

import functools
import platform
from importlib.metadata import version

PACKAGES = ("hiltestbed", "mujoco", "pin", "numpy", "scipy", "numba")


@functools.cache
def versions() -> dict[str, str]:
    """Package name to installed version, including Python."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}
