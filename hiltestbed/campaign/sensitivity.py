"""Influence of each key on a figure: first-order and total Sobol indices from existing cases of any
design.

The figure is expanded in polynomials of the keys (polynomial chaos; B. Sudret, Reliab. Eng. Syst.
Saf. 93, 2008): per key a basis that is orthonormal over the cases, products of at most two keys,
fitted by least squares. The variance is the sum of the squared
coefficients: those of a key alone give its first-order index, all that contain the key its total
index. The quality of the expansion is the share of the variance of left-out cases that it explains,
in closed form from the hat matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hiltestbed.frames import Array

FEWEST_CASES = 64  # cases; with fewer, an index is noise
MOST_CASES = 4096  # cases that are used: more do not change the indices
DEGREES = (1, 2, 3, 4, 6, 8)
CASES_A_TERM = 3  # cases per coefficient, at least: with fewer the fit follows noise


@dataclass(frozen=True)
class Index:
    """A key's share of a figure's variance: alone, and with all its interactions (total)."""

    key: str
    first_order: float
    total: float


@dataclass(frozen=True)
class Sensitivity:
    """Indices of every key, and the share of left-out cases' variance that is explained."""

    indices: tuple[Index, ...]
    explained: float


def sensitivity(
    keys: Sequence[str], inputs: Array, figure: Array, choices: Sequence[bool]
) -> Sensitivity | None:
    """Sobol indices of a figure; None if there are too few cases or the figure does not vary.

    Args:
        keys: names of the columns. inputs: ``(n, keys)``. figure: ``(n,)``; cases whose figure is
            not finite are left out.
        choices: for each key, whether its numbers are only labels of categorical values.
    """
    known = np.flatnonzero(np.isfinite(figure))
    usable = np.random.default_rng(0).permutation(known)[:MOST_CASES]
    y = figure[usable]
    if usable.size < FEWEST_CASES or np.ptp(y) == 0.0:
        return None
    y = (y - y.mean()) / y.std()
    best: Sensitivity | None = None
    for degree in DEGREES:
        bases = [_basis(inputs[usable, j], degree, choice) for j, choice in enumerate(choices)]
        owners, columns = _terms(bases, degree)
        if len(owners) * CASES_A_TERM > usable.size:
            break
        found = _fit(keys, owners, columns, y)
        if best is not None and found.explained < best.explained:
            break
        best = found
    return best


def _basis(values: Array, degree: int, choice: bool) -> list[tuple[int, Array]]:
    """Functions of one key, orthonormal over the cases, with mean 0: (degree, ``(n,)``)."""
    levels = np.unique(values)
    if levels.size < 2:
        return []
    if choice:
        raw = [(values == level).astype(float) for level in levels[1:]]
        degrees = [1] * len(raw)
    else:
        ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
        at = 2.0 * ranks / (values.size - 1) - 1.0
        if levels.size <= 64:  # cases with equal values are evaluated once
            place = np.array([at[values == level].mean() for level in levels])
            at = place[np.searchsorted(levels, values)]
        degrees = list(range(1, min(degree, levels.size - 1) + 1))
        raw = [np.polynomial.legendre.Legendre.basis(d)(at) for d in degrees]
    q = np.linalg.qr(np.column_stack([np.ones(values.size), *raw]))[0][:, 1:]
    return [(d, column * np.sqrt(values.size)) for d, column in zip(degrees, q.T, strict=True)]


def _terms(
    bases: Sequence[Sequence[tuple[int, Array]]], degree: int
) -> tuple[list[tuple[int, ...]], list[Array]]:
    """Products of one or two keys up to a total degree: keys of each, and its column ``(n,)``."""
    owners: list[tuple[int, ...]] = []
    columns = []
    for j, basis in enumerate(bases):
        for _, column in basis:
            owners.append((j,))
            columns.append(column)
    for i, j in combinations(range(len(bases)), 2):
        for d, first in bases[i]:
            for e, second in bases[j]:
                if d + e <= max(2, degree):
                    owners.append((i, j))
                    columns.append(first * second)
    return owners, columns


def _fit(
    keys: Sequence[str], owners: Sequence[tuple[int, ...]], columns: Sequence[Array], y: Array
) -> Sensitivity:
    matrix = np.column_stack([np.ones(y.size), *columns])
    q = np.linalg.qr(matrix)[0]
    left = np.clip(1.0 - np.einsum("ij,ij->i", q, q), 1e-9, None)
    coefficients = np.linalg.lstsq(matrix, y, rcond=1e-10)[0]
    error = (y - matrix @ coefficients) / left  # of each case when it is left out
    variance = coefficients[1:] ** 2
    total = float(variance.sum()) or 1.0
    indices = []
    for j, key in enumerate(keys):
        own = [(v, owner) for v, owner in zip(variance, owners, strict=True) if j in owner]
        alone = float(sum(v for v, owner in own if owner == (j,)))
        indices.append(Index(key, alone / total, float(sum(v for v, _ in own)) / total))
    return Sensitivity(tuple(indices), max(0.0, 1.0 - float(np.mean(error**2))))


def explained_share(values: Array, figure: Array) -> float:
    """Variance of the figure's mean over at most 16 bins of a key, over its own."""
    bins = 16
    good = np.isfinite(figure)
    if good.sum() < 2 * bins or np.ptp(figure[good]) == 0.0:
        return 0.0
    x, y = values[good], figure[good]
    levels = np.unique(x)
    parts = [y[x == level] for level in levels]
    if levels.size > bins:
        parts = np.array_split(y[np.argsort(x, kind="stable")], bins)
    sizes = np.array([part.size for part in parts], dtype=float)
    means = np.array([part.mean() for part in parts])
    away = (means - np.average(means, weights=sizes)) ** 2
    return float(np.average(away, weights=sizes) / np.var(y))
