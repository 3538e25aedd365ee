"""The force sensor: from the physical wrench to its reading.

As a piece of its own, in any simulation: :class:`ForceSensor` and :func:`noise_like`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hiltestbed.sensor.library import ForceSensor, noise_like

__all__ = ["ForceSensor", "noise_like"]


def __getattr__(name: str) -> Any:
    """Imported on first access: the blocks of the sensor do not need them."""
    if name in __all__:
        return getattr(import_module("hiltestbed.sensor.library"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
