"""Stage "decide": how well the data determine the estimates of a fit: correlation, cost around each
estimate, and bounds that were met.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit

PROFILE_REACH = 2.0  # of a profile to each side, in half-widths of the 95 % interval
PROFILE_POINTS = 9  # values of a profile: a parabola shows, and whether it is one
BOUND_TOLERANCE = 1e-3  # of the range of a search, within which an estimate stands at its bound
FLAT_CURVATURE = 1e-14  # of the largest curvature: round-off of a normal matrix of some 1e5 rows


@dataclass(frozen=True, eq=False)
class Profile:
    """The cost of holding one parameter at a value while the others of its fit follow along the
    valley of chi-square.

    Attributes:
        effect, parameter, unit: of the parameter; a component of a vector is NAME.NUMBER. of: axis
            or body, where the effect has one.
        estimate: of it. ci95: its 95 % interval.
        bounds: of the search. met: `lowest` or `highest`, the bound at which the estimate stands,
            or None.
        values: (n,) ascending. rise: (n,) of chi-square over that of the estimate, in units of the
            misfit per sample.
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


@dataclass(frozen=True, eq=False)
class Certainty:
    """The uncertainty of the parameters that were fitted together on one link.

    Attributes:
        link: of the loop. profiles: of each parameter. correlation: (P, P) of the estimates, in the
            order of the profiles.
    """

    link: str
    profiles: tuple[Profile, ...]
    correlation: Array

    def strongest(self) -> tuple[Profile, Profile, float] | None:
        """The two parameters with the most correlated estimates, and that; None without a pair."""
        size = np.abs(np.nan_to_num(np.triu(self.correlation, 1)))
        if not size.any():
            return None
        i, j = np.unravel_index(int(np.argmax(size)), size.shape)
        return self.profiles[i], self.profiles[j], float(self.correlation[i, j])

    def to_json(self) -> dict[str, Any]:
        """Plain data: the names of the rows of the correlation, and the profiles."""
        names, profiles = [p.label for p in self.profiles], [vars(p) for p in self.profiles]
        return vars(self) | {"parameters": names, "profiles": profiles}


def certainty(link: str, e: Explanation) -> Certainty:
    """The certainty of the causes of an explanation; the nuisances of their fit follow."""
    fit, likelihood = e.fit, e.likelihood
    x = np.concatenate([fit.of.theta, fit.of.nuisances])
    normal, _ = likelihood.normal(fit.left, likelihood.slopes(fit.causes, x, fit.left))
    determined = np.diag(normal) > FLAT_CURVATURE * max(1.0, float(np.max(np.diag(normal))))
    normal[~determined], normal[:, ~determined] = 0.0, 0.0
    normal[~determined, ~determined] = 1.0
    low, high, log = likelihood.bounds(fit.causes)
    names = [(c, name) for c in fit.causes for name in c.names]
    profiles, count = [], len(names)
    for j, (c, name) in enumerate(names):
        at, bounds = float(x[j]), (float(low[j]), float(high[j]))
        ends = float(e.conclusion.ends[j, 0]), float(e.conclusion.ends[j, 1])
        close = BOUND_TOLERANCE * (abs(at) if log[j] else high[j] - low[j])
        met = "lowest" if at - low[j] <= close else "highest" if high[j] - at <= close else None
        # around the estimate, within its bounds
        reach = np.linspace(-PROFILE_REACH, PROFILE_REACH, PROFILE_POINTS)
        side = np.where(reach < 0.0, at - ends[0], ends[1] - at)
        values = np.unique(np.clip(at + reach * side, *bounds))
        rise = _rises(likelihood, fit, x, np.where(determined, normal, 0.0), j, values)
        of = ", ".join(str(v) for v in c.fixed.values() if isinstance(v, str))
        profiles.append(
            Profile(c.kind, name, c.unit(name), of, at, ends, bounds, met, values, rise)
        )
    inverse = np.linalg.pinv(normal, hermitian=True)
    root = np.sqrt(np.maximum(np.diag(inverse), np.finfo(float).tiny))
    correlation = np.clip(inverse / np.outer(root, root), -1.0, 1.0)
    correlation[~determined], correlation[:, ~determined] = np.nan, np.nan
    return Certainty(link, tuple(profiles), correlation[:count, :count])


def _rises(
    likelihood: Likelihood, fit: PosteriorFit, x: Array, normal: Array, j: int, values: Array
) -> Array:
    """Of the cost over that of the fit, at ``values`` of number j of ``x``, the others that are
    determined, with a row in ``normal``, moved by linear regression.
    """
    scale, (low, high, _) = likelihood.scale_of(fit.causes, x), likelihood.bounds(fit.causes)
    points = np.tile(x, (len(values), 1))
    others = np.flatnonzero((np.diag(normal) > 0.0) & (np.arange(len(x)) != j))
    if len(others) and normal[j, j] > 0.0:
        follow = -np.linalg.lstsq(normal[np.ix_(others, others)], normal[others, j], rcond=None)[0]
        points[:, others] += (values - x[j])[:, None] / scale[j] * follow * scale[others]
    points[:, j] = values
    lefts = likelihood.lefts(fit.causes, [*points.clip(low, high)])
    return np.array([likelihood.cost(left) for left in lefts]) - likelihood.cost(fit.left)
