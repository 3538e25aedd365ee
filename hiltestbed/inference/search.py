"""The causes that have the most evidence: hypotheses grow by one cause at a time, or by two where
neither helps alone, and shrink by any that the others have made needless.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.effects.search import Candidate
from hiltestbed.inference.likelihood import Fit, Likelihood, Move, independent

Progress = Callable[[str], None]
MOST_CAUSES = 10  # parts of effects; more than twice as many as any of the machines at hand has
KEPT = 4  # candidates that are fitted beside a hypothesis
PAIRED = 3  # candidates beside which a second one is sought where none helps alone


@dataclass(frozen=True)
class Searched:
    """What a search found.

    Attributes:
        likelihood: with the counts of the best hypothesis. best: the hypothesis with the most
            evidence. visited: every hypothesis that was fitted, once each, scored by that
            likelihood, best first. null: nothing departs.
    """

    likelihood: Likelihood
    best: Fit
    visited: tuple[Fit, ...]
    null: Fit


def search(
    likelihood: Likelihood, candidates: Sequence[Candidate], progress: Progress | None = None
) -> Searched:
    """The hypothesis with the most evidence that is reached from nothing by adding a cause, adding
    two, leaving one out, or putting another one in its place.
    """
    likelihood = Likelihood(
        likelihood.model, likelihood.counts, max(1, len({c.kind for c in candidates}))
    )
    null = best = likelihood.start()
    visited: dict[tuple[str, ...], Fit] = {}
    tried: set[tuple[str, ...]] = set()
    while len(best.causes) < MOST_CAUSES:
        # the counts are those of what the present hypothesis leaves: it is smoother than what a
        # better one leaves, and fewer of its samples are independent
        here = likelihood.counting(independent(best.left))
        best = here.again(best)
        visited[best.keys] = best
        if best.keys in tried:
            break
        tried.add(best.keys)
        better = None
        for way in (_added, _paired, _exchanged):
            if progress:
                progress(f"{WORDS[way.__name__]} {named(best)}")
            fits = way(here, best, candidates, visited)
            better = max(fits, key=lambda f: f.evidence, default=None)
            if better is not None and better.evidence > best.evidence:
                break
            better = None
        if better is None:
            break
        best = pruned(here, better)
    last = likelihood.counting(independent(best.left))
    scored = sorted((last.again(f) for f in visited.values()), key=lambda f: -f.evidence)
    return Searched(last, scored[0], tuple(scored), last.again(null))


WORDS = {
    "_added": "another cause beside",
    "_paired": "two more beside",
    "_exchanged": "another in place of one of",
}


def _added(here, best, candidates, visited) -> list[Fit]:
    fits = extended(here, best, candidates)
    visited.update({f.keys: f for f in fits})
    return fits


def _paired(here, best, candidates, visited) -> list[Fit]:
    """Two more causes, where each alone costs more than it explains."""
    out: list[Fit] = []
    for first in [visited[k] for k in list(visited) if _beside(visited[k], best)][:PAIRED]:
        out += extended(here, here.again(first), candidates)[:1]
    visited.update({f.keys: f for f in out})
    return out


def _beside(found: Fit, base: Fit) -> bool:
    """Whether a fit has the causes of ``base`` and one more."""
    return len(found.causes) == len(base.causes) + 1 and set(base.keys) <= set(found.keys)


def _exchanged(here, best, candidates, visited) -> list[Fit]:
    """Another cause in place of each one and of what is a part of it."""
    out: list[Fit] = []
    for index in range(len(best.causes)):
        fewer = without(here, best, index)
        visited[fewer.keys] = fewer
        gone = {str(c.key) for c in best.causes} - set(fewer.keys)
        others = [c for c in candidates if str(c.key) not in gone]
        out += extended(here, fewer, others)
    visited.update({f.keys: f for f in out})
    return out


def extended(
    here: Likelihood, base: Fit, candidates: Sequence[Candidate], most: int = KEPT
) -> list[Fit]:
    """Fits of ``base`` with one more cause, the most evidence first: those are fitted that promise
    most to first order at the best of their starts.
    """
    rated = here.promises(base, moves(base.causes, candidates))
    fits = [
        here.fit((*base.causes, *move), starts, base.of.nuisances)
        for _, move, starts in rated[:most]
    ]
    return sorted(fits, key=lambda f: -f.evidence)


def moves(causes: Sequence[Candidate], candidates: Sequence[Candidate]) -> list[Move]:
    """What may join ``causes``: a candidate, or a part of an effect together with the one that it
    is a part of.
    """
    out: list[Move] = []
    for c in candidates:
        if _may_join(c, causes):
            out.append((c,))
            continue
        for base in candidates:
            own = {f"{base.kind}:{name}" for name in base.names}
            if set(c.needs) & own and _may_join(base, causes) and _may_join(c, (*causes, base)):
                out.append((base, c))
    return out


def _may_join(c: Candidate, causes: Sequence[Candidate]) -> bool:
    """Whether a candidate may act beside ``causes``: it is not among them, what it is a part of
    is, and another form of it is not.
    """
    have = {f"{o.kind}:{name}" for o in causes for name in o.names}
    if not all(need in have for need in c.needs):
        return False
    own = {f"{c.kind}:{name}" for name in c.names}
    if c.effect.repeats and not c.needs:
        return sum(o.kind == c.kind for o in causes) < 3 and c.key not in {
            o.key for o in causes if not o.effect.repeats
        }
    return not own & have and not any(
        o.kind in c.effect.excludes or c.kind in o.effect.excludes for o in causes
    )


def pruned(here: Likelihood, found: Fit) -> Fit:
    """Without the causes that the others have made needless."""
    for index in range(len(found.causes)):
        fewer = without(here, found, index)
        if fewer.evidence >= here.again(found).evidence:
            return pruned(here, fewer)
    return found


def without(here: Likelihood, found: Fit, index: int) -> Fit:
    """The other causes fitted again from where they stand, without those that are parts of it."""
    gone = {index}
    while True:
        given = {f"{found.causes[i].kind}:{n}" for i in gone for n in found.causes[i].names}
        more = {i for i, c in enumerate(found.causes) if given & set(c.needs)} | gone
        if more == gone:
            break
        gone = more
    sizes = np.cumsum([0, *(len(c.names) for c in found.causes)])
    lost = np.concatenate([np.arange(sizes[i], sizes[i + 1]) for i in sorted(gone)])
    rest = [c for i, c in enumerate(found.causes) if i not in gone]
    return here.fit(rest, [np.delete(found.of.theta, lost)], found.of.nuisances)


def named(fit: Fit) -> str:
    """The causes of a fit in words."""
    parts = [f"{c.kind}({', '.join(c.names)})" for c in fit.causes]
    return " + ".join(parts) or "nothing"
