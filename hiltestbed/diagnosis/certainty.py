"""Stage "decide": how well the data determine the estimates of a fit: correlation, cost around each
estimate, and bounds that were met.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hiltestbed.diagnosis.fit import BOUND_TOLERANCE, Bounds, Fit, Trials, fit
from hiltestbed.diagnosis.intervals import Spread, intervals
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.timing import DELAY_EFFECTS, fit_with_timing, instants_off, timing_found
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

PROFILE_REACH = 2.0  # chosen: of a profile to each side, in half-widths of the 95 % interval
PROFILE_POINTS = 9  # chosen: values of a profile
PRIOR_SHARE = 0.95  # derived: of a range, that its uniform prior's 95 % interval has


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
        ends: (P, 2) of the 95 % intervals.
    """

    link: str
    profiles: tuple[Profile, ...]
    correlation: Array
    ends: Array

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


class Certainties:
    """The certainty of each fit of a diagnosis, computed once however many causes are named."""

    def __init__(self, explanations: Mapping[str, Explanation]) -> None:
        self._explanations = explanations
        self._known: dict[Fit, Certainty] = {}

    def of(self, link: str, found: Fit) -> Certainty:
        """The certainty of a fit to the link."""
        if found not in self._known:
            e = self._explanations[link]
            self._known[found] = certainty(
                link, e.residual, found, e.candidates, instants_off(self._explanations)
            )
        return self._known[found]

    def __iter__(self):
        return (c for c in self._known.values() if c.profiles)


def certainty(
    link: str,
    residual: Residual,
    found: Fit,
    candidates: Sequence[Candidate] = (),
    off: float = 0.0,
) -> Certainty:
    """The certainty of a fit to the residual of a link.

    Args:
        candidates: that were compared, for the variants of its causes.
        off: [s] by which instants of the facility may be off, which no channel tells from a delay.
    """
    spread = intervals(residual, found)
    wider = _with_variants(residual, found, _with_timing(residual, found, spread.ends), candidates)
    spread = replace(spread, ends=_with_instants(found, wider, off) if off else wider)
    bounds = Bounds.of(found.causes)
    close = BOUND_TOLERANCE * bounds.scales(found.theta)
    base = square(residual(found.effects()))
    profiles, names = [], [(c, name) for c in found.causes for name in c.names]
    for j, (c, name) in enumerate(names):
        at = float(found.theta[j])
        low, high = float(bounds.low[j]), float(bounds.high[j])
        met = "lowest" if at - low <= close[j] else "highest" if high - at <= close[j] else None
        values, costs = _profile(residual, found, spread, j)
        ends = (float(spread.ends[j, 0]), float(spread.ends[j, 1]))
        rise = (costs - base) / spread.misfit
        unit = _unit(c, name.partition(".")[0])
        of = ", ".join(str(v) for v in c.fixed.values() if isinstance(v, str))
        profiles.append(Profile(c.kind, name, unit, of, at, ends, (low, high), met, values, rise))
    return Certainty(link, tuple(profiles), spread.correlation, spread.ends)


def spans_its_range(found: Fit, index: int, ends: Array) -> bool:
    """Whether the 95 % interval of the leading parameter of a cause of a fit is as wide as that of
    its prior, which is uniform over the range of the search: then the data do not determine it. Of
    a vector: of every item.
    """
    cause, here, (low, high, log) = found.causes[index], found.place(index), Bounds.of(found.causes)
    leads = np.array([n.partition(".")[0] == cause.effect.leading for n in cause.names], dtype=bool)
    if not leads.any():
        return False
    rows = np.column_stack([ends, low, high])[here][leads]
    rows[log[here][leads]] = np.log(rows[log[here][leads]])
    widths, ranges = rows[:, 1] - rows[:, 0], rows[:, 3] - rows[:, 2]
    return not np.any(widths < PRIOR_SHARE * ranges)


