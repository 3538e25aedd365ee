"""Results of a diagnosis as plain data and short words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from hiltestbed.effects.base import Effect

LINK_NAMES = {
    "platform": "platform",
    "wrench": "contact and sensor",
    "compensation": "compensation",
    "dynamics": "numerical model",
}


def finite(value: Any) -> Any:
    """Plain data for JSON: lists, Python's numbers, and None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def plain(value: Any) -> Any:
    """A vector as a list, as YAML takes it."""
    return list(value) if isinstance(value, tuple) else value


def entry(effect: Effect) -> dict[str, Any]:
    """An effect as it stands under `effects:` in a scenario."""
    return {"kind": effect.kind} | {
        name: plain(value) for name, value in effect.parameters().items() if value is not None
    }


def listed(parameters: Mapping[str, Any]) -> str:
    """Parameters of an effect by name, numbers to four digits, without omitted ones."""

    def text(v: Any) -> str:
        if isinstance(v, float):
            return f"{v:.4g}"
        return (
            "[" + ", ".join(f"{x:.3g}" for x in v) + "]" if isinstance(v, (list, tuple)) else str(v)
        )

    return ", ".join(f"{name} {text(v)}" for name, v in parameters.items() if v is not None)
