"""Which cases can run in lockstep: those whose scenarios differ only in numbers."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.errors import InputError
from hiltestbed.scenario import Scenario, resolved, scenario_from

# do not affect the structure; the number of ticks does
_FREE = ("name", "description", "seed", "duration")
_KEPT = ("rate", "physics_rate")


def skeleton(scenario: Scenario) -> str:
    """The scenario without its numbers: kinds, methods, which optional parts are present, the rates
    and the number of ticks.
    """
    data = {
        key: value if key in _KEPT else _bare(value)
        for key, value in resolved(scenario).items()
        if key not in _FREE
    }
    contact = scenario.mechanism.contact
    platform = str(scenario.rig.platform.alike(scenario))  # numbers that its model depends on
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
    """(case, scenario) pairs in groups with the same skeleton and at most `size` members, in case
    order within each.
    """
    groups: dict[str, list[tuple[int, Scenario]]] = {}
    for pair in scenarios:
        groups.setdefault(skeleton(pair[1]), []).append(pair)
    return [
        group[start : start + size]
        for group in groups.values()
        for start in range(0, len(group), size)
    ]


def structural_keys(campaign: LoadedCampaign) -> list[str]:
    """The varied keys that change the skeleton, found by setting each of their listed values
    alone.
    """
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
