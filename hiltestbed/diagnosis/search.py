"""The explanation of one link: first each cause alone, then further ones beside the best, as long as each of them pays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, Leftover, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Fit, bounds_of, differences, effects_at, fit, inflation, nothing, refit, scales
from hiltestbed.diagnosis.jitter import again
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import (
    AMBIGUITY,
    BEAM,
    CLOSE_BY,
    DETECTION,
    MOST_CAUSES,
    NEAR_AN_END,
    PARTNERS,
    SELECTION,
    SELECTION_INADEQUATE,
    SIMILAR,
    SINGLES,
    UNDERRATED,
    VARIANT,
    WORTH_A_FIT,
)
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

Judge = Callable[[Residual, Effects], dict[str, Leftover]]
Special = Callable[[Residual, Fit], Fit | None]  # a hypothesis that is made from what a fit leaves
Reread = Callable[[Residual, Fit], Residual]  # the reading of a link that a fit bears out; the residual itself where it is that one
Progress = Callable[[str], None]


CLOCKS = {"sensor.delay", "log.skew"}


@dataclass(frozen=True)
class Explanation:
    """What a search found on one link.

    Attributes:
        residual: under the weights of the search. candidates: that were weighed.
        null: nothing departs. singles, more: fits of one cause and of several, best first; with a given cause, it and one more are singles.
        chosen: the best that pays. adequate: it leaves noise. departs: whether something departs at all.
        leftovers: channel to what the chosen fit leaves. before: channel to what the null leaves.
        rivals: for each cause of the chosen fit the fits that differ from it in that cause alone and cannot be told from it.
    """

    residual: Residual
    candidates: tuple[Candidate, ...]
    null: Fit
    chosen: Fit
    adequate: bool
    departs: bool
    leftovers: dict[str, Leftover]
    before: dict[str, Leftover]
    singles: tuple[Fit, ...] = ()
    more: tuple[Fit, ...] = ()
    rivals: tuple[tuple[Fit, ...], ...] = ()

    @property
    def worst(self) -> float:
        """How far the worst channel lies above what passes for noise."""
        return max((left.excess for left in self.leftovers.values()), default=0.0)

    def with_the_other_clock(self, judge: Judge) -> Explanation:
        """A late sensor and a record that is stamped late as rivals of each other, where both are hypotheses.

        They are so where nothing shows what became of the force: only how a facility reads between its rows could tell them apart, and
        that is not known.
        """
        clocks = [c for c in self.candidates if c.kind in CLOCKS and not c.variant]
        if self.chosen.causes == () or {c.kind for c in clocks} != CLOCKS:
            return self
        rivals = list(self.rivals or ((),) * len(self.chosen.causes))
        for i, cause in enumerate(self.chosen.causes):
            other = next((c for c in clocks if c.kind != cause.kind), None)
            if cause.kind not in CLOCKS or other is None or CLOCKS & {*self.chosen.kinds[:i], *self.chosen.kinds[i + 1 :]}:
                continue
            causes = (*self.chosen.causes[:i], other, *self.chosen.causes[i + 1 :])
            late = fit(self.residual, causes, [self.chosen.theta], tries=1)
            known = any(other.kind in f.kinds for f in rivals[i])
            if not known and noise_alone(judge(self.residual, late.effects())):
                rivals[i] = (*rivals[i], late)
        return replace(self, rivals=tuple(rivals))


@dataclass(frozen=True)
class Search:
    """How a link is searched: the hypotheses, what judges whether noise is left, and hypotheses that are made from what is left."""

    candidates: tuple[Candidate, ...]
    judge: Judge = contact_leftovers
    special: tuple[Special, ...] = ()
    progress: Progress | None = None
    reread: Reread | None = None  # asked with the best cause alone, before further ones are sought beside it
    beside: float = SELECTION  # what a further cause must take off chi-square where those found leave noise; infinite: none is sought

    def explain(self, residual: Residual, given: Fit | None = None) -> Explanation:
        """The explanation of a link; given: a fit with the cause that another link has shown, which is one of its causes."""
        residual = residual.wary(given.effects() if given else ())
        null = refit(residual, given) if given else nothing(residual)
        before = self.judge(residual, null.effects())
        adequate_null = noise_alone(before)
        least = SELECTION if given and adequate_null else DETECTION  # that a cause has to take off, in units of the misfit
        singles = self.extend(residual, null, worth=least if adequate_null else 0.0)
        if singles and (wary := residual.wary(singles[0].effects())) is not residual:
            residual = wary
            null = refit(residual, null)
            singles = [again(residual, f) for f in first_of_each(singles, "kinds")[:BEAM]]
            before = self.judge(residual, null.effects())
        counts = singles and (not adequate_null or null.score - singles[0].score > least * inflation(singles[0]))
        if counts and not given and self.reread and (other := self.reread(residual, singles[0])) is not residual:
            return replace(self, reread=None).explain(other)
        singles += [f for make in self.special if (f := make(residual, null)) is not None]  # under the weights that a better mean has left
        singles.sort(key=_order)
        best = singles[0] if singles else null
        need = least * inflation(best)
        departs = null.score - best.score > need or not adequate_null
        known = (null,) if given else ()
        if not departs:
            return Explanation(
                residual, self.candidates, nothing(residual), null, True, given is not None, before, before, (*singles, *known)
            )
        chosen = best if null.score - best.score > need else null
        return self._several(residual, chosen, singles, before, known, given is not None)

    def _several(
        self, residual: Residual, chosen: Fit, singles: list[Fit], before: dict[str, Leftover], known: tuple[Fit, ...], given: bool
    ) -> Explanation:
        """Further causes beside the best so far, until none pays."""
        leftovers = self.judge(residual, chosen.effects())
        adequate = noise_alone(leftovers)
        more: list[Fit] = []
        level = first_of_each(singles, "kinds")
        for count in range(1, 1 if given else MOST_CAUSES):
            if adequate and (count > 1 or math.isinf(self.beside)):  # a third cause beside two that leave noise would have to hide in it
                break
            found: list[Fit] = []
            for base in level[: 1 if adequate else BEAM]:
                search = self._near(residual, base, found) if count > 1 else self
                found += search.extend(residual, base, PARTNERS, self.special, found)
            found = first_of_each(sorted(found, key=lambda f: f.score), "key")
            if not found:
                break
            if (wary := residual.wary(found[0].effects())) is not residual:
                residual = wary
                found = sorted([again(residual, f) for f in found[:PARTNERS]], key=lambda f: f.score)
                chosen = again(residual, chosen)
            more = [*found, *more]
            need = (self.beside if adequate else SELECTION_INADEQUATE) * inflation(found[0])
            if chosen.score - found[0].score <= need:
                break
            chosen, level = found[0], found
            leftovers = self.judge(residual, chosen.effects())
            adequate = noise_alone(leftovers)
        null = nothing(residual)
        result = Explanation(residual, self.candidates, null, chosen, adequate, True, leftovers, before, (*singles, *known), tuple(more))
        return result if not (adequate and chosen.causes) else with_rivals(result, self.judge)

    def _near(self, residual: Residual, base: Fit, found: Sequence[Fit]) -> Search:
        """The same search; where the best that was found leaves noise, for causes that make a rival of it out of ``base``."""
        best = min(found, key=lambda f: f.score, default=base)
        foreign = set(base.kinds) - set(best.kinds)
        if not foreign:
            return self
        left = self.judge(residual.wary(best.effects()), best.effects())  # as it is judged when its turn comes
        if not noise_alone(left):
            return self
        return replace(self, candidates=tuple(c for c in self.candidates if c.kind in best.kinds))

    def extend(
        self, residual: Residual, base: Fit, most: int = SINGLES, special: Sequence[Special] = (), beside: Sequence[Fit] = (),
        worth: float = 0.0,
    ) -> list[Fit]:  # fmt: skip
        """Fits of ``base`` with one more cause, best first.

        A descent that will not come near the best of ``beside``, or that will not take off ``worth`` of chi-square, is not finished.
        """
        if JITTER in base.kinds:  # its likelihood is not a sum of squares: it is added to others, not they to it
            return []
        rated = sorted(self._rate(residual, base), key=lambda item: -item[0])
        fits: list[Fit] = []
        count: dict[str, int] = {}
        for gain, c, starts in rated:
            count[c.kind] = count.get(c.kind, 0) + 1
            if count[c.kind] > SIMILAR or len(fits) >= most or _beaten(c, base, fits):
                continue
            best = min((*fits, *beside), key=lambda f: f.chi2, default=base)
            near = min(best.chi2 + CLOSE_BY * inflation(best), base.chi2 - worth)
            enough = len({f.causes[-1].kind for f in fits}) >= BEAM or inflation(best) == 1.0  # beside what leaves noise no beam is needed
            if fits and enough and base.chi2 - UNDERRATED * gain > near:
                break
            if self.progress:
                self.progress(" + ".join([*base.kinds, c.kind]))
            together = [np.concatenate([base.theta, s]) for s in starts]
            fits.append(fit(residual, (*base.causes, c), together, tries=2 if base.causes else 3, known=near))
        fits += [f for make in special if (f := make(residual, base)) is not None]
        return sorted(fits, key=_order)

    def _rate(self, residual: Residual, base: Fit) -> list[tuple[float, Candidate, list[Array]]]:
        """What each candidate could at most take off chi-square beside `base`, linearised at each start, and the starts worth a descent."""
        wanted = [c for c in self.candidates if not any(_overlap(c, known) for known in base.causes)]
        starts = [[np.clip(np.array(s, dtype=float), c.low, c.high) for s in c.grid] for c in wanted]
        basis, known = _orthonormal(base.jacobian), base.effects()
        tried = [[*known, c.at(theta)] for c, grid in zip(wanted, starts, strict=True) for theta in grid]
        out, at = [], 0
        scored = _scored(residual, base, basis, tried)
        r = _without(basis, base.residual)
        for c, grid in zip(wanted, starts, strict=True):
            gains, lefts = scored[at : at + len(grid), 0], scored[at : at + len(grid), 1]
            at += len(grid)
            best = float(gains.max())
            order = list(dict.fromkeys([int(gains.argmax()), *np.argsort(lefts)[:3].tolist()]))
            if c.vector or (len(grid) == 1 and len(c.names)):
                best = max(best, _by_slopes(residual, known, basis, r, c, grid[int(lefts.argmin())]))
            if best > WORTH_A_FIT * inflation(base) * 0.5:
                out.append((best, c, [grid[i] for i in order]))
        return out


def _overlap(c: Candidate, other: Candidate) -> bool:
    """Whether two hypotheses are of one effect, or one of them of an effect rich in numbers, of which the other would be a part."""
    parts = [a.kind in b.effect.resembles for a, b in ((c, other), (other, c)) if b.effect.rich]
    return c.kind == other.kind or any(parts)


def _beaten(c: Candidate, base: Fit, fits: Sequence[Fit]) -> bool:
    """Whether another variant of a hypothesis takes so little off chi-square, beside the best, that this one need not be tried."""
    best = max((base.chi2 - f.chi2 for f in fits), default=0.0)
    twins = [f for f in fits if f.causes[-1].kind == c.kind and f.causes[-1].fixed == c.fixed]
    return any(base.chi2 - f.chi2 < VARIANT * best for f in twins)


def _scored(residual: Residual, base: Fit, basis: Array, tried: Sequence[Effects]) -> Array:
    """``(H, 2)`` of each trial: what it could take off chi-square beside ``base``, by its size or along its direction; what it leaves."""
    out = np.empty((len(tried), 2))
    r = _without(basis, base.residual)
    chunk = max(1, 40_000_000 // (8 * max(1, len(base.residual))))
    for start in range(0, len(tried), chunk):
        for h, moved in enumerate(residual.many(tried[start : start + chunk]), start):
            left = square(moved)
            d = _without(basis, moved - base.residual)
            length, along = square(d), float(np.einsum("m,m->", r, d))
            gain = along**2 / length if length > 0 and along < 0 else 0.0
            out[h] = max(base.chi2 - left, gain), left
    return out


def _by_slopes(residual: Residual, known: Effects, basis: Array, r: Array, c: Candidate, theta: Array) -> float:
    """What all parameters of `c` together could take off chi-square, by the slopes of the residual at theta."""
    low, high, log = bounds_of([c])

    def run(thetas: Sequence[Array] | Array) -> Array:
        return residual.many([[*known, *effects_at((c,), x)] for x in thetas])

    columns = differences(run, theta, run([theta])[0], scales(theta, low, high, log), low, high)
    q = _orthonormal(np.column_stack([_without(basis, column) for column in columns.T]))
    return float(np.sum(np.einsum("mi,m->i", q, r) ** 2))


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis of what the columns (M, P) span; columns that the others span already are left out."""
    if columns.shape[1] == 0:
        return columns
    length = np.sqrt(np.einsum("mi,mi->i", columns, columns))
    q, r = np.linalg.qr(columns / np.where(length > 0.0, length, 1.0))
    return q[:, np.abs(np.diag(r)) > 1e-6]


