"""The effects of a scenario as plain pairs, defaults filled in."""

from __future__ import annotations

from typing import Any

from hiltestbed.effects.vocabulary import EFFECTS


def effects_of(scenario: Any, link: str | None = None) -> list[tuple[str, dict]]:
    """(id, parameters) of each effect of `scenario`, of one link only if named."""
    pairs = [(entry["kind"], {name: value for name, value in entry.items() if name != "kind"}) for entry in scenario.effects]
    return [(kind, EFFECTS[kind].complete(given)) for kind, given in pairs if link is None or EFFECTS[kind].link == link]
