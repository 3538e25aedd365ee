"""Units that a column of measured data may have, each with its factor to the SI unit of the
trace, and the ways in which files write them.
"""

from __future__ import annotations

import math
import re
import unicodedata

from hiltestbed.signals import GROUPS

POUND_FORCE = 4.4482216152605  # [N], exact by definition
KILOGRAM_FORCE = 9.80665  # [N]
INCH, FOOT = 0.0254, 0.3048  # [m]

UNITS = {
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
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
        "gf": 1e-3 * KILOGRAM_FORCE,
    },
    "N m": {
        "N m": 1.0,
        "kN m": 1e3,
        "N mm": 1e-3,
        "mN m": 1e-3,
        "N cm": 1e-2,
        "kgf m": KILOGRAM_FORCE,
        "kgf cm": 1e-2 * KILOGRAM_FORCE,
        "gf cm": 1e-5 * KILOGRAM_FORCE,
        "lbf in": POUND_FORCE * INCH,
        "lbf ft": POUND_FORCE * 12 * INCH,
    },
    "1": {"1": 1.0},
}

# an attitude may be recorded as angles about the fixed x, then y, then z axis, as `attitude_deg`
ANGLES = {g: (f"{g}.rx", f"{g}.ry", f"{g}.rz") for g in ("pose_cmd", "pose_act")}
SI_UNIT = {"t": "s"} | {name: "rad" for names in ANGLES.values() for name in names}
for _group in GROUPS.values():
    SI_UNIT |= dict(zip(_group.columns, _group.units, strict=True))


# Other ways to write a unit, without the signs between its factors; whole words in lower case.
ALIASES = {
    "s": "sec second seconds",
    "ms": "msec millisecond milliseconds",
    "us": "usec microsecond microseconds",
    "ns": "nsec nanosecond nanoseconds",
    "min": "mins minute minutes",
    "h": "hr hrs hour hours",
    "d": "day days",
    "m": "meter meters metre metres",
    "mm": "millimeter millimeters millimetre millimetres",
    "um": "micron microns micrometer micrometre",
    "in": 'inch inches "',
    "ft": "foot feet",
    "rad/s": "rad/sec radps",
    "deg/s": "deg/sec degps",
    "rpm": "1/min r/min",
    "N": "newton newtons",
    "kN": "kilonewton kilonewtons",
    "lbf": "lb lbs",
    "kip": "klbf",
    "kgf": "kp kgforce",
    "gf": "p gforce pond",
    "N m": "newtonmeter newtonmetre",
    "lbf in": "inlbf lbin inlb",
    "lbf ft": "ftlbf lbft ftlb",
    "1": "dimensionless unitless none",
}
_SIGNS = str.maketrans({c: "" for c in " .*·⋅∙×_-"})
_TRAILING = re.compile(r"^(.*?)\s*(?:\[([^]]*)\]|\(([^)]*)\)|[,/]\s*([^,/]+(?:/s)?))\s*$")


def _key(text: str) -> str:
    """A unit without brackets and without the signs between its factors, ``1/s`` as ``/s``."""
    text = unicodedata.normalize("NFKC", text).strip().strip("[]()").strip()
    text = text.replace("μ", "u").replace("°", "deg").replace("−", "-")
    text = re.sub(r"[ .*·⋅]*\b(s|sec|min)\^?\(?-1\)?$", r"/\1", text)
    return text.translate(_SIGNS)


_NAMES = {_key(name): name for known in UNITS.values() for name in known} | {
    word: name for name, words in ALIASES.items() for word in words.split()
} | {"": "1"}  # fmt: skip


def unit_named(text: str) -> str | None:
    """The unit that ``text`` means, by its name in :data:`UNITS`; None if it is none of them.

    >>> unit_named("[N·mm]"), unit_named("µs"), unit_named("mm s^-1"), unit_named("Seconds")
    ('N mm', 'us', 'mm/s', 's')
    """
    key = _key(text)
    return _NAMES.get(key) or (_NAMES.get(key.lower()) if len(key) > 2 else None)


def split_unit(name: str) -> tuple[str, str]:
    """The name of a column without the unit at its end, and that unit as it is written; empty if
    there is none.

    >>> split_unit("Fz [kN]"), split_unit("Time, s"), split_unit("Fz (raw)")
    (('Fz', 'kN'), ('Time', 's'), ('Fz (raw)', ''))
    """
    found = _TRAILING.match(name)
    unit = "" if found is None else next(filter(None, found.groups()[1:]), "")
    if found is None or not unit.strip() or unit_named(unit) is None:
        return name.strip(), ""
    return found[1], unit.strip()


def factor(channel: str, unit: str | None) -> float:
    """Factor from ``unit`` to the SI unit of ``channel``; no unit: 1."""
    return 1.0 if unit is None else UNITS[SI_UNIT[channel]][unit_named(unit) or unit]


def unit_fault(channel: str, unit: str | None) -> str | None:
    """Why ``unit`` cannot be the unit of ``channel``, or None if it can."""
    if unit is None or channel not in SI_UNIT:
        return None
    allowed = UNITS.get(SI_UNIT[channel], {})
    if unit_named(unit) in allowed:
        return None
    listed = ", ".join(allowed)
    return f"is no unit of this channel (got {unit!r}); allowed: {listed}; any other by scale"
