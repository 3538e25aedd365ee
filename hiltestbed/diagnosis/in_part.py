"""Which causes of an explanation hold although something else is left as well.

A stand-in for what is not in the vocabulary fits the runs that it was fitted to. It has another size in every run, does not carry over to
runs that were left out, ends at a bound of its search, or does no better than other effects in its place. A cause does none of these.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers
from hiltestbed.diagnosis.fit import Fit, at_bound, fit, inflation
from hiltestbed.diagnosis.grow import carried
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search, first_of_each
from hiltestbed.diagnosis.settings import AMBIGUITY, AS_GOOD, CARRIED, INVARIANT, MOST_RUNS, PARTNERS, WORTH_IN_PART

LEAST_RUNS = 3
LEAST_LONG_RUNS = 2  # of which each holds many witnesses


def holding(found: Explanation) -> tuple[int, ...]:
    """Numbers of the causes of the chosen fit that hold; none where too few runs can tell."""
    if not _tells(found):
        return ()
    alone = _alone(found)
    return tuple(i for i in range(len(found.chosen.causes)) if _same(found, alone, i) and _pays_without_rival(found, i))


def borne_out(found: Explanation) -> Explanation | None:
    """An explanation that leaves noise alone, with what rivals its causes, where each of them is the same in most runs and carries over.

    So many causes explain much by chance; what they stand in for does not pass that. None where one of them does not either.
    """
    if not found.adequate or not _tells(found):
        return None
    alone, residual, chosen = _alone(found), found.residual, found.chosen
    fewer, rivals = [], []
    for i, cause in enumerate(chosen.causes):
        rest = _without(found, i)
        if not _same(found, alone, i) or not _carries(found, rest):
            return None
        near = chosen.score + AMBIGUITY * inflation(chosen)
        others = _in_its_place(found, residual, rest, cause.kind)
        best = min(others, key=lambda f: f.score, default=chosen)
        if best.score < chosen.score:
            return borne_out(replace(found, chosen=best)) if _noise(residual, best) else None
        close = [f for f in others if f.score < near]
        rivals.append(tuple(first_of_each([f for f in close if _noise(residual, f)], "kinds")))
        fewer.append(rest)
    return replace(found, rivals=tuple(rivals), more=(*found.more, *fewer))


def _noise(residual: Residual, found: Fit) -> bool:
    return all(left.noise for left in contact_leftovers(residual, found.effects()).values())


def _tells(found: Explanation) -> bool:
    """Whether there are enough runs, and enough of the departure is carried over to those left out."""
    least = LEAST_LONG_RUNS if found.residual.link.witnesses else LEAST_RUNS
    few = len(found.residual.runs) < least or not found.chosen.causes
    return not few and JITTER not in found.chosen.kinds and explained(found) >= CARRIED


def _alone(found: Explanation) -> list[Fit]:
    """The chosen causes, fitted to each run alone."""
    return [fit(found.residual.on([i]), found.chosen.causes, [found.chosen.theta], tries=1) for i in found.residual.runs]


def _same(found: Explanation, alone: list[Fit], index: int) -> bool:
    chosen = found.chosen
    return not at_bound(chosen.causes[index], chosen.part(index)) and same_in_each(chosen, alone, index)


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
    fewer = _without(found, index)
    if not _carries(found, fewer):
        return False
    margin = max(AMBIGUITY * inflation(chosen), AS_GOOD * (fewer.chi2 - chosen.chi2))
    return not any(rival.score < chosen.score + margin for rival in _in_its_place(found, residual, fewer, chosen.causes[index].kind))


def _without(found: Explanation, index: int) -> Fit:
    """The chosen fit with one cause less."""
    causes, theta = found.chosen.without(index)
    return fit(found.residual, causes, [theta], tries=1) if causes else found.null


def _carries(found: Explanation, fewer: Fit) -> bool:
    """Whether the chosen fit leaves so much less on left-out runs than ``fewer`` causes do."""
    return carried(found.residual, fewer) - carried(found.residual, found.chosen) >= WORTH_IN_PART


def _in_its_place(found: Explanation, residual: Residual, fewer: Fit, kind: str) -> list[Fit]:
    others = tuple(c for c in found.candidates if c.kind != kind)
    return Search(others).extend(residual, fewer, PARTNERS)