def _without(basis: Array, r: Array) -> Array:
    """r less its part in the span of the basis (M, Q); by einsum, since threads of a BLAS wait for each other on a busy machine."""
    return r - np.einsum("mi,i->m", basis, np.einsum("mi,m->i", basis, r)) if basis.shape[1] else r


def _order(f: Fit) -> tuple[float, float]:
    return round(f.score, 1), _boldness(f)


def _boldness(f: Fit) -> float:
    """How far factors lie from one: of two that fit alike (a mass of either body) the one nearer to what is believed goes first."""
    return sum(abs(math.log(max(e.parameters()["factor"], 1e-9))) for e in f.effects() if "factor" in e.parameters())


def first_of_each(fits: Sequence[Fit], by: str) -> list[Fit]:
    """The first of each set of causes; ``by``: whether sets of the same ``kinds``, or of the same hypotheses (``key``), are one."""
    seen, out = set(), []
    for f in fits:
        causes = tuple(sorted(f.kinds)) if by == "kinds" else tuple(sorted(map(str, (c.key for c in f.causes))))
        if causes not in seen:
            seen.add(causes)
            out.append(f)
    return out


def _limit_of(residual: Residual, chosen: Fit, index: int, other: Fit) -> bool:
    """Whether ``other`` has, in place of a cause, one of more parameters at the end of its range, where it is nothing but that cause.

    An estimate that the noise has moved off the end is at the end all the same: held there, the others fit as well.
    """
    own = next(i for i, kind in enumerate(other.kinds) if kind not in chosen.kinds)
    richer, theta = other.causes[own], other.part(own)
    if len(richer.names) <= len(chosen.causes[index].names) or richer.vector:
        return False
    ends = np.where(theta - richer.low < richer.high - theta, richer.low, richer.high)
    close = np.flatnonzero(np.abs(theta - ends) < NEAR_AN_END * (richer.high - richer.low))
    for j in close:
        rest = np.delete(np.arange(len(theta)), j)
        causes = (*other.causes[:own], richer.held(int(j), float(ends[j])), *other.causes[own + 1 :])
        start = np.concatenate([*(other.part(i) for i in range(own)), theta[rest], *(other.part(i) for i in range(own + 1, len(causes)))])
        if fit(residual, causes, [start], tries=1).chi2 - other.chi2 < AMBIGUITY * inflation(other):
            return True
    return False


def with_rivals(found: Explanation, judge: Judge) -> Explanation:
    """With the fits that differ from the chosen one in one cause and cannot be told from it."""
    chosen = found.chosen
    pool = [f for f in (*found.singles, *found.more) if len(f.causes) == len(chosen.causes)]
    close = [f for f in pool if f is not chosen and f.score - chosen.score < AMBIGUITY * inflation(chosen)]
    rivals: list[list[Fit]] = [[] for _ in chosen.causes]
    for f in first_of_each(close, "kinds"):
        shared = [kind in f.kinds for kind in chosen.kinds]
        if sum(shared) != len(shared) - 1 or _limit_of(found.residual, chosen, shared.index(False), f):
            continue
        if noise_alone(judge(found.residual, f.effects())):
            rivals[shared.index(False)].append(f)
    return replace(found, rivals=tuple(map(tuple, rivals))).with_the_other_clock(judge)
