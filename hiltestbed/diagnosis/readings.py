"""How a facility computes its contact, where words leave more than one reading: chosen by what the data bear out.

Where between tip and surface the force acts, whether a latch resists turning, whether a plane is met by a point, whether readings lie
between the instants of the believed physics: none of it is a departure, and a search on the wrong reading finds departures that are not
there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, fit, inflation, nothing, refit
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import DETECTION, ONE_OF_TWO

LEVERS = (0.5, 0.0, 1.0)  # that are tried first


def wrench_link_of(residual: Residual) -> WrenchLink:
    """The link of contact and sensor whose residual it is. Raises TypeError for another."""
    if not isinstance(residual.link, WrenchLink):
        raise TypeError(f"residual of the link {residual.link.name} (got {type(residual.link).__name__}); allowed is a WrenchLink")
    return residual.link


def choose_lever(link: WrenchLink, effects: Effects = ()) -> WrenchLink:
    """Where between tip and surface the force acts: the reading of the geometry that the torques bear out, under ``effects``."""
    if _same_at_any(link):
        return link

    def cost(lever: float) -> float:
        r = Residual(link.reading(lever))(effects)
        return float(np.sum(np.minimum(r * r, 100.0)))

    costs = {lever: cost(lever) for lever in LEVERS}
    best = min(costs, key=lambda key: costs[key])
    found: Any = minimize_scalar(cost, bounds=(max(best - 0.5, 0.0), min(best + 0.5, 1.0)), method="bounded", options={"xatol": 0.01})
    return link.reading(float(found.x) if found.fun < costs[best] - ONE_OF_TWO else best)


def _same_at_any(link: WrenchLink) -> bool:
    """Whether no friction tells the levers apart."""
    return all(r.scenario.mechanism.contact.friction == 0.0 for r in link.runs)


def choose_ring(link: WrenchLink) -> WrenchLink:
    """Whether a latch resists turning, which its stiffness does not say: believed to, unless the torques bear out that it turns freely."""
    if not any(r.scenario.mechanism.captured for r in link.runs):
        return link
    free = link.reading(ring=0.0)
    return free if square(Residual(free)(())) < square(Residual(link)(())) - ONE_OF_TWO else link


def choose_steps(link: WrenchLink, effects: Effects = ()) -> WrenchLink:
    """Whether a mount is stepped as MuJoCo does it or is right by itself: the reading that leaves less under ``effects``."""
    if not link.stepped:
        return link
    exact = link.reading(exact=effects)
    return exact if square(Residual(exact)(effects)) < square(Residual(link)(effects)) - ONE_OF_TWO else link


def other_steps(explanation: Explanation) -> WrenchLink | None:
    """The link with a mount that is right by itself, if what was found fits better there, or than with what other effects make of it."""
    link, chosen = wrench_link_of(explanation.residual), explanation.chosen
    if not link.stepped or not explanation.departs or not chosen.causes or JITTER in chosen.kinds:
        return None
    other = link.reading(exact=chosen.effects())
    there = explanation.residual.through(other)
    return other if refit(there, chosen).score < chosen.score - DETECTION * inflation(chosen) else None


def lever_under(residual: Residual, found: Fit) -> Residual:
    """With the reading of the lever that ``found`` bears out, where it leaves clearly less; itself where it does not.

    The lever is first chosen while nothing is known: torques that a late force gives are no guide to it, and in the wrong place even a
    friction that is the believed one seems to explain something.
    """
    link = wrench_link_of(residual)
    if JITTER in found.kinds or _same_at_any(link):
        return residual
    before = square(Residual(link)(found.effects()))
    tried = [refit(Residual(link.reading(lever)), found) for lever in LEVERS]  # the estimates have gone along with the wrong place
    best = min(tried, key=lambda f: f.chi2)
    there = Residual(choose_lever(link, best.effects()))
    while (again := refit(there, best)).chi2 < best.chi2 - ONE_OF_TWO:  # each step makes the other one better
        best, there = again, Residual(choose_lever(link, again.effects()))
    return there if again.chi2 < before - DETECTION * inflation(found) else residual


def ring_under(residual: Residual, found: Fit) -> Residual:
    """With a latch that resists turning or not, as ``found`` bears out clearly; itself where it does not: torques that a bias gives are
    no guide to it."""
    link = wrench_link_of(residual)
    if JITTER in found.kinds or not any(r.scenario.mechanism.captured for r in link.runs):
        return residual
    other = residual.through(link.reading(ring=1.0 - link.ring))
    return other if refit(other, found).chi2 < refit(residual, found).chi2 - DETECTION * inflation(found) else residual


def reading_under(residual: Residual, found: Fit) -> Residual:
    """With the lever, a latch that turns or not, and the steps of a mount that ``found`` bears out; itself where it bears out none."""
    levered = ring_under(lever_under(residual, found), found)
    link = wrench_link_of(levered)
    if not link.stepped or JITTER in found.kinds:
        return levered
    here = refit(levered, found)
    there = Residual(link.reading(exact=here.effects()))
    return there if refit(there, here).chi2 < here.chi2 - DETECTION * inflation(here) else levered


def another_lever(explanation: Explanation) -> WrenchLink | None:
    """The reading of the lever that what was found bears out, where it leaves clearly less or needs a cause less."""
    residual, chosen = explanation.residual, explanation.chosen
    if not explanation.departs or JITTER in chosen.kinds:
        return None
    for index, cause in enumerate(chosen.causes):
        if "lever" in cause.variant and _only_the_lever(residual, chosen, index):
            return wrench_link_of(explanation.residual).reading(cause.variant["lever"])
    if explanation.adequate or not explanation.singles:
        return None
    levered = lever_under(residual, chosen if chosen.causes else explanation.singles[0])
    return None if levered is residual else wrench_link_of(levered)


def _only_the_lever(residual: Residual, chosen: Fit, index: int) -> bool:
    """Whether a cause that brings a lever of its own pays for nothing but that."""
    there = residual.through(wrench_link_of(residual).reading(chosen.causes[index].variant["lever"]))
    causes, theta = chosen.without(index)
    fewer = fit(there, causes, [theta], tries=1) if causes else nothing(there)
    return fewer.score < chosen.score + DETECTION * inflation(chosen)


def at_a_point(explanation: Explanation) -> WrenchLink | None:
    """The link where the tip touches with its foremost point, if what was found, nothing, or a tilt fits better there.

    In the MJCF a plane is met by a ball: where the bodies turn, or the port is tilted, it is met beside that point. A facility may compute
    it at the point.
    """
    link = wrench_link_of(explanation.residual)
    if not explanation.departs or JITTER in explanation.chosen.kinds or not all(r.scenario.mechanism.flat for r in link.runs):
        return None
    other = link.reading(blunt=0.0)
    there = explanation.residual.through(other)
    tilts = [c for c in explanation.candidates if c.kind == "contact.misalignment"]
    fits = [nothing(there), *([refit(there, explanation.chosen)] if explanation.chosen.causes else [])]
    fits += [fit(there, (c,), c.grid) for c in tilts]
    return other if min(f.score for f in fits) < explanation.chosen.score - ONE_OF_TWO else None


def on_a_grid(explanation: Explanation) -> WrenchLink | None:
    """The link where readings lie between the instants of the believed physics, if what was found, or nothing, fits better there."""
    link = wrench_link_of(explanation.residual)
    if not explanation.departs or JITTER in explanation.chosen.kinds:
        return None
    other = link.reading(grid=link.runs[0].scenario.substeps)
    there = explanation.residual.through(other)
    fits = [nothing(there), *([refit(there, explanation.chosen)] if explanation.chosen.causes else [])]
    return other if min(f.score for f in fits) < explanation.chosen.score - ONE_OF_TWO else None
