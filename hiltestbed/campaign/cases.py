"""The cases of a campaign: the values of case number N, a function of the campaign and N alone, and
which cases can run in lockstep: those whose scenarios differ only in numbers.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from hiltestbed.campaign.schema import Campaign, Grid, LoadedCampaign, Sobol
from hiltestbed.errors import InputError
from hiltestbed.scenario import Scenario, resolved, scenario_from

_POINT, _SEED = 0, 1  # independent random streams of one case
# do not affect the structure; the number of ticks does
_FREE = ("name", "description", "seed", "duration")
_KEPT = ("rate", "physics_rate")


def case_values(campaign: Campaign, cases: Sequence[int]) -> list[dict[str, Any]]:
    """For each case, dotted key to value; `seed` is spawned from design.seed unless it varies."""
    if isinstance(campaign.design, Grid):
        rows = _grid(campaign, cases)
    else:
        drawn = _sobol if isinstance(campaign.design, Sobol) else _random
        varied = campaign.vary.values()
        rows = [
            [variation.at(float(u)) for variation, u in zip(varied, quantiles, strict=True)]
            for quantiles in drawn(campaign, cases)
        ]
    return [
        {"seed": case_seed(campaign.design.seed, n)} | dict(zip(campaign.vary, row, strict=True))
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
    chosen = [[axis[i] for i in place] for axis, place in zip(axes, places, strict=True)]
    return [list(row) for row in zip(*chosen, strict=True)]


def _random(campaign: Campaign, cases: Sequence[int]) -> list[np.ndarray]:
    return [
        np.random.default_rng(_stream(campaign.design.seed, n, _POINT)).random(len(campaign.vary))
        for n in cases
    ]


def _sobol(campaign: Campaign, cases: Sequence[int]) -> list[np.ndarray]:
    """The requested points of one scrambled sequence."""
    from scipy.stats import qmc

    rng = np.random.default_rng(campaign.design.seed)
    engine = qmc.Sobol(len(campaign.vary), scramble=True, rng=rng)
    drawn: dict[int, np.ndarray] = {}
    position = 0
    for n in sorted(set(cases)):
        if n > position:
            engine.fast_forward(n - position)
        drawn[n], position = engine.random(1)[0], n + 1
    return [drawn[n] for n in cases]


def skeleton(scenario: Scenario) -> str:
    """The scenario without its numbers: kinds, methods, optional parts, rates, number of ticks."""
    from hiltestbed.platform.build import alike  # MuJoCo, which reading a campaign does not need

    data = {
        key: value if key in _KEPT else _bare(value)
        for key, value in resolved(scenario).items()
        if key not in _FREE
    }
    contact = scenario.mechanism.contact
    platform = str(alike(scenario))  # numbers that its model depends on
    return json.dumps([scenario.ticks, contact.friction > 0, platform, data], sort_keys=True)


def _bare(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _bare(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_bare(item) for item in value]
    return "number" if isinstance(value, int | float) and not isinstance(value, bool) else value


def lockstep_groups(
    scenarios: Sequence[tuple[int, Scenario]], size: int
) -> list[list[tuple[int, Scenario]]]:
    """(case, scenario) pairs in groups of one skeleton, at most `size` members, in case order."""
    groups: dict[str, list[tuple[int, Scenario]]] = {}
    for pair in scenarios:
        groups.setdefault(skeleton(pair[1]), []).append(pair)
    return [
        group[start : start + size]
        for group in groups.values()
        for start in range(0, len(group), size)
    ]


def structural_keys(campaign: LoadedCampaign) -> list[str]:
    """The varied keys that change the skeleton, found by setting each listed value alone."""
    return [
        key
        for key, variation in campaign.spec.vary.items()
        if len(_skeletons(campaign, key, variation.values or ())) > 1
    ]


def _skeletons(campaign: LoadedCampaign, key: str, values: Iterable[Any]) -> set[str]:
    found = set()
    for value in values:
        try:
            found.add(skeleton(scenario_from(campaign.source, {key: value})))
        except InputError:
            continue
    return found
