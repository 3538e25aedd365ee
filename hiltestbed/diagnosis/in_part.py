"""Which causes of an explanation hold although something else is left as well.

A stand-in for what is not in the vocabulary fits the runs that it was fitted to. It has another size in every run, does not carry over to
runs that were left out, ends at a bound of its search, or does no better than other effects in its place. A cause does none of these.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Fit, at_bound, fit, inflation
from hiltestbed.diagnosis.grow import carried
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation, Search, first_of_each
from hiltestbed.diagnosis.settings import AMBIGUITY, AS_GOOD, CARRIED, INVARIANT, MOST_RUNS, PARTNERS, WORTH_IN_PART
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

LEAST_RUNS = 3
LEAST_LONG_RUNS = 2  # of which each holds many witnesses
SIZES = (1.0, 0.7, 1.4)  # chosen: of a cause, from which it is fitted to a run alone, well beyond what may differ from run to run


def holding(found: Explanation) -> tuple[int, ...]:
    """Numbers of the causes of the chosen fit that hold; none where too few runs can tell."""
    if not _tells(found):
        return ()
    alone = in_each_run(found)
    return tuple(i for i in range(len(found.chosen.causes)) if _same(found, alone, i) and _pays_without_rival(found, i))


def borne_out(found: Explanation) -> Explanation | None:
    """An explanation that leaves noise alone, with what rivals its causes, where each of them is the same in most runs and carries over.

    So many causes explain much by chance; what they stand in for does not pass that. None where one of them does not either.
    """
    if not found.adequate or not _tells(found):
        return None
    alone, residual, chosen = in_each_run(found), found.residual, found.chosen
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
    known = replace(found, rivals=tuple(rivals), more=(*found.more, *fewer))
    return known.with_the_other_clock(contact_leftovers)


def _noise(residual: Residual, found: Fit) -> bool:
    return noise_alone(contact_leftovers(residual, found.effects()))


def _tells(found: Explanation) -> bool:
    """Whether there are enough runs, and enough of the departure is carried over to those left out."""
    few = len(found.residual.runs) < _least(found) or not found.chosen.causes
    return not few and JITTER not in found.chosen.kinds and explained(found) >= CARRIED


def in_each_run(found: Explanation) -> list[list[Fit]]:
    """Of each run alone, the chosen causes as they fit it: all that fit as well as the best.

    They are started where they are, smaller and larger. What fits all runs is among them too, as it is: in a run that hardly parts two
    causes, each start ends elsewhere in a long valley, and none where it began.
    """
    out, chosen = [], found.chosen
    for i in found.residual.runs:
        run = found.residual.on([i])
        left = run(chosen.effects())
        fits = [replace(chosen, chi2=square(left), residual=left)]
        fits += [fit(run, chosen.causes, [_resized(chosen, size)], tries=1) for size in SIZES]
        best = min(fits, key=lambda f: f.chi2)
        out.append([f for f in fits if f.chi2 <= best.chi2 + AMBIGUITY * inflation(best)])
    return out


def _resized(chosen: Fit, size: float) -> Array:
    """The parameters of a fit with each cause ``size`` times as large."""
    theta = chosen.theta.copy()
    for i, cause in enumerate(chosen.causes):
        at = [sum(len(c.names) for c in chosen.causes[:i]) + j for j in _leading(cause)]
        theta[at] = _neutral(cause) + size * (theta[at] - _neutral(cause))
    return theta


def _leading(cause: Candidate) -> list[int]:
    """Which of a cause's parameters are its size."""
    return [j for j, name in enumerate(cause.names) if name.partition(".")[0] == cause.effect.leading] or list(range(len(cause.names)))


def _neutral(cause: Candidate) -> float:
    return 1.0 if cause.effect.leading == "factor" else 0.0


def _same(found: Explanation, alone: list[list[Fit]], index: int) -> bool:
    chosen = found.chosen
    return not at_bound(chosen.causes[index], chosen.part(index)) and same_in_each(chosen, alone, index, _least(found))


def _least(found: Explanation) -> int:
    return LEAST_LONG_RUNS if found.residual.link.witnesses else LEAST_RUNS


def explained(found: Explanation) -> float:
    """Share of the departure, in mean square beyond the noise, that the chosen fit carries on runs that were left out."""
    before, after = (math.exp(2.0 * carried(found.residual, f)) - 1.0 for f in (found.null, found.chosen))
    return 1.0 - max(after, 0.0) / before if before > 0.0 else 0.0


def same_in_each(chosen: Fit, alone: list[list[Fit]], index: int, least: int) -> bool:
    """Whether most runs alone give a cause its size in all, and ``least`` of them do.

    A run that any size fits as well says nothing of it.
    """
    cause = chosen.causes[index]
    leading, neutral = _leading(cause), _neutral(cause)
    size = chosen.part(index)[leading] - neutral
    scale = float(np.linalg.norm(size))
    if not leading or scale == 0.0:
        return False
    off = [[float(np.linalg.norm(f.part(index)[leading] - neutral - size)) <= INVARIANT * scale for f in fits] for fits in alone]
    same, other = sum(all(near) for near in off), sum(not any(near) for near in off)
    return same >= max(least, MOST_RUNS * (same + other))


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
