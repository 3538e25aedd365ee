"""Dates and times of day, in the ways that loggers and spreadsheets write them, as seconds."""

from __future__ import annotations

import re
from datetime import date
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hiltestbed.frames import Array

DAY = 86400.0  # [s]
STAMP = re.compile(
    r"(?:(\d{1,4})[-./](\d{1,2})[-./](\d{1,4})[T ]+)?"
    r"(\d{1,2}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?\s*([AaPp][Mm])?\s*(?:Z|UTC|[+-]\d{2}:?\d{2})?"
)


def seconds(values: np.ndarray) -> Array | None:
    """``(rows,)`` dates with times, or times of day, as seconds since the midnight before the first
    of them; NaN where empty, None if one is neither.

    Dates are read as year-month-day, or as day-month-year unless no month is that long. All rows
    are taken as of one zone.
    """
    if values.dtype.kind == "M":
        known = values[~np.isnat(values)]
        if not len(known):
            return np.full(len(values), np.nan)
        elapsed = (values - known[0].astype("datetime64[D]")) / np.timedelta64(1, "ns") * 1e-9
        return np.where(np.isnat(values), np.nan, elapsed)
    out, days, first = np.full(values.shape, np.nan), {}, None
    for row, value in enumerate(values.ravel()):
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if text is None or text == "":
            continue
        found = STAMP.fullmatch(text.strip()) if isinstance(text, str) else None
        if found is None:
            return None
        *day, hour, minute, second, half = found.groups()
        key = tuple(day)
        if key not in days:
            number = _day_number(key)
            if number is None:
                return None
            days[key] = number
        first = days[key] if first is None else first
        hours = int(hour) % 12 + 12 * (half.lower() == "pm") if half else int(hour)
        of_minute = float((second or "0").replace(",", "."))
        out.flat[row] = (days[key] - first) * DAY + hours * 3600.0 + int(minute) * 60.0 + of_minute
    return out if first is not None else None


def _day_number(day: tuple[str | None, ...]) -> int | None:
    """Number of a day; 0 without a date, None if there is no such day."""
    if day[0] is None or day[1] is None or day[2] is None:
        return 0
    a, b, c = (int(part or 0) for part in day)
    parts = (a, b, c) if len(day[0]) == 4 else (c, a, b) if b > 12 else (c, b, a)
    try:
        return date(*parts).toordinal()
    except ValueError:
        return None
