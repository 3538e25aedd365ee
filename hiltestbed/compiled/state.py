"""The state of a block: every array that it or one of its parts contains, found by name.

Blocks need not list their arrays. The saved state of a loop consists of the arrays that have
changed since it was made: all others are constants, which a new loop of the same scenario has
already.
"""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import BaseModel

from hiltestbed.frames import Array

_FOREIGN = ("mujoco", "pinocchio", "numpy", "coal", "scipy")
_DEEPEST = 12


def arrays_of(block: Any) -> dict[str, Array]:
    """Every writable array in ``block`` and its parts, by its first dotted name."""
    found: dict[str, Array] = {}
    seen: set[int] = set()
    for name, array in _walk(block, "", seen, 0):
        found.setdefault(name, array)
    return found


def _walk(value: Any, name: str, seen: set[int], depth: int) -> Iterator[tuple[str, Array]]:
    if id(value) in seen or depth > _DEEPEST:
        return
    if isinstance(value, np.ndarray):
        seen.add(id(value))
        if value.flags.writeable and value.dtype != object:
            yield name, value
        return
    parts = _parts(value)
    if parts is None:
        return
    seen.add(id(value))
    for key, part in parts:
        yield from _walk(part, f"{name}.{key}" if name else str(key), seen, depth + 1)


def _parts(value: Any) -> Iterator[tuple[Any, Any]] | None:
    """Names and values of a block's parts; None for objects without state of the loop."""
    if isinstance(value, dict):
        return iter(value.items())
    if hasattr(value, "_asdict"):  # a named tuple
        return iter(value._asdict().items())
    if isinstance(value, (list, tuple)):
        return iter(enumerate(value))
    if isinstance(
        value, (BaseModel, type, types.ModuleType, types.FunctionType, types.MethodType, str)
    ):
        return None
    if type(value).__module__.partition(".")[0] in _FOREIGN:
        return None
    return iter(vars(value).items()) if hasattr(value, "__dict__") else None
