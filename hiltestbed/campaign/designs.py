"""The values of case number N: a function of the campaign and N alone, independent of the chunks
and the workers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hiltestbed.campaign.schema import Campaign, Grid, Sobol

_POINT, _SEED = 0, 1  # independent random streams of one case


def case_values(campaign: Campaign, cases: Sequence[int]) -> list[dict[str, Any]]:
    """For each case number, dotted key to value; `seed` is spawned from (design.seed, case) unless
    it varies itself.
    """
    keys = list(campaign.vary)
    if isinstance(campaign.design, Grid):
        rows = _grid(campaign, cases)
    else:
        quantiles = (
            _sobol(campaign, cases)
            if isinstance(campaign.design, Sobol)
            else _random(campaign, cases)
        )
        rows = [
            [campaign.vary[key].at(float(u)) for key, u in zip(keys, row, strict=True)]
            for row in quantiles
        ]
    return [
        {"seed": case_seed(campaign.design.seed, n)} | dict(zip(keys, row, strict=True))
        for n, row in zip(cases, rows, strict=True)
    ]


def case_seed(seed: int, case: int) -> int:
    """The seed of one case, in [0, 2^63): independent of the number of cases."""
    return int(_stream(seed, case, _SEED).generate_state(1, np.uint64)[0] >> np.uint64(1))


def _stream(seed: int, case: int, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(case, purpose))


def _grid(campaign: Campaign, cases: Sequence[int]) -> list[list[Any]]:
    """The last key varies fastest."""
    axes = [variation.grid() for variation in campaign.vary.values()]
    places = np.unravel_index(np.asarray(cases, dtype=np.int64), [len(axis) for axis in axes])
    return [
        [axis[place] for axis, place in zip(axes, row, strict=True)]
        for row in zip(*places, strict=True)
    ]


def _random(campaign: Campaign, cases: Sequence[int]) -> list[np.ndarray]:
    return [
        np.random.default_rng(_stream(campaign.design.seed, n, _POINT)).random(len(campaign.vary))
        for n in cases
    ]


def _sobol(campaign: Campaign, cases: Sequence[int]) -> list[np.ndarray]:
    """The requested points of one scrambled sequence."""
    from scipy.stats import qmc

    engine = qmc.Sobol(
        len(campaign.vary), scramble=True, rng=np.random.default_rng(campaign.design.seed)
    )
    drawn: dict[int, np.ndarray] = {}
    position = 0
    for n in sorted(set(cases)):
        if n > position:
            engine.fast_forward(n - position)
        drawn[n], position = engine.random(1)[0], n + 1
    return [drawn[n] for n in cases]
