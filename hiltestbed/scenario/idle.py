"""Keys of a scenario that were given but have no effect, because another choice in the scenario
makes them irrelevant.

Each section reports its own idle keys (:meth:`hiltestbed.config.validation.Strictly.idle`). A key
counts as given if it is in the file; in a resolved file, in which every default is written out, if
it differs from the default.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hiltestbed.config.validation import Problem, Strictly
from hiltestbed.config.yaml_source import KeyPath, dotted

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario


def idle_keys(scenario: Scenario) -> list[Problem]:
    """Every key or section without effect, given or not, with the reason and what to do."""
    return list(_idle(scenario, (), scenario))


def given_in_vain(scenario: Scenario) -> Iterator[tuple[tuple[str, ...], str]]:
    """The keys that were given but have no effect, grouped by reason, with the reason."""
    resolved = scenario.model_fields_set >= set(type(scenario).model_fields)
    by_reason: dict[str, list[str]] = {}
    for path, why in idle_keys(scenario):
        by_reason.setdefault(why, []).extend(map(dotted, _given(scenario, path, resolved)))
    yield from ((tuple(dict.fromkeys(keys)), why) for why, keys in by_reason.items() if keys)


def _idle(value: Any, at: KeyPath, scenario: Scenario) -> Iterator[Problem]:
    if isinstance(value, Strictly):
        yield from (((*at, *below), why) for below, why in value.idle(scenario))
        for name in type(value).model_fields:
            yield from _idle(getattr(value, name), (*at, name), scenario)
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from _idle(item, (*at, i), scenario)


def _given(owner: Any, path: KeyPath, resolved: bool) -> Iterator[KeyPath]:
    """The leaves at and below ``path`` of ``owner`` that were given, as paths from ``owner``."""
    default = None
    for part in path[:-1]:
        if isinstance(owner, Strictly) and part not in owner.model_fields_set:
            return
        default = _default(owner, default, part)
        owner = owner[part] if isinstance(owner, tuple) else getattr(owner, str(part))  # type: ignore[index]
    for below in _leaves(owner, default, str(path[-1]), resolved):
        yield (*path[:-1], *below)


def _leaves(owner: Strictly, default: Any, name: str, resolved: bool) -> Iterator[KeyPath]:
    if name not in owner.model_fields_set:
        return
    value, usual = getattr(owner, name), _default(owner, default, name)
    if isinstance(value, Strictly):
        for field in value.model_fields_set if type(value) is type(usual) or usual is None else ():
            yield from ((name, *below) for below in _leaves(value, usual, field, resolved))
        if type(value) is not type(usual) and usual is not None:
            yield (name,)  # a different kind from the default
    elif not resolved or value != usual:
        yield (name,)


def _default(owner: Any, default: Any, part: Any) -> Any:
    """The value at ``part`` if nothing is given: from the section's default, or from its class."""
    if type(default) is type(owner) and default is not None:
        return default[part] if isinstance(owner, tuple) else getattr(default, str(part))
    field = type(owner).model_fields[str(part)] if isinstance(owner, Strictly) else None
    if field is None or field.is_required():
        return None
    return field.get_default(call_default_factory=True, validated_data={})
