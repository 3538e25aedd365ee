"""Which key moves a figure most: first-order Sobol indices of cases that are there already, whatever design they follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hiltestbed.errors import MissingExtra
from hiltestbed.frames import Array

ENOUGH = 256  # cases below which an index is noise
MOST = 16384  # cases that are used: more tell nothing new
RESAMPLES = 100


@dataclass(frozen=True)
class Index:
    """A key's first-order Sobol index: the share of the figure's variance that the key explains alone, and its 95 % half width."""

    key: str
    first_order: float
    half_width: float


def first_order_indices(keys: list[str], inputs: Array, figure: Array, seed: int = 0) -> list[Index]:
    """Indices of every key, strongest first, by RBD-FAST (Tarantola et al. 2006, bias correction of Tissot and Prieur 2012).

    Args:
        keys: names of the columns. inputs: `(n, keys)`. figure: `(n,)`; cases whose figure is not finite are left out.

    Raises:
        MissingExtra: SALib is not installed.
    """
    try:
        from SALib.analyze import rbd_fast
    except ImportError:
        raise MissingExtra("a Sobol index", "sensitivity") from None
    usable = np.flatnonzero(np.isfinite(figure))
    rng = np.random.default_rng(seed)
    usable = rng.permutation(usable)[:MOST]  # the order of a grid would leak into equal values
    if usable.size < ENOUGH or np.ptp(figure[usable]) == 0.0:
        return []
    problem = {"num_vars": len(keys), "names": keys, "bounds": [[float(low), float(high)] for low, high in _limits(inputs[usable])]}
    found = rbd_fast.analyze(problem, inputs[usable], figure[usable], num_resamples=RESAMPLES, seed=seed)
    indices = [Index(key, float(s), float(c)) for key, s, c in zip(keys, found["S1"], found["S1_conf"], strict=True)]
    return sorted(indices, key=lambda index: -index.first_order)


def _limits(inputs: Array) -> Array:
    return np.stack([inputs.min(axis=0), inputs.max(axis=0)], axis=1)


def explained_share(values: Array, figure: Array, bins: int = 16) -> float:
    """Variance of the figure's mean over `bins` equal parts of the cases, sorted by `values`, over its variance: a rough index."""
    good = np.isfinite(figure)
    if good.sum() < 2 * bins or np.ptp(figure[good]) == 0.0:
        return 0.0
    parts = np.array_split(figure[good][np.argsort(values[good], kind="stable")], bins)
    return float(np.var([part.mean() for part in parts]) / np.var(figure[good]))
