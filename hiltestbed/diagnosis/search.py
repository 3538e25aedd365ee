"""Which effects explain a link: singles, then pairs grown from the best of them, each by what it takes off chi-square and costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hiltestbed.diagnosis.adequacy import Leftover, leftover, soften
from hiltestbed.diagnosis.candidates import Candidate
from hiltestbed.diagnosis.fit import Fit, Residual, differences, effects_at, fit, refit, scales, square
from hiltestbed.diagnosis.links import Effects, WrenchLink
from hiltestbed.frames import Array

ALARM = 30.0  # by which the best single must better the nominal link, its penalty paid: in 120 healthy rigs it came to 3.6 at most
PAYS = 100.0  # by which a second cause must better a first one that is adequate already
PAYS_INADEQUATE = 10.0  # and one that is not
TIE = 12.0  # hypotheses closer than this cannot be told apart
WORTH_A_FIT = 8.0  # linearised gain below which a candidate is not fitted
SHAKEN = 1.2  # times the noise: where a varying delay shows
SAME_AGAIN = 0.3  # correlation of neighbouring samples, or with the rate of the reading, above which they are no varying delay
BEAM = 5
PARTNERS = 6
SIMILAR_EFFECTS = 3  # of the same effect (axes, forms) that are fitted


@dataclass
class Explanation:
    """What a search found on one link.

    Attributes:
        null: nothing departs. singles, pairs: fits, best first; with a given cause, it and one more are singles.
        chosen: the best that pays. adequate: it leaves noise.
        leftovers: channel to what the chosen fit leaves. before: channel to what the null leaves.
        rivals: for each cause of the chosen fit the fits that differ from it in that cause alone and cannot be told from it.
    """

    null: Fit
    chosen: Fit
    adequate: bool
    alarm: bool
    leftovers: dict[str, Leftover]
    before: dict[str, Leftover]
    singles: list[Fit] = field(default_factory=list)
    pairs: list[Fit] = field(default_factory=list)
    rivals: list[list[Fit]] = field(default_factory=list)


JITTER = "sensor.jitter"
Judge = Callable[[Residual, Effects], dict[str, Leftover]]


def contact_leftovers(residual: Residual, effects: Effects) -> dict[str, Leftover]:
    """Channel to leftover in contact, and over the free rest, of the worse of the two."""
    link = residual.link
    inside: list[list[Array]] = [[] for _ in link.channels]
    outside: list[list[Array]] = [[] for _ in link.channels]
    for i in residual.runs:
        run = link.runs[i]
        prediction = link.predict(i, effects)
        weight = residual.weight[i]
        sigma = np.where(weight > 0, 1.0 / np.where(weight > 0, weight, 1.0), np.inf)
        if isinstance(link, WrenchLink):
            sigma = soften(sigma, prediction)
            shake = sum(p["sigma"] for kind, p in effects if kind == "sensor.jitter")
            if shake:
                prediction, spread = link.shaken(i, effects, shake)
                sigma = np.hypot(sigma, spread)
        z = (residual.measured[i] - prediction) / sigma
        for c in range(len(link.channels)):
            counted = weight[:, c] > 0
            inside[c].append(z[run.touching & counted, c])
            outside[c].append(z[~run.touching & counted, c])
    out = {}
    for name, a, b in zip(link.channels, inside, outside, strict=True):
        both = [leftover(part) for part in (a, b) if sum(map(len, part)) > 0]
        if both:
            out[name] = max(both, key=lambda left: left.excess)
    return out


def search(residual: Residual, candidates: Sequence[Candidate], judge: Judge = contact_leftovers, special: Sequence[Callable] = (),
           progress: Callable[[str], None] | None = None, given: Fit | None = None) -> Explanation:  # fmt: skip
    """The explanation of a link by at most two causes; given: a fit with the cause that another link has shown, which is one of them."""
    residual.beware(given.effects() if given else ())
    null = refit(residual, given) if given else null_fit(residual)
    before = judge(residual, null.effects())
    singles = extend(residual, null, candidates, progress, ())
    adequate_null = all(left.noise for left in before.values())
    if singles and residual.beware(singles[0].effects()):
        null = refit(residual, null) if given else null_fit(residual)
        singles = [again(residual, f) for f in _best_of_each(singles, "effect")[:BEAM]]
        before = judge(residual, null.effects())
    singles += [f for make in special if (f := make(residual, null)) is not None]  # under the weights that a better mean has left
    singles.sort(key=lambda f: (round(f.score, 1), _boldness(f)))
    best = singles[0] if singles else null
    need = (PAYS if given and adequate_null else ALARM) * inflation(best)
    alarm = null.score - best.score > need or not adequate_null
    nothing = null_fit(residual)
    known = [null] if given else []
    if not alarm:
        return Explanation(nothing, null, True, given is not None, before, before, [*singles, *known])
    chosen = best if null.score - best.score > need else null
    leftovers = judge(residual, chosen.effects())
    adequate = all(left.noise for left in leftovers.values())
    pairs: list[Fit] = []
    if not given:
        for base in _best_of_each(singles, "effect")[: 1 if adequate else BEAM]:
            pairs += extend(residual, base, candidates, progress, special, PARTNERS)
        pairs.sort(key=lambda f: f.score)
        pairs = _best_of_each(pairs, "key")
        need = (PAYS if adequate else PAYS_INADEQUATE) * inflation(pairs[0]) if pairs else math.inf
        if pairs and residual.beware(pairs[0].effects()):
            pairs = sorted([again(residual, f) for f in pairs[:PARTNERS]], key=lambda f: f.score)
            chosen = again(residual, chosen) if chosen.causes else chosen
        if pairs and chosen.score - pairs[0].score > need:
            left = judge(residual, pairs[0].effects())
            chosen, leftovers = pairs[0], left
            adequate = all(x.noise for x in left.values())
    found = Explanation(nothing, chosen, adequate, True, leftovers, before, [*singles, *known], pairs)
    if adequate and chosen.causes:
        found.rivals = _rivals(residual, found, judge)
    return found


def again(residual: Residual, f: Fit) -> Fit:
    """The same hypothesis under the weights as they are now."""
    if f.causes[-1].effect != JITTER:
        return refit(residual, f)
    rest = replace(f, causes=f.causes[:-1], theta=f.theta[:-1])
    base = refit(residual, rest) if rest.causes else null_fit(residual)
    return jitter_beside(residual, base) or f


def null_fit(residual: Residual) -> Fit:
    """Nothing departs."""
    r = residual(())
    return Fit((), np.zeros(0), square(r), r, np.zeros((len(r), 0)), np.zeros(0))


def jitter_beside(residual: Residual, base: Fit) -> Fit | None:
    """A delay that varies from sample to sample beside `base`: noise in proportion to the rate of the reading, by likelihood."""
    link, effects = residual.link, base.effects()
    if not isinstance(link, WrenchLink) or JITTER in {c.effect for c in base.causes}:
        return None
    worth = np.concatenate([(link.slope(i, effects) * residual.weight[i]).ravel() for i in residual.runs])
    cause = Candidate(JITTER, ("sigma",), np.array([0.0]), np.array([0.02]), np.array([False]), ((0.0,),))

    def cost(sigma: float) -> float:
        s2 = 1.0 + (sigma * worth) ** 2
        return float(np.sum(base.residual**2 / s2 + np.log(s2)))

    sigmas = np.geomspace(1e-6, 0.02, 40)
    costs = [cost(s) for s in sigmas]
    at = int(np.argmin(costs))
    found: Any = minimize_scalar(cost, bounds=(sigmas[max(at - 1, 0)], sigmas[min(at + 1, 39)]), method="bounded", options={"xatol": 1e-9})
    if found.fun > base.chi2 - WORTH_A_FIT:
        return None
    best = float(found.x)
    spread = np.sqrt(1.0 + (best * worth) ** 2)
    z = base.residual / spread
    if not _independent(z, spread > SHAKEN, len(link.channels)) or not _centred(z, worth / spread, spread > SHAKEN):
        return None
    tried = [(best * f, *_likelihood(link, residual, effects, best * f)) for f in (0.92, 1.0, 1.08)]
    sigma, chi2, r = min(tried, key=lambda item: item[1])
    return Fit((*base.causes, cause), np.append(base.theta, sigma), chi2, r,
               np.column_stack([base.jacobian, np.zeros(len(r))]), np.append(base.scale, sigma))  # fmt: skip


def _likelihood(link: WrenchLink, residual: Residual, effects: Effects, sigma: float) -> tuple[float, Array]:
    """Chi-square with the cost of the spread, and the residual in units of noise and spread, for a delay that varies by sigma."""
    total, parts = 0.0, []
    for i in residual.runs:
        mean, spread = link.shaken(i, effects, sigma)
        s2 = 1.0 + (spread * residual.weight[i]) ** 2
        z = (residual.measured[i] - mean) * residual.weight[i] / np.sqrt(s2)
        total += float(np.sum(z * z) + np.sum(np.log(s2)))
        parts.append(z.ravel())
    return total, np.concatenate(parts)


def _independent(z: Array, where: np.ndarray, channels: int) -> bool:
    """Whether neighbouring samples differ as if drawn anew, as a delay that varies from sample to sample makes them."""
    z, where = z.reshape(-1, channels), where.reshape(-1, channels)
    pairs = where[1:] & where[:-1]
    products, squares = float(np.sum((z[1:] * z[:-1])[pairs])), float(np.sum((z[1:] ** 2)[pairs]))
    return squares > 0 and abs(products) < SAME_AGAIN * squares


def _centred(z: Array, worth: Array, where: np.ndarray) -> bool:
    """Whether the delay varies about the one believed: what is late throughout goes along with the rate of the reading, `worth`."""
    z, worth = z[where], worth[where]
    return abs(float(np.sum(z * worth))) < SAME_AGAIN * math.sqrt(square(z) * square(worth))


def inflation(fit_: Fit) -> float:
    """Misfit of the best hypothesis in units of the noise: differences of chi-square count by it."""
    return max(1.0, square(fit_.residual) / max(1, np.count_nonzero(fit_.residual)))


def extend(residual: Residual, base: Fit, candidates: Sequence[Candidate], progress: Callable[[str], None] | None,
            special: Sequence[Callable], most: int = 40) -> list[Fit]:  # fmt: skip
    """Fits of base with one more cause, best first."""
    taken = {c.effect for c in base.causes}
    if JITTER in taken:  # its likelihood is not a sum of squares: it is added to others, not they to it
        return []
    basis = _orthonormal(base.jacobian)
    rated = []
    for c in candidates:
        if c.effect in taken:
            continue
        gain, starts = prescreen(residual, base, basis, c)
        if gain > WORTH_A_FIT * inflation(base) * 0.5:
            rated.append((gain, c, starts))
    rated.sort(key=lambda item: -item[0])
    fits, count = [], {}
    for _, c, starts in rated:
        count[c.effect] = count.get(c.effect, 0) + 1
        if count[c.effect] > SIMILAR_EFFECTS or len(fits) >= most:
            continue
        if progress:
            progress(" + ".join([*(b.effect for b in base.causes), c.effect]))
        fits.append(fit(residual, (*base.causes, c), [np.concatenate([base.theta, s]) for s in starts], tries=2 if base.causes else 3))
    fits += [f for make in special if (f := make(residual, base)) is not None]
    fits.sort(key=lambda f: (round(f.score, 1), _boldness(f)))
    return fits


def _boldness(f: Fit) -> float:
    """How far factors lie from one: of two that fit alike (a mass of either body) the one nearer to what is believed goes first."""
    return sum(abs(math.log(max(p["factor"], 1e-9))) for _, p in f.effects() if "factor" in p)


def prescreen(residual: Residual, base: Fit, basis: Array, c: Candidate) -> tuple[float, list[Array]]:
    """What a candidate could at most take off chi-square beside `base`, linearised at each start; and the starts worth a descent."""
    r = _without(basis, base.residual)
    known = base.effects()
    rated = []
    for start in c.grid:
        theta = np.clip(np.array(start, dtype=float), c.low, c.high)
        moved = residual([*known, *effects_at((c,), theta)])
        left = square(moved)
        d = _without(basis, moved - base.residual)
        length, along = square(d), float(np.einsum("m,m->", r, d))
        gain = along**2 / length if length > 0 and along < 0 else 0.0
        rated.append((max(base.chi2 - left, gain), -left, theta, moved))
    by_gain = max(rated, key=lambda item: item[0])
    by_fit = sorted(rated, key=lambda item: -item[1])[:3]
    best = by_gain[0]
    if c.vector or (len(c.grid) == 1 and len(c.names)):
        best = max(best, _by_slopes(residual, known, basis, r, c, by_fit[0][2], by_fit[0][3]))
    return best, [by_gain[2], *(item[2] for item in by_fit if item[2] is not by_gain[2])]


def _by_slopes(residual: Residual, known: Effects, basis: Array, r: Array, c: Candidate, theta: Array, moved: Array) -> float:
    """What all parameters of `c` together could take off chi-square, by the slopes of the residual at theta, where it is `moved`."""
    scale = scales(theta, c.low, c.high, c.log)
    columns = differences(lambda x: residual([*known, *effects_at((c,), x)]), theta, moved, scale, c.low, c.high)
    q = _orthonormal(np.column_stack([_without(basis, column) for column in columns.T]))
    return float(np.sum(np.einsum("mi,m->i", q, r) ** 2))


def _orthonormal(columns: Array | None) -> Array:
    if columns is None or columns.shape[1] == 0:
        return np.zeros((0 if columns is None else len(columns), 0))
    kept: list[Array] = []
    for column in columns.T:
        length = math.sqrt(square(column))
        rest = column / length if length > 0 else column
        for q in kept:
            rest = rest - q * np.einsum("m,m->", q, rest)
        if square(rest) > 1e-12:
            kept.append(rest / math.sqrt(square(rest)))
    return np.column_stack(kept) if kept else np.zeros((len(columns), 0))


def _without(basis: Array, r: Array) -> Array:
    """r less its part in the span of the basis (M, Q); by einsum, since threads of a BLAS wait for each other on a busy machine."""
    return r - np.einsum("mi,i->m", basis, np.einsum("mi,m->i", basis, r)) if basis.shape[1] else r


def _best_of_each(fits: Sequence[Fit], name: str) -> list[Fit]:
    """The first of each set of causes; ``name``: the attribute by which causes are the same, ``effect`` or ``key``."""
    seen, out = set(), []
    for f in fits:
        causes = tuple(sorted(getattr(c, name) for c in f.causes))
        if causes not in seen:
            seen.add(causes)
            out.append(f)
    return out


def _rivals(residual: Residual, found: Explanation, judge: Judge) -> list[list[Fit]]:
    chosen = found.chosen
    pool = [f for f in (*found.singles, *found.pairs) if len(f.causes) == len(chosen.causes)]
    close = [f for f in pool if f is not chosen and f.score - chosen.score < TIE * inflation(chosen)]
    rivals: list[list[Fit]] = [[] for _ in chosen.causes]
    for f in _best_of_each(close, "effect"):
        effects = {c.effect for c in f.causes}
        shared = [c.effect in effects for c in chosen.causes]
        if sum(shared) != len(shared) - 1:
            continue
        if all(left.noise for left in judge(residual, f.effects()).values()):
            rivals[shared.index(False)].append(f)
    return rivals
