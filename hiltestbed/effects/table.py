"""The vocabulary: every effect by its id, collected from the packages of the links."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

from hiltestbed.effects.base import Effect
from hiltestbed.plugins import OneOf, Registry

EFFECTS: Registry[Effect] = Registry(
    "effect",
    Effect,
    (
        "hiltestbed.sensor.effects",
        "hiltestbed.contact.effects",
        "hiltestbed.platform.effects",
        "hiltestbed.numerical_model.effects",
        "hiltestbed.compensation.input",
        "hiltestbed.effects.log",
    ),
)
AnyEffect = Annotated[Effect, OneOf(EFFECTS)]


def by_link(effects: Iterable[Effect], *links: str) -> list[Effect]:
    """The effects that act on one of ``links``, in the given order."""
    return [e for e in effects if e.link in links]
