"""A recorded column against what it should be by physics: their ratio, what counts as another unit
or a reversed sign, and the entry of the channel map that would correct it.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.measured.units import UNITS

CLEAR = 20.0  # sigma of its noise by which a signal has to move: a ratio is then known to 5 %
# factor from 1 that no effect causes: over those of an independent rig it is 1.25 at most, and 2.54
# is the smallest one between two units of length
OTHER_UNIT = 2.2
# the same where only an order of magnitude is known: 1000, as from N to kN, over 5 by the effects
UNIT_FACTOR = 200.0
AGREE = 1.3  # factor within which two ratios agree: half of the smallest one between two units
REVERSED = -0.5  # ratio below which a sign is reversed: nearer to -1 than to none
EXPLAINED = 0.85  # part of a signal's square, at least, that what is said to cause it explains
# part of the misfit, at most, that another reading of the columns leaves, to be the right one: the
# least over the hidden effects of an independent rig is 0.29
REMAINDER = 0.1


def share(made: Array, shown: Array, moved: Array | None = None) -> float:
    """Ratio of ``shown`` (rows,) to ``made`` (rows,); 0 if ``made`` does not explain it, or the
    part ``moved`` (rows,) of it.
    """
    known = np.isfinite(made) & np.isfinite(shown)
    m, s = made[known], shown[known]
    size = float(m @ m)
    ratio = float(m @ s) / size if size > 0.0 else 0.0
    square = s @ s if moved is None else moved @ moved
    return ratio if np.sum((s - ratio * m) ** 2) < (1.0 - EXPLAINED) * square else 0.0


def correlation(a: Array, b: Array) -> float:
    """Pearson's correlation over the rows where both are known; 0 if one of them does not vary."""
    known = np.isfinite(a) & np.isfinite(b)
    if known.sum() < 3:
        return 0.0
    a, b = a[known] - a[known].mean(), b[known] - b[known].mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else 0.0


def scale_fix(channel: str, scale: float) -> str:
    """The entry of the channel map that would correct a channel, on top of a scale of its own."""
    return (
        f"if so, multiply its scale by {scale:.8g}: channels: {{{channel}: {{scale: {scale:.8g}}}}}"
    )


def factor_text(size: float, si: str) -> str:
    """Text on numbers ``size`` times those in SI units: the unit that they may be in."""
    unit = _likely_unit(si, 1.0 / size, 0.03) or _likely_unit(si, 1.0 / size, AGREE - 1.0)
    power = round(math.log10(size))
    about = f"{size:.3g}" if abs(math.log10(size) - power) > 0.05 else f"{10.0**power:g}"
    return f"off by about {about}, as if in another unit" + (f" ({unit[0]}?)" if unit else "")


def likely_scale(size: float, si: str) -> float:
    """Factor that converts numbers ``size`` times those in SI: a unit's, 10^n, or 1/size."""
    unit = _likely_unit(si, 1.0 / size, 0.03)
    power = round(math.log10(size))
    if unit is not None:
        return unit[1]
    if abs(math.log10(size) - power) < 0.15:
        return 10.0**-power
    rough = _likely_unit(si, 1.0 / size, AGREE - 1.0)
    return rough[1] if rough else float(f"{1.0 / size:.3g}")


def _likely_unit(si: str, size: float, tolerance: float) -> tuple[str, float] | None:
    """The unit nearest to ``size`` within the relative ``tolerance``, and its factor; or None."""
    others = [(abs(f / size - 1.0), name, f) for name, f in UNITS[si].items() if name != si]
    off, name, found = min(others)
    return (name, found) if off < tolerance else None
