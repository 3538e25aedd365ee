"""Checks that a facility can run a scenario: its rates, its start, its mechanism."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hiltestbed.config.validation import Problem
from hiltestbed.errors import InputError

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike

PLATFORM = ("rig", "platform")


def facility_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    """Requirements of a scenario that its facility cannot meet."""
    from hiltestbed.contact.sides import sides_of
    from hiltestbed.numerical_model.bodies import approach_state
    from hiltestbed.platform.facilities.hall import facility_of

    try:
        facility = facility_of(scenario)
    except InputError as error:
        place = (
            (*PLATFORM, "model")
            if "model" in type(scenario.rig.platform).model_fields
            else PLATFORM
        )
        yield place, str(error)
        return
    for path, message in facility.problems(scenario.rate):
        yield (*PLATFORM, *path), message
    if facility.moves_passive and scenario.mechanism.mount is not None:
        yield (
            ("mechanism", "mount"),
            "cannot be combined with a passive side that moves (got a mount on platform kind "
            f"{scenario.rig.platform.kind!r}, whose sensor could not separate the mount's load "
            "from the mechanism's weight); allowed is null",
        )
    if facility.moves_passive and sides_of(scenario.mechanism).moving:
        yield (
            ("mechanism", "kind"),
            f"has moving parts (got {scenario.mechanism.kind!r} on platform kind "
            f"{scenario.rig.platform.kind!r}, whose passive side moves: the load of its sensor "
            "must be rigid); allowed is a mechanism without moving parts",
        )
    for complaint in facility.complaints(approach_state(scenario)[:7]):
        yield (
            ("approach",),
            f"starts at a pose that the platform cannot reach ({complaint}); allowed is a start "
            f"within its workspace",
        )
