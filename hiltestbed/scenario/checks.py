"""Checks that involve several keys of a scenario."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hiltestbed.config.validation import Problem
from hiltestbed.effects.base import repeated

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike

TICK_LIMIT = 20_000_000  # a trace of this many rows fills 16 GB


def problems(scenario: ScenarioLike) -> Iterator[Problem]:
    """Every fault that concerns several keys together."""
    yield from _rate_problems(scenario)
    yield from _delay_problems(scenario)
    yield from _platform_problems(scenario)
    yield from _effect_problems(scenario)
    yield from _mechanism_problems(scenario)


def _rate_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    ratio = scenario.physics_rate / scenario.rate
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        near = max(1, round(ratio)) * scenario.rate
        yield (
            ("physics_rate",),
            (
                f"does not divide by rate (got {scenario.physics_rate:g} Hz over {scenario.rate:g} "
                f"Hz = {ratio:g}); allowed is a whole multiple of rate, such as {near:g}"
            ),
        )
    if not 1 <= scenario.duration * scenario.rate <= TICK_LIMIT:
        yield (
            ("duration",),
            (
                f"is out of range (got {scenario.duration:g} s at {scenario.rate:g} Hz = "
                f"{scenario.duration * scenario.rate:g} ticks); allowed are 1 to {TICK_LIMIT} ticks"
            ),
        )


def _delay_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    if scenario.sensor.delay > scenario.duration:
        yield (
            ("sensor", "delay"),
            (
                f"cannot be held (got {scenario.sensor.delay:g} s in a run of "
                f"{scenario.duration:g} s); allowed is 0 to the run's duration"
            ),
        )


def _platform_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    """A start that the platform cannot reach, a rate that does not match its controller's, and
    incompatible sections.
    """
    platform, upper = scenario.rig.platform, scenario.rig.upper
    if upper.kind != "fixed" and not platform.carries_upper:
        yield (
            ("rig", "upper", "kind"),
            f"belongs to the 3-3 PSS platform (got {upper.kind!r} with platform kind "
            f"{platform.kind!r}); allowed is fixed",
        )
        return
    yield from platform.problems(scenario)


def _mechanism_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    from hiltestbed.contact.findings import faults

    for message in faults(scenario):
        yield ("mechanism",), message


def _effect_problems(scenario: ScenarioLike) -> Iterator[Problem]:
    for index, effect in repeated(scenario.effects):
        yield (
            ("effects", index),
            f"appears twice, and two effects {effect.kind!r} do not act together; allowed is one: "
            f"take one of them out",
        )
    for index, effect in enumerate(scenario.effects):
        reason = effect.unfit(scenario)
        if reason:
            yield ("effects", index), reason
