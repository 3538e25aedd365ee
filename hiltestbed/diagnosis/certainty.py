"""Stage "decide": how well the data determine the estimates of a fit: correlation, cost around each
estimate, and bounds that were met.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import Likelihood

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

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return vars(self)


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
        names = [p.label for p in self.profiles]
        return {
            "link": self.link,
            "parameters": names,
            "correlation": self.correlation,
            "profiles": [p.to_json() for p in self.profiles],
        }


def certainty(link: str, e: Explanation) -> Certainty:
    """The certainty of the causes of an explanation; the nuisances of their fit follow."""
    fit, likelihood = e.fit, e.likelihood
    x = np.concatenate([fit.of.theta, fit.of.nuisances])
    slopes = likelihood.slopes(fit.causes, x, fit.left)
    normal, _ = likelihood.normal(fit.left, slopes)
    determined = np.diag(normal) > FLAT_CURVATURE * max(1.0, float(np.max(np.diag(normal))))
    normal[~determined], normal[:, ~determined] = 0.0, 0.0
    normal[~determined, ~determined] = 1.0
    names = [(c, name) for c in fit.causes for name in c.names]
    low, high = (np.concatenate([getattr(c, end) for c in fit.causes]) for end in ("low", "high"))
    profiles, asked = [], [j for j, (c, _) in enumerate(names) if c.sigma is None]
    for j in asked:
        c, name = names[j]
        at, ends = float(x[j]), e.conclusion.ends[j]
        close = BOUND_TOLERANCE * (abs(at) if c.log[c.names.index(name)] else high[j] - low[j])
        met = "lowest" if at - low[j] <= close else "highest" if high[j] - at <= close else None
        values = _values(at, ends, (float(low[j]), float(high[j])))
        rise = _rises(e, likelihood, x, normal, determined, j, values)
        of = ", ".join(str(v) for v in c.fixed.values() if isinstance(v, str))
        profiles.append(
            Profile(
                *(c.kind, name, _unit(c, name.partition(".")[0]), of, at),
                (float(ends[0]), float(ends[1])),
                (float(low[j]), float(high[j])),
                *(met, values, rise),
            )
        )
    inverse = np.linalg.pinv(normal, hermitian=True)
    root = np.sqrt(np.maximum(np.diag(inverse), np.finfo(float).tiny))
    correlation = np.clip(inverse / np.outer(root, root), -1.0, 1.0)
    correlation[~determined], correlation[:, ~determined] = np.nan, np.nan
    return Certainty(link, tuple(profiles), correlation[np.ix_(asked, asked)])


def _values(at: float, ends: Array, bounds: tuple[float, float]) -> Array:
    """Values of a parameter around its estimate, within its bounds."""
    reach = np.linspace(-PROFILE_REACH, PROFILE_REACH, PROFILE_POINTS)
    side = np.where(reach < 0.0, at - ends[0], ends[1] - at)
    return np.unique(np.clip(at + reach * side, *bounds))


def _rises(
    e: Explanation,
    likelihood: Likelihood,
    x: Array,
    normal: Array,
    determined: np.ndarray,
    j: int,
    values: Array,
) -> Array:
    """Of the cost over that of the fit, at ``values`` of number j of ``x``, the others moved by
    linear regression.
    """
    fit, scale = e.fit, likelihood.scale_of(e.fit.causes, x)
    low, high, _ = likelihood.bounds(fit.causes)
    points = np.tile(x, (len(values), 1))
    others = np.flatnonzero(determined & (np.arange(len(x)) != j))
    if len(others) and determined[j]:
        follow = -np.linalg.lstsq(normal[np.ix_(others, others)], normal[others, j], rcond=None)[0]
        points[:, others] += (values - x[j])[:, None] / scale[j] * follow * scale[others]
    points[:, j] = values
    costs = [
        likelihood.cost(left) for left in likelihood.lefts(fit.causes, [*points.clip(low, high)])
    ]
    return np.array(costs) - likelihood.cost(fit.left)


def _unit(c: Candidate, name: str) -> str:
    """The unit of a parameter; a parameter that is not the effect's is the log's stamp delay."""
    return c.effect.unit(name) if name in c.effect.model_fields else "s"
