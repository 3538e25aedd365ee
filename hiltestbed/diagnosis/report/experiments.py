"""The next experiment: the run that would settle what a diagnosis leaves open."""

from __future__ import annotations

from collections.abc import Callable

from hiltestbed.diagnosis.report.discriminators import (
    ALONE,
    BY_LINK,
    RULES,
    Plan,
    air_sweep,
    bodies_absolute,
    press_and_hold,
    speed_ladder,
)
from hiltestbed.diagnosis.report.facts import Facts, facts_of
from hiltestbed.diagnosis.result import Cause, Experiment, Finding
from hiltestbed.effects import EFFECTS
from hiltestbed.measured import MeasuredDataset

MAX_MASS_FACTOR = 100.0  # chosen: no mass is wrong by more
REPEATS = 3  # of a run, the fewest that show a scatter


def next_experiment(finding: Finding, dataset: MeasuredDataset) -> Experiment | None:
    """The next experiment; None where nothing is open: no discrepancy on links that were all
    measured, or a cause without look-alikes.
    """
    facts = facts_of(dataset, finding.causes)
    if finding.verdict in ("unknown", "named_in_part"):
        return for_unknown(finding, facts)
    plans = [separating(c, facts) for c in finding.causes if c.indistinguishable_from]
    if mass_of_either_body(finding, dataset) and not any(
        c.effect in c.indistinguishable_from for c in finding.causes
    ):
        text, runs = bodies_absolute(facts)
        plans.append(Experiment(text, ("dynamics.mass",), runs))
    if not plans:
        return None
    if len(plans) == 1:
        return plans[0]
    effects, runs = (
        tuple(x for p in plans for x in getattr(p, name)) for name in ("separates", "runs")
    )
    return Experiment(" Then: ".join(p.text for p in plans), effects, runs)


def separating(cause: Cause, facts: Facts) -> Experiment:
    """The experiments that separate a cause from each of its rivals, each stated once."""
    plans = [
        plan(facts)
        for plan in dict.fromkeys(
            plan_for(cause.effect, rival) for rival in cause.indistinguishable_from
        )
    ]
    effects = tuple(dict.fromkeys((cause.effect, *sorted(cause.indistinguishable_from))))
    what = (
        f"{effects[0]} from {' and '.join(effects[1:])}"
        if len(effects) > 1
        else f"the bodies of {cause.effect}"
    )
    text = " Then: ".join(text for text, _ in plans)
    return Experiment(
        f"To tell {what}: {text[0].lower()}{text[1:]}",
        tuple(sorted(effects)),
        tuple(run for _, runs in plans for run in runs),
    )


def plan_for(effect: str, rival: str) -> Callable[[Facts], Plan]:
    """The plan of the first rule for two effects; without one, the plan that tests one of their
    links alone, or that of their link.

    An effect that is its own rival is the same effect on the other body.
    """
    if effect == rival:
        return bodies_absolute
    links = [EFFECTS[e].link for e in (effect, rival)]
    alone = next(
        (plan for link, plan in ALONE.items() if link in links and links[0] != links[1]), None
    )
    return next(
        (rule.plan for rule in RULES if rule.separates(effect, rival)), alone or BY_LINK[links[0]]
    )


def for_unknown(finding: Finding, facts: Facts) -> Experiment:
    """The experiment that shows most of an effect outside the vocabulary: the link alone, one
    variable at a time; repeats, where the runs contradict each other.
    """
    if finding.contrary:
        text = (
            f"To see what differs between the runs: repeat the run at {facts.fast:g} m/s three "
            "times in a row with nothing changed, then after a pause, and after the mechanism was "
            "mounted anew. A size that scatters in the first three is the mechanism's own; one "
            "that moves with the others is of its warmth, its wear or its mounting."
        )
        return Experiment(text, (), (facts.at_speed(facts.fast),) * REPEATS)
    if finding.link == "platform":
        plan = air_sweep(facts)
    elif finding.link == "dynamics":
        plan = bodies_absolute(facts)
    elif finding.link in ("contact", "sensor"):
        ladder, hold = speed_ladder(facts), press_and_hold(facts)
        slow = (
            f" Then press and part at {facts.slow / 10:.2g} m/s to half and to the whole of "
            f"{1e3 * facts.depth:.2g} mm: what remains at "
            "this speed depends on position and its history, not on rate."
        )
        plan = f"{ladder[0]}{'' if facts.captured else slow} {hold[0]}", ladder[1]
    else:
        plan = BY_LINK.get(finding.link or "", speed_ladder)(facts)
    return Experiment(
        f"To see the shape of the residual: {plan[0][0].lower()}{plan[0][1:]}", (), plan[1]
    )


def mass_of_either_body(finding: Finding, dataset: MeasuredDataset) -> str | None:
    """Where a body's mass is named: which factor on the other body's mass looks the same.

    The relative pose depends on 1/mu = 1/m_chaser + 1/m_target only, about the centres of mass; a
    factor with 1/m > 1/mu has no counterpart.
    """
    for cause in finding.causes:
        if cause.effect == "dynamics.mass":
            entry, bodies = cause.entry(), dataset.nominal.spacecraft
            mass = {"chaser": bodies.chaser.mass, "target": bodies.target.mass}
            body, other = entry["body"], "target" if entry["body"] == "chaser" else "chaser"
            rest = 1.0 / mass[other] + (1.0 / float(entry["factor"]) - 1.0) / mass[body]
            if rest > 0.0:
                factor = 1.0 / (rest * mass[other])
                # a foundation is no candidate
                if not 1.0 / MAX_MASS_FACTOR < factor < MAX_MASS_FACTOR:
                    return None
                return (
                    f"the relative pose depends on the reduced mass only: a factor of "
                    f"{factor:.4g} on the {other}'s mass looks the same"
                )
    return None
