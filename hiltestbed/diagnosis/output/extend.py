"""The facility's scenario with what was named: it loads and runs like any other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hiltestbed.diagnosis.output.result import Cause, Parameter
from hiltestbed.effects.vocabulary import EFFECTS
from hiltestbed.scenario import Scenario, dump_scenario, resolved, scenario_from


def extended_scenario(nominal: Scenario, causes: Sequence[Cause]) -> Scenario:
    """`nominal` with the causes among its effects; `nominal` itself where there are none.

    Raises:
        InputError: an estimate lies outside what its effect allows.
    """
    if not causes:
        return nominal
    data = resolved(nominal)
    data["effects"] = [*data["effects"], *(cause.entry() for cause in causes)]
    data["description"] = _described(nominal, causes)
    return scenario_from(data)


def effects_of_causes(causes: Sequence[Cause]) -> list[tuple[str, dict[str, Any]]]:
    """(id, parameters) as the links take them."""
    return [(kind, {k: v for k, v in c.entry().items() if k != "kind"}) for c in causes for kind in (c.effect,)]


def extended_yaml(scenario: Scenario, causes: Sequence[Cause]) -> str:
    """The text of extended.yaml: the scenario, with the intervals of the estimates as a comment at the top."""
    if not causes:
        return "# Nothing was named: this is the nominal scenario.\n" + dump_scenario(scenario)
    lines = ["# Named by hiltestbed diagnose; estimate and 95 % interval:"]
    lines += [f"#   {c.effect} {name}: {in_words(p)}" for c in causes for name, p in c.parameters.items()]
    return "\n".join(lines) + "\n" + dump_scenario(scenario)


def in_words(p: Parameter, digits: int = 4) -> str:
    """`0.0033 (0.0031 to 0.0035) s`."""
    if isinstance(p.estimate, str):
        return p.estimate
    if isinstance(p.estimate, tuple):
        return f"[{', '.join(f'{v:.{digits}g}' for v in p.estimate)}] {p.unit}".strip()
    text = f"{p.estimate:.{digits}g}"
    if p.ci95 is not None and all(isinstance(v, (int, float)) for v in p.ci95):
        text += f" ({p.ci95[0]:.{digits}g} to {p.ci95[1]:.{digits}g})"
    return f"{text} {'' if p.unit == '-' else p.unit}".strip()


def _described(nominal: Scenario, causes: Sequence[Cause]) -> str:
    names = ", ".join(f"{c.effect} ({EFFECTS[c.effect].description.rstrip('.')})" for c in causes)
    return f"{nominal.description} Extended with {names}.".strip()
