"""Axis ranges that contain at least two labelled ticks: the viewer places ticks only at powers of
ten.
"""

from __future__ import annotations

import math

MARGIN = 0.06  # of the span, above and below
# largest spans, in ticks of one power of ten, for which a contact plot labels them; beyond, the
# next power
UPWARD, ACROSS = 6.0, 4.5


def readable(low: float, high: float, most: float = UPWARD) -> tuple[float, float]:
    """The range from ``low`` to ``high`` with a margin, widened at the nearer end until two
    multiples of the labelled step lie in it.
    """
    span = high - low
    if not span > 0.0:
        span = max(abs(high), 1e-9)
    low, high = low - MARGIN * span, high + MARGIN * span
    step = 10.0 ** math.floor(math.log10(high - low))
    if high - low > most * step:
        step *= 10.0
    while ticks(low, high, step) < 2:
        below, above = (math.ceil(low / step) - 1) * step, (math.floor(high / step) + 1) * step
        if low - below < above - high:
            low = below - MARGIN * step
        else:
            high = above + MARGIN * step
    return low, high


def ticks(low: float, high: float, step: float) -> int:
    """How many multiples of ``step`` lie between ``low`` and ``high``."""
    return max(0, math.floor(high / step) - math.ceil(low / step) + 1)
