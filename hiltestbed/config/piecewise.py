"""Piecewise-linear curves: pairs of numbers in a file, one row of numbers in a kernel."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, Strict
from pydantic_core import PydanticCustomError

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

MOST = 18  # knots of a curve
# length of a packed curve: number of knots, their abscissae, their values; padded with 0
PACKED = 1 + 2 * MOST

Pairs = tuple[tuple[float, ...], ...]  # abscissa and value of each knot


def _rising(pairs: Pairs) -> Pairs:
    if len(pairs) == 1:
        raise PydanticCustomError("curve", "a curve has two knots or more, or none (got 1)")
    places = [x for x, _ in pairs]
    if any(b <= a for a, b in pairwise(places)):
        raise PydanticCustomError(
            "curve",
            "the first numbers of the pairs must rise (got {places})",
            {"places": str(places)},
        )
    return pairs


_Knot = Annotated[tuple[float, ...], Strict(False), Field(min_length=2, max_length=2)]
Curve = Annotated[tuple[_Knot, ...], Strict(False), Field(max_length=MOST), AfterValidator(_rising)]


def packed(pairs: Sequence[Sequence[float]], most: int = MOST) -> Array:
    """``(1 + 2 most,)`` of a curve given as pairs; without any, of one that is 0 everywhere."""
    out = np.zeros(1 + 2 * most)
    out[0] = len(pairs)
    for i, (place, value) in enumerate(pairs):
        out[1 + i], out[1 + most + i] = place, value
    return out


@njit(cache=True)
def along(curve, x):
    """Value at x of a packed ``curve``, extrapolated with its first and last slopes."""
    n, most = int(curve[0]), (len(curve) - 1) // 2
    if n == 0:
        return 0.0
    i = 0
    while i < n - 2 and x > curve[2 + i]:
        i += 1
    x0, y0 = curve[1 + i], curve[1 + most + i]
    return y0 + (curve[2 + most + i] - y0) * (x - x0) / (curve[2 + i] - x0)


@njit(cache=True)
def between(curve, x):
    """Value at x of a packed ``curve``, held at its first and last values beyond its ends."""
    n = int(curve[0])
    return along(curve, min(max(x, curve[1]), curve[n])) if n > 0 else 0.0


@njit(cache=True)
def steepest(curve):
    """The largest slope of a packed ``curve``; 0 if none is positive."""
    n, most = int(curve[0]), (len(curve) - 1) // 2
    out = 0.0
    for i in range(n - 1):
        out = max(out, (curve[2 + most + i] - curve[1 + most + i]) / (curve[2 + i] - curve[1 + i]))
    return out
