"""The extended model: the facility's scenario with the named effects; it loads and runs like any
other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hiltestbed.diagnosis.result import Cause, Learned, Parameter
from hiltestbed.effects.table import EFFECTS
from hiltestbed.scenario import Scenario, dump_scenario, resolved, scenario_from


def extended_scenario(nominal: Scenario, causes: Sequence[Cause | Learned]) -> Scenario:
    """`nominal` with the causes added to its effects; `nominal` itself where there are none.

    Raises:
        InputError: an estimate lies outside what its effect allows.
    """
    if not causes:
        return nominal
    data = resolved(nominal)
    data["effects"] = [*data["effects"], *(cause.entry() for cause in causes)]
    data["description"] = _described(nominal, causes)
    return scenario_from(data)


def extended_yaml(scenario: Scenario, causes: Sequence[Cause | Learned]) -> str:
    """The text of extended.yaml: the scenario, with the intervals of the estimates as a comment at
    the top.
    """
    if not causes:
        return "# Nothing was named: this is the nominal scenario.\n" + dump_scenario(scenario)
    named, learned = (
        [c for c in causes if isinstance(c, Cause)],
        [c for c in causes if isinstance(c, Learned)],
    )
    lines = ["# Named by hiltestbed diagnose; estimate and 95 % interval:"] if named else []
    lines += [
        f"#   {c.effect} {name}: {in_words(p)}" for c in named for name, p in c.parameters.items()
    ]
    lines += [f"# Learned by hiltestbed diagnose: {c.effect}, {c.numbers} numbers" for c in learned]
    return "\n".join(lines) + "\n" + dump_scenario(scenario)


def in_words(p: Parameter) -> str:
    """`0.003300 (0.003294 to 0.003307) s`: with as many digits as the interval supports."""
    unit = "" if p.unit == "-" else f" {p.unit}"
    if isinstance(p.estimate, str):
        return p.estimate
    if isinstance(p.estimate, tuple):
        ends = p.ci95 if p.ci95 is not None else (None,) * len(p.estimate)
        return (
            "["
            + ", ".join(_with_interval(v, e) for v, e in zip(p.estimate, ends, strict=True))
            + f"]{unit}"
        )
    return _with_interval(p.estimate, p.ci95) + unit


def _with_interval(value: float, ends: Any) -> str:
    if ends is None or None in ends or ends[0] == ends[1]:
        return f"{value:.4g}"
    size, width = max(abs(value), abs(ends[0]), abs(ends[1])), ends[1] - ends[0]
    digits = (
        min(8, max(2, 2 + math.floor(math.log10(size)) - math.floor(math.log10(width))))
        if size > 0 and width > 0
        else 4
    )
    return f"{value:.{digits}g} ({ends[0]:.{digits}g} to {ends[1]:.{digits}g})"


def _described(nominal: Scenario, causes: Sequence[Cause | Learned]) -> str:
    names = ", ".join(f"{c.effect} ({EFFECTS[c.effect].meaning().rstrip('.')})" for c in causes)
    return f"{nominal.description} Extended with {names}.".strip()
