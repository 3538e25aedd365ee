"""Units that a column of measured data may have, each with its factor to the SI unit of the
trace.
"""

from __future__ import annotations

import math

from hiltestbed.signals import GROUPS

POUND_FORCE = 4.4482216152605  # [N], exact by definition
KILOGRAM_FORCE = 9.80665  # [N]
INCH, FOOT = 0.0254, 0.3048  # [m]

UNITS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": INCH, "ft": FOOT},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "in/s": INCH, "ft/s": FOOT},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30},
    "N": {
        "N": 1.0,
        "daN": 10.0,
        "kN": 1e3,
        "mN": 1e-3,
        "lbf": POUND_FORCE,
        "kip": 1e3 * POUND_FORCE,
        "kgf": KILOGRAM_FORCE,
    },
    "N m": {
        "N m": 1.0,
        "kN m": 1e3,
        "N mm": 1e-3,
        "mN m": 1e-3,
        "lbf in": POUND_FORCE * INCH,
        "lbf ft": POUND_FORCE * 12 * INCH,
    },
    "1": {"1": 1.0},
}

SI_UNIT = {"t": "s"} | {
    column: unit
    for group in GROUPS.values()
    for column, unit in zip(group.columns, group.units, strict=True)
}


def factor(channel: str, unit: str | None) -> float:
    """Factor from ``unit`` to the SI unit of ``channel``; no unit: 1."""
    return 1.0 if unit is None else UNITS[SI_UNIT[channel]][unit]


def unit_fault(channel: str, unit: str | None) -> str | None:
    """Why ``unit`` cannot be the unit of ``channel``, or None if it can."""
    si = SI_UNIT.get(channel)
    if unit is None or si is None:
        return None
    allowed = UNITS.get(si, {})
    return (
        None
        if unit in allowed
        else f"is no unit of this channel (got {unit!r}); allowed: {', '.join(allowed)}; any "
        f"other by scale"
    )


def likely_unit(si: str, size: float, tolerance: float) -> tuple[str, float] | None:
    """The unit of quantity ``si`` whose factor to SI is nearest to ``size`` within the relative
    ``tolerance``, with its factor; or None.
    """
    named = [
        (abs(factor / size - 1.0), name, factor) for name, factor in UNITS[si].items() if name != si
    ]
    off, name, factor = min(named)
    return (name, factor) if off < tolerance else None
