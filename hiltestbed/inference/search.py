"""The causes that have the most evidence: hypotheses grow by one cause at a time, or by several
where none helps alone, and shrink by any that the others have made needless.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import Likelihood, Move, PosteriorFit, independent
from hiltestbed.inference.model import places
from hiltestbed.inference.residuals import Changes

Progress = Callable[[str], None]
# parts of effects on an axis; more than twice as many as any of the machines at hand has
MOST_CAUSES = 10
MOST_PARALLEL = 3  # effects of one kind that act side by side
KEPT = 4  # candidates that are fitted beside a hypothesis
# moves of which a few steps are made before the best are fitted, those of one kind in one variant,
# and the steps
SCREENED, SAME_KIND, SCREENED_STEPS = 24, 2, 3
AHEAD = 3  # causes that are added before the evidence has to have risen
# starts of all causes of a hypothesis, those of the best of which a few steps are made, and the
# hypotheses for which that is done beside each
SCATTERED, BEGUN, ANEW = 24, 6, 2
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
    best: PosteriorFit
    visited: tuple[PosteriorFit, ...]
    null: PosteriorFit


def search(
    likelihood: Likelihood,
    candidates: Sequence[Candidate],
    progress: Progress | None = None,
    start: PosteriorFit | None = None,
    before: Sequence[PosteriorFit] = (),
    more: int | None = None,
) -> Searched:
    """The hypothesis with the most evidence that is reached from ``start``, by default from
    nothing, by adding one cause or several, leaving one out, or putting another one in its place.

    Args:
        before: what this likelihood has visited already. more: causes that may be added, one at a
            time, and only the same effect elsewhere put in the place of one; None: all of these.
    """
    likelihood = likelihood.choosing(max(1, len({c.kind for c in candidates})))
    null, visited = likelihood.start(), {f.keys: f for f in before}
    best = null if start is None else start
    if best.keys not in visited:
        best = pruned(likelihood, best)
    most = MOST_CAUSES * likelihood.model.axes if more is None else len(best.causes) + more
    tried: set[tuple[str, ...]] = set()
    while len(best.causes) < most:
        # the counts are those of what the present hypothesis leaves: it is smoother than what a
        # better one leaves, and fewer of its samples are independent
        here = likelihood.counting(independent(best.left, likelihood.model.noise_known))
        best = here.again(best)
        visited[best.keys] = best
        if best.keys in tried:
            break
        tried.add(best.keys)
        better = None
        if here.most_gain(best) < here.least_price(candidates):
            break
        if more is not None or here.model.leaves_noise(best.left):
            ways = (_added, _varied)
        elif here.model.noise_known:
            ways = (_added, _paired, _exchanged)
        else:
            ways = (_added, _exchanged, _further)
        for way in ways:
            if progress:
                progress(f"{WORDS[way.__name__]} {named(best)}")
            fits = way(here, best, candidates, visited)
            better = max(fits, key=lambda f: f.evidence, default=None)
            if better is not None and better.evidence > best.evidence:
                break
            better = None
        if better is None:
            break
        grown = pruned(here, better)
        if grown.evidence - best.evidence < here.least_gain(best):
            break
        best = grown
    visited.setdefault(best.keys, best)
    last = likelihood.counting(independent(best.left, likelihood.model.noise_known))
    scored = sorted((last.again(f) for f in visited.values()), key=lambda f: -f.evidence)
    return Searched(last, scored[0], tuple(scored), last.again(null))


WORDS = {
    "_added": "another cause beside",
    "_varied": "another place or number of one of",
    "_paired": "two more beside",
    "_exchanged": "another in place of one of",
    "_further": "several more beside",
}


def _added(here, best, candidates, visited) -> list[PosteriorFit]:
    noise = here.model.leaves_noise(best.left)
    fits = extended(here, best, candidates, least=best.evidence if noise else -math.inf)
    visited.update({f.keys: f for f in fits})
    return fits


def _varied(here, best, candidates, visited) -> list[PosteriorFit]:
    """The same effect at another place, or of another whole number, with all else as it stands:
    which one suits best may change with the noise, and with the causes beside it.
    """
    out: list[PosteriorFit] = []
    for index, cause in enumerate(best.causes):
        first, rest = best.causes[:index], best.causes[index + 1 :]
        alike = [c for c in candidates if (c.kind, c.names) == (cause.kind, cause.names)]
        others = [c for c in alike if c.key != cause.key and _may_join(c, (*first, *rest))]
        start = [best.of.theta], best.of.nuisances
        begun = [here.fit((*first, c, *rest), *start, SCREENED_STEPS) for c in others]
        if begun:
            found = min(begun, key=lambda f: f.cost)
            out.append(here.fit(found.causes, [found.of.theta], found.of.nuisances))
    visited.update({f.keys: f for f in out})
    return out


def _paired(here, best, candidates, visited) -> list[PosteriorFit]:
    """Two more causes, where each alone costs more than it explains."""
    out: list[PosteriorFit] = []
    for first in [visited[k] for k in list(visited) if _beside(visited[k], best)][:PAIRED]:
        out += extended(here, here.again(first), candidates)[:1]
    visited.update({f.keys: f for f in out})
    return out


def _beside(found: PosteriorFit, base: PosteriorFit) -> bool:
    """Whether a fit has the causes of ``base`` and one more."""
    return len(found.causes) == len(base.causes) + 1 and set(base.keys) <= set(found.keys)


def _exchanged(here, best, candidates, visited) -> list[PosteriorFit]:
    """Another cause in place of each one and of what is a part of it."""
    out: list[PosteriorFit] = []
    for index in range(len(best.causes)):
        fewer = without(here, best, index)
        visited[fewer.keys] = fewer
        gone = {str(c.key) for c in best.causes} - set(fewer.keys)
        others = [c for c in candidates if str(c.key) not in gone]
        out += extended(here, fewer, others)
    visited.update({f.keys: f for f in out})
    return out


def _further(here, best, candidates, visited) -> list[PosteriorFit]:
    """Several more causes, each the one that explains most, though the first ones cost more than
    they explain (floating search: P. Pudil, J. Novovicova, J. Kittler, Pattern Recogn. Lett. 15,
    1994).
    """
    out: list[PosteriorFit] = []
    for _ in range(AHEAD):
        fits = extended(here, out[-1] if out else best, candidates)
        # what one more cause changes in the others may be another minimum
        fits += [_anew(here, f.causes, f.of.nuisances) for f in fits[:ANEW]]
        for f in fits:
            if f.keys not in visited or f.evidence > here.again(visited[f.keys]).evidence:
                visited[f.keys] = f
        if not fits:
            break
        out.append(min(fits, key=lambda f: f.cost))
    return out


def _anew(here: Likelihood, causes: Move, nuisances: Array) -> PosteriorFit:
    """The fit of ``causes`` from starts all over their grids: from the best of them after a few
    steps (successive halving, as in :func:`_screened`).
    """
    sizes = [len(c.grid) for c in causes]
    count = math.prod(sizes)
    picked = np.unique(np.linspace(0, count - 1, min(count, SCATTERED)).astype(int))
    grids = [[np.ravel(np.array(point, dtype=float)) for point in c.grid] for c in causes]
    starts = [
        np.concatenate([grid[i] for grid, i in zip(grids, at, strict=True)])
        for at in zip(*np.unravel_index(picked, sizes), strict=True)
    ]
    first = sorted((here.fit(causes, [s], nuisances, 0) for s in starts), key=lambda f: f.cost)
    begun = [here.fit(causes, [f.of.theta], nuisances, SCREENED_STEPS) for f in first[:BEGUN]]
    best = min(begun, key=lambda f: f.cost)
    return here.fit(causes, [best.of.theta], best.of.nuisances)


def extended(
    here: Likelihood,
    base: PosteriorFit,
    candidates: Sequence[Candidate],
    most: int = KEPT,
    least: float = -math.inf,
) -> list[PosteriorFit]:
    """Fits of ``base`` with one more cause, the most evidence first: those are fitted that promise
    most to first order at the best of their starts, and more than ``least``.
    """
    x = np.concatenate([base.of.theta, base.of.nuisances])
    known = here.slopes(base.causes, x, base.left)
    rated = here.promises(base, known, moves(base.causes, candidates))
    rated = [r for r in rated if r[0] > least]
    if here.model.noise_known and len(rated) > most:
        rated = _screened(here, base, known, rated)
    fits = [
        here.fit((*base.causes, *move), starts, base.of.nuisances)
        for _, move, starts in rated[:most]
    ]
    return sorted(fits, key=lambda f: -f.evidence)


def _screened(
    here: Likelihood,
    base: PosteriorFit,
    known: Changes,
    rated: Sequence[tuple[float, Move, list[Array]]],
) -> list[tuple[float, Move, list[Array]]]:
    """The moves that promise most after a few steps of their descents, with the slopes of the
    ``base`` that are ``known``, from where these end
    (successive halving: K. Jamieson, A. Talwalkar, AISTATS 2016).
    """
    out: list[tuple[float, Move, list[Array]]] = []
    kinds: dict[tuple[tuple[str, str], ...], int] = {}
    for _, move, starts in rated:
        kind = tuple((c.kind, str(c.variant)) for c in move)
        kinds[kind] = kinds.get(kind, 0) + 1
        if kinds[kind] > SAME_KIND or len(out) >= SCREENED:
            continue
        begun = here.fit((*base.causes, *move), starts, base.of.nuisances, SCREENED_STEPS, known)
        out.append((begun.evidence, move, [begun.of.theta]))
    return sorted(out, key=lambda item: -item[0])


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
            if (
                set(c.needs) & own
                and base.place == c.place
                and _may_join(base, causes)
                and _may_join(c, (*causes, base))
            ):
                out.append((base, c))
    return out


def _may_join(c: Candidate, causes: Sequence[Candidate]) -> bool:
    """Whether a candidate may act beside ``causes``: it is not among them, what it is a part of
    is, and another form of it is not.
    """
    have = {f"{o.kind}:{name}" for o in causes if o.place == c.place for name in o.names}
    if not all(need in have for need in c.needs):
        return False
    if c.effect.parallel and not c.needs:
        return sum(o.kind == c.kind for o in causes) < MOST_PARALLEL
    taken = {(o.kind, name, o.place) for o in causes for name in o.names or ("",)}
    own = {(c.kind, name, c.place) for name in c.names or ("",)}
    return not own & taken and not any(
        o.kind in c.effect.excludes or c.kind in o.effect.excludes for o in causes
    )


def pruned(here: Likelihood, found: PosteriorFit) -> PosteriorFit:
    """Without the causes that the others have made needless."""
    for index in range(len(found.causes)):
        fewer = without(here, found, index)
        if fewer.evidence >= here.again(found).evidence:
            return pruned(here, fewer)
    return found


def without(here: Likelihood, found: PosteriorFit, index: int) -> PosteriorFit:
    """The other causes fitted again from where they stand, without those that are parts of it."""
    gone = {index}
    while True:
        given = {
            (f"{found.causes[i].kind}:{n}", found.causes[i].place)
            for i in gone
            for n in found.causes[i].names
        }
        more = gone | {
            i for i, c in enumerate(found.causes) if given & {(need, c.place) for need in c.needs}
        }
        if more == gone:
            break
        gone = more
    where = places(found.causes)
    lost = np.concatenate([np.arange(where[i].start, where[i].stop) for i in sorted(gone)])
    rest = [c for i, c in enumerate(found.causes) if i not in gone]
    return here.fit(rest, [np.delete(found.of.theta, lost)], found.of.nuisances)


def named(fit: PosteriorFit) -> str:
    """The causes of a fit in words."""
    parts = [f"{c.kind}({', '.join(c.names)})" for c in fit.causes]
    return " + ".join(parts) or "nothing"
