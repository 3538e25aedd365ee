"""Stage "select": interpretations of a facility: how it computes its contact where its description
leaves that open; the data decide.

Open are where between tip and surface the force acts (the lever), whether a latch resists turning,
whether a point or a ball meets a plane, and whether readings lie between the instants of the
believed physics. None of it is a departure, but with a wrong interpretation a search finds
departures that are not there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, fit, inflation, null_fit, refit, refit_without
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import DETECTION, INTERPRETATION_PENALTY
from hiltestbed.effects.search import Candidate

LEVERS = (0.5, 0.0, 1.0)  # chosen: that are tried first: the middle, the surface, the tip


def wrench_link_of(residual: Residual) -> WrenchLink:
    """The link of contact and sensor of a residual. Raises TypeError for another link."""
    if not isinstance(residual.link, WrenchLink):
        raise TypeError(
            f"residual of the link {residual.link.name} (got {type(residual.link).__name__}); "
            f"allowed is a WrenchLink"
        )
    return residual.link


def choose_lever(link: WrenchLink, effects: Effects = ()) -> WrenchLink:
    """The link with the lever that fits the torques best under ``effects``."""
    if _lever_has_no_effect(link):
        return link

    def cost(lever: float) -> float:
        r = Residual(link.interpreted(lever))(effects)
        return float(np.sum(np.minimum(r * r, 100.0)))

    costs = {lever: cost(lever) for lever in LEVERS}
    best = min(costs, key=lambda key: costs[key])
    found: Any = minimize_scalar(
        cost,
        bounds=(max(best - 0.5, 0.0), min(best + 0.5, 1.0)),
        method="bounded",
        options={"xatol": 0.01},
    )
    return link.interpreted(
        float(found.x) if found.fun < costs[best] - INTERPRETATION_PENALTY else best
    )


def _lever_has_no_effect(link: WrenchLink) -> bool:
    """Whether the lever has no effect: there is no friction."""
    return all(r.scenario.mechanism.contact.friction == 0.0 for r in link.runs)


def choose_ring(link: WrenchLink) -> WrenchLink:
    """The link with a latch that turns freely if the torques show that; else the latch is believed
    to resist turning, which its stiffness does not state.
    """
    if not any(r.scenario.mechanism.captured for r in link.runs):
        return link
    free = link.interpreted(ring=0.0)
    if square(Residual(free)(())) < square(Residual(link)(())) - INTERPRETATION_PENALTY:
        return free
    return link


def choose_steps(link: WrenchLink) -> WrenchLink:
    """The link with a mount stepped as by MuJoCo, or integrated exactly, whichever leaves less."""
    if not link.stepped:
        return link
    exact = choose_lever(link.interpreted(exact=True))
    better = square(Residual(exact)(())) < square(Residual(link)(())) - INTERPRETATION_PENALTY
    return choose_lever(exact.with_unknown_steps()) if better else link


def other_steps(explanation: Explanation) -> WrenchLink | None:
    """The link with a mount integrated in the other way, if the chosen causes fit better there."""
    link, chosen = wrench_link_of(explanation.residual), explanation.chosen
    if not link.stepped or not explanation.departs or not chosen.causes or JITTER in chosen.kinds:
        return None
    other = link.interpreted(exact=not link.exact)
    there = explanation.residual.through(other)
    if refit(there, chosen).score < chosen.score - DETECTION * inflation(chosen):
        return other.with_unknown_steps()
    return None


def lever_under(residual: Residual, found: Fit) -> Residual:
    """The residual with the lever that fits best with ``found``, where it leaves clearly less;
    itself where it does not.

    The lever is first chosen under the null hypothesis, where torques due to a late force mislead
    it; and with a wrong lever even the believed friction can appear as a cause.
    """
    link = wrench_link_of(residual)
    if JITTER in found.kinds or _lever_has_no_effect(link):
        return residual
    before = square(Residual(link)(found.effects()))
    # the estimates have adapted to the wrong lever
    tried = [refit(Residual(link.interpreted(lever)), found) for lever in LEVERS]
    best = min(tried, key=lambda f: f.chi2)
    there = Residual(choose_lever(link, best.effects()))
    need = INTERPRETATION_PENALTY * inflation(best)
    # estimates and lever improve each other
    while (again := refit(there, best)).chi2 < best.chi2 - need:
        best, there = again, Residual(choose_lever(link, again.effects()))
    return there if again.chi2 < before - DETECTION * inflation(found) else residual


def ring_under(residual: Residual, found: Fit) -> Residual:
    """The residual with the latch, turning or not, that fits clearly better with ``found``; itself
    where none does. The first choice may be misled by torques due to a bias.
    """
    link = wrench_link_of(residual)
    if JITTER in found.kinds or not any(r.scenario.mechanism.captured for r in link.runs):
        return residual
    other = residual.through(link.interpreted(ring=1.0 - link.ring))
    if refit(other, found).chi2 < refit(residual, found).chi2 - DETECTION * inflation(found):
        return other
    return residual


def reinterpreted(residual: Residual, found: Fit) -> Residual:
    """The residual with the lever, the latch and the steps of a mount that suit ``found`` best."""
    levered = ring_under(lever_under(residual, found), found)
    link = wrench_link_of(levered)
    if not link.stepped or JITTER in found.kinds:
        return levered
    here = refit(levered, found)
    other = link.interpreted(exact=not link.exact)
    if refit(Residual(other), here).chi2 < here.chi2 - DETECTION * inflation(here):
        return Residual(other.with_unknown_steps())
    return levered


def other_lever(explanation: Explanation) -> WrenchLink | None:
    """The link with another lever, where that leaves clearly less with the chosen causes or makes
    one of them needless; None otherwise.
    """
    residual, chosen = explanation.residual, explanation.chosen
    if not explanation.departs or JITTER in chosen.kinds:
        return None
    for index, cause in enumerate(chosen.causes):
        if "lever" in cause.variant and _only_sets_the_lever(residual, chosen, index):
            return wrench_link_of(explanation.residual).interpreted(cause.variant["lever"])
    if explanation.adequate or not explanation.singles:
        return None
    levered = lever_under(residual, chosen if chosen.causes else explanation.singles[0])
    return None if levered is residual else wrench_link_of(levered)


def _only_sets_the_lever(residual: Residual, chosen: Fit, index: int) -> bool:
    """Whether a cause with a lever of its own explains nothing beyond that lever."""
    there = residual.through(
        wrench_link_of(residual).interpreted(chosen.causes[index].variant["lever"])
    )
    fewer = refit_without(there, chosen, index)
    return fewer.score < chosen.score + DETECTION * inflation(chosen)


def with_point_contact(explanation: Explanation) -> WrenchLink | None:
    """The link with the tip's foremost point in contact, if the chosen causes, none, or a tilt fit
    better there; None otherwise.

    In the MJCF a ball meets a plane: where the bodies turn, or the port is tilted, it is met beside
    the foremost point. A facility may compute the contact at that point.
    """
    link = wrench_link_of(explanation.residual)
    if (
        not explanation.departs
        or JITTER in explanation.chosen.kinds
        or not all(r.scenario.mechanism.flat for r in link.runs)
    ):
        return None
    other = link.interpreted(blunt=0.0)
    tilts = [c for c in explanation.candidates if c.kind == "contact.misalignment"]
    least = _least_score(explanation, other, tilts)
    return other if least < explanation.chosen.score - INTERPRETATION_PENALTY else None


def _least_score(
    explanation: Explanation, other: WrenchLink, alone: Sequence[Candidate] = ()
) -> float:
    """Of the chosen causes, of none and of some ``alone``, on another form of the link."""
    there, chosen = explanation.residual.through(other), explanation.chosen
    fits = [null_fit(there), *(fit(there, (c,), c.grid) for c in alone)]
    return min(f.score for f in (*fits, *([refit(there, chosen)] if chosen.causes else [])))


def with_time_grid(explanation: Explanation) -> WrenchLink | None:
    """The link with readings between the instants of the physics, if that fits better."""
    link = wrench_link_of(explanation.residual)
    if not explanation.departs or JITTER in explanation.chosen.kinds:
        return None
    other = link.interpreted(grid=link.runs[0].scenario.substeps)
    need = INTERPRETATION_PENALTY * inflation(explanation.chosen)
    return other if _least_score(explanation, other) < explanation.chosen.score - need else None
