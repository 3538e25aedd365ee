"""Stage "explain": interpretations of a facility: how it computes its contact where its description
leaves that open; the data decide.

Open are where between tip and surface the force acts (the lever), whether a latch resists turning,
whether a point or a ball meets a plane, and whether readings lie between the instants of the
believed physics. None of it is a departure, but with a wrong interpretation a search finds
departures that are not there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import INTERPRETATION_PENALTY

LEVERS = (0.5, 0.0, 1.0)  # chosen: that are tried first: the middle, the surface, the tip


def choose_lever(link: WrenchLink, effects: Effects = ()) -> WrenchLink:
    """The link with the lever that fits the torques best under ``effects``."""
    if not link.acts_across(effects):
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
