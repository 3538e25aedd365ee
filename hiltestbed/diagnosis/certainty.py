"""How well the data hold the estimates of a fit: their correlation, the cost around each, and bounds of the search that were met."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.diagnosis.fit import Fit, bounds_of, effects_at, scales
from hiltestbed.diagnosis.intervals import Spread, intervals
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

REACH = 2.0  # ends of the 95 % interval, as far as a profile goes to each side
PLACES = 9  # of a profile
AT_BOUND = 1e-3  # of a parameter's scale


@dataclass(frozen=True, eq=False)
class Profile:
    """The cost of holding one parameter at a value, to which the others of its fit follow along the valley of the fit.

    Attributes:
        effect, parameter, unit: whose; an item of a vector is NAME.NUMBER. of: axis or body, where the effect has one.
        estimate: of it. ci95: its 95 % interval.
        bounds: of the search. met: `lowest` or `highest`, the bound at which the estimate stands, or None.
        values: (n,) ascending. rise: (n,) of chi-square over that of the estimate, in units of the misfit a sample.
    """

    effect: str
    parameter: str
    unit: str
    of: str
    estimate: float
    ci95: tuple[float, float]
    bounds: tuple[float, float]
    met: str | None
    values: Array
    rise: Array

    @property
    def label(self) -> str:
        return f"{self.effect} {self.parameter}" + (f" ({self.of})" if self.of else "")

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return vars(self)


@dataclass(frozen=True, eq=False)
class Certainty:
    """Of the parameters that were fitted together on one link.

    Attributes:
        link: of the loop. profiles: of each parameter. correlation: (P, P) of the estimates, in the order of the profiles.
        ends: (P, 2) of the 95 % intervals.
    """

    link: str
    profiles: tuple[Profile, ...]
    correlation: Array
    ends: Array

    def strongest(self) -> tuple[Profile, Profile, float] | None:
        """The pair of parameters whose estimates hang together most, and their correlation; None where there is no pair."""
        size = np.abs(np.nan_to_num(np.triu(self.correlation, 1)))
        if not size.any():
            return None
        i, j = np.unravel_index(int(np.argmax(size)), size.shape)
        return self.profiles[i], self.profiles[j], float(self.correlation[i, j])

    def to_json(self) -> dict[str, Any]:
        """Plain data: the names beside the rows of the correlation."""
        names = [p.label for p in self.profiles]
        return {"link": self.link, "parameters": names, "correlation": self.correlation, "profiles": [p.to_json() for p in self.profiles]}


class Certainties:
    """Of the fits of a diagnosis, each worked out once however many of its causes are named."""

    def __init__(self, explanations: Mapping[str, Explanation]) -> None:
        self._explanations = explanations
        self._known: dict[Fit, Certainty] = {}

    def of(self, link: str, found: Fit) -> Certainty:
        """Of a fit to the link."""
        if found not in self._known:
            self._known[found] = certainty(link, self._explanations[link].residual, found)
        return self._known[found]

    def __iter__(self):
        return (c for c in self._known.values() if c.profiles)


def certainty(link: str, residual: Residual, found: Fit) -> Certainty:
    """Of a fit to the residual of a link."""
    spread = intervals(residual, found)
    low, high, log = bounds_of(found.causes)
    close = AT_BOUND * scales(found.theta, low, high, log) if len(found.theta) else np.zeros(0)
    base = square(residual(found.effects()))
    profiles, names = [], [(c, name) for c in found.causes for name in c.names]
    for j, (c, name) in enumerate(names):
        at = float(found.theta[j])
        met = "lowest" if at - low[j] <= close[j] else "highest" if high[j] - at <= close[j] else None
        values, costs = _profile(residual, found, spread, j)
        ends, bounds = (float(spread.ends[j, 0]), float(spread.ends[j, 1])), (float(low[j]), float(high[j]))
        rise = (costs - base) / spread.misfit
        unit, of = _unit(c, name.partition(".")[0]), ", ".join(str(v) for v in c.fixed.values() if isinstance(v, str))
        profiles.append(Profile(c.kind, name, unit, of, at, ends, bounds, met, values, rise))
    return Certainty(link, tuple(profiles), spread.correlation, spread.ends)


def _unit(c: Candidate, name: str) -> str:
    """The unit of a parameter; what is fitted beside those of the effect is how late the log stamps its rows."""
    return c.effect.unit(name) if name in c.effect.model_fields else "s"


def _profile(residual: Residual, found: Fit, spread: Spread, j: int) -> tuple[Array, Array]:
    """Values of parameter j around its estimate, and chi-square there with the others where the curvature at the estimate sends them."""
    low, high, log = bounds_of(found.causes)
    scale = scales(found.theta, low, high, log)
    reach = np.linspace(-REACH, REACH, PLACES)
    side = np.where(reach < 0.0, found.theta[j] - spread.ends[j, 0], spread.ends[j, 1] - found.theta[j])
    values = np.unique(np.clip(found.theta[j] + reach * side, low[j], high[j]))
    thetas = np.tile(found.theta, (len(values), 1))
    others = np.flatnonzero(spread.told & (np.arange(len(scale)) != j))
    if len(others) and spread.told[j]:
        follow = -np.linalg.lstsq(spread.normal[np.ix_(others, others)], spread.normal[others, j], rcond=None)[0]
        thetas[:, others] += (values - found.theta[j])[:, None] / scale[j] * follow * scale[others]
    thetas[:, j] = values
    thetas = np.clip(thetas, low, high)
    return values, np.array([square(r) for r in residual.many([effects_at(found.causes, theta) for theta in thetas])])
