"""Which causes of an explanation hold although something else is left as well.

A stand-in for what is not in the vocabulary fits the runs that it was fitted to. It has another size in every run, does not carry over to
runs that were left out, ends at a bound of its search, or does no better than other effects in its place. A cause does none of these.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER
from hiltestbed.diagnosis.fit import Fit, at_bound, fit, inflation
from hiltestbed.diagnosis.grow import carried
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import AMBIGUITY, AS_GOOD, CARRIED, INVARIANT, MOST_RUNS, PARTNERS, WORTH_IN_PART

LEAST_RUNS = 3
LEAST_LONG_RUNS = 2  # of which each holds many witnesses


def holding(found: Explanation) -> tuple[int, ...]:
    """Numbers of the causes of the chosen fit that hold; none where too few runs can tell."""
    residual, chosen = found.residual, found.chosen
    least = LEAST_LONG_RUNS if residual.link.witnesses else LEAST_RUNS
    if len(residual.runs) < least or not chosen.causes or JITTER in chosen.kinds or explained(found) < CARRIED:
        return ()
    alone = [fit(residual.on([i]), chosen.causes, [chosen.theta], tries=1) for i in residual.runs]
    return tuple(
        i
        for i, cause in enumerate(chosen.causes)
        if not at_bound(cause, chosen.part(i)) and same_in_each(chosen, alone, i) and _pays_without_rival(found, i)
    )


def explained(found: Explanation) -> float:
    """Share of the departure, in mean square beyond the noise, that the chosen fit carries on runs that were left out."""
    before, after = (math.exp(2.0 * carried(found.residual, f)) - 1.0 for f in (found.null, found.chosen))
    return 1.0 - max(after, 0.0) / before if before > 0.0 else 0.0


def same_in_each(chosen: Fit, alone: list[Fit], index: int) -> bool:
    """Whether most runs alone give the leading parameter of a cause its size in all."""
    cause = chosen.causes[index]
    leading = [j for j, name in enumerate(cause.names) if name.partition(".")[0] == cause.effect.leading] or list(range(len(cause.names)))
    neutral = 1.0 if cause.effect.leading == "factor" else 0.0
    size = chosen.part(index)[leading] - neutral
    scale = float(np.linalg.norm(size))
    if not leading or scale == 0.0:
        return False
    off = [float(np.linalg.norm(f.part(index)[leading] - neutral - size)) for f in alone]
    return sum(o <= INVARIANT * scale for o in off) >= MOST_RUNS * len(off)


def _pays_without_rival(found: Explanation, index: int) -> bool:
    """Whether a cause carries over to left-out runs beside the others, and no other effect does as much in its place."""
    residual, chosen = found.residual, found.chosen
    causes, theta = chosen.without(index)
    fewer = fit(residual, causes, [theta], tries=1) if causes else found.null
    if carried(residual, fewer) - carried(residual, chosen) < WORTH_IN_PART:
        return False
    margin = max(AMBIGUITY * inflation(chosen), AS_GOOD * (fewer.chi2 - chosen.chi2))
    return not any(rival.score < chosen.score + margin for rival in _in_its_place(found, residual, fewer, chosen.causes[index].kind))


def _in_its_place(found: Explanation, residual: Residual, fewer: Fit, kind: str) -> list[Fit]:
    others = tuple(c for c in found.candidates if c.kind != kind)
    return Search(others).extend(residual, fewer, PARTNERS)