def _with_variants(
    residual: Residual, found: Fit, ends: Array, candidates: Sequence[Candidate]
) -> Array:
    """(P, 2) ends of the intervals, wide enough for those variants of each cause that have a
    parameter of the facility beside its own.

    A response that is integrated step by step answers early by some of a tick: too little to be
    preferred, and enough to bias an estimate. Other ways of stepping may differ from the variant by
    as much as it does from none.
    """
    out = ends.copy()
    for i, cause in enumerate(found.causes):
        here = found.place(i)
        for other in candidates:
            beside = set(other.names) - set(cause.names)
            same = (
                other.kind == cause.kind
                and other.fixed == cause.fixed
                and set(cause.names) < set(other.names)
            )
            if not same or any(name in cause.effect.model_fields for name in beside):
                continue
            known = dict(zip(cause.names, found.part(i), strict=True))
            start = [
                known.get(name, value)
                for name, value in zip(other.names, other.grid[0], strict=True)
            ]
            causes = (*found.causes[:i], other, *found.causes[i + 1 :])
            whole = np.concatenate([found.theta[: here.start], start, found.theta[here.stop :]])
            again = fit(residual, causes, [whole], tries=1)
            own = [here.start + other.names.index(name) for name in cause.names]
            out[here] = _widened(out[here], residual, again, own, found.part(i))
    return out


def _widened(ends: Array, residual: Residual, again: Fit, own: list[int], theta: Array) -> Array:
    """(n, 2) ``ends`` of the intervals of theta (n,), wide enough for another estimate of it,
    ``own`` in the fit ``again``, and for as much beyond as that differs.
    """
    there, shift = intervals(residual, again).ends[own], np.abs(again.theta[own] - theta)
    low = np.minimum(ends[:, 0], there[:, 0] - shift)
    return np.column_stack([low, np.maximum(ends[:, 1], there[:, 1] + shift)])


def _with_timing(residual: Residual, found: Fit, ends: Array) -> Array:
    """(P, 2) ends of the intervals, wide enough for the timing of the link, where that was
    estimated as well.

    A platform that answers later and one that is stamped later differ little: the bandwidth of a
    lag is known no better than the stamp.
    """
    shift = timing_found(residual.link)
    if shift is None or not found.causes:
        return ends
    again = fit_with_timing(residual, found, shift, starts=[np.zeros(len(shift.names))])
    return _widened(ends, residual, again, list(range(len(found.theta))), found.theta)


def _with_instants(found: Fit, ends: Array, off: float) -> Array:
    """(P, 2) ends of the intervals, those of delays wider by ``off`` [s] on each side."""
    names = [(c.kind, name) for c in found.causes for name in c.names]
    wider = np.array(
        [off if kind in DELAY_EFFECTS and name == "delay" else 0.0 for kind, name in names]
    )
    return Bounds.of(found.causes).clip((ends + wider[:, None] * np.array([-1.0, 1.0])).T).T


def _unit(c: Candidate, name: str) -> str:
    """The unit of a parameter; a parameter that is not the effect's is the log's stamp delay."""
    return c.effect.unit(name) if name in c.effect.model_fields else "s"


def _profile(residual: Residual, found: Fit, spread: Spread, j: int) -> tuple[Array, Array]:
    """Values of parameter j, and chi-square there with the others moved by linear regression."""
    trials = Trials(residual, found.causes)
    bounds, scale = trials.bounds, trials.bounds.scales(found.theta)
    reach = np.linspace(-PROFILE_REACH, PROFILE_REACH, PROFILE_POINTS)
    side = np.where(
        reach < 0.0, found.theta[j] - spread.ends[j, 0], spread.ends[j, 1] - found.theta[j]
    )
    values = np.unique(np.clip(found.theta[j] + reach * side, bounds.low[j], bounds.high[j]))
    thetas = np.tile(found.theta, (len(values), 1))
    others = np.flatnonzero(spread.determined & (np.arange(len(scale)) != j))
    if len(others) and spread.determined[j]:
        follow = -np.linalg.lstsq(
            spread.normal[np.ix_(others, others)], spread.normal[others, j], rcond=None
        )[0]
        thetas[:, others] += (values - found.theta[j])[:, None] / scale[j] * follow * scale[others]
    thetas[:, j] = values
    return values, np.array([square(r) for r in trials(bounds.clip(thetas))])
