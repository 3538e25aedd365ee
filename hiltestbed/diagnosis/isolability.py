"""Stage "decide": isolability: the smallest size of each effect that these data would show, and
which effects would look the same.

The idea of structural fault isolation (E. Frisk, M. Krysander, fault isolability of over-determined
systems), with sensitivities from replays of the links in place of structure: two effects with
parallel residuals cannot be told apart at small size. The likelihood is that by which causes are
chosen: an effect shows at the size at which it would be named, and two are told apart by the odds
at which two causes are.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize.elementwise import find_root
from scipy.stats import norm

from hiltestbed.diagnosis.explain import Explanation
from hiltestbed.diagnosis.link_model import NOTHING, LinkModel
from hiltestbed.diagnosis.links import Timing
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.result import Isolable
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.conclude import NAMED, TOLD_APART
from hiltestbed.inference.search import Progress

SIZE_ERROR = 0.03  # relative, of the smallest size that shows
MOST_ROUNDS = 8  # of its search: a jump is then placed to 6 %, a half 8 times of seven decades
CERTAINTY = float(norm.ppf(0.95))  # standard deviations, of the odds with which a size shows


class FisherInformation:
    """What effects change of the runs of a link, beside what its nuisances may."""

    def __init__(self, model: LinkModel, each: Sequence[Effects]) -> None:
        nuisances = [[Timing.hypothesis({}, **{n.name: n.sigma})] for n in model.nuisances]
        errors = [np.concatenate(e) for e in model.common_errors(NOTHING)]
        self._count = len(each)
        # (R, E + P + Q, E + P + Q) of the changes of each run by effects, nuisances, common errors
        found, start = [], 0
        for z, scatter in model.changes([*each, *nuisances]):
            end = start + z.shape[1]
            columns = np.vstack([z, *(e[start:end] for e in errors)])
            products = columns @ columns.T
            products[: len(each), : len(each)] += np.diag(scatter[: len(each)])
            found.append(products)
            start = end
        self._products = np.array(found)
        self._among = slice(len(each), len(each) + len(nuisances))

    def of(self, runs: Iterable[int] | None = None) -> Array:
        """(E, E) scalar products of the changes by the effects on some runs, by default on all, in
        units of the noise, after the nuisances have followed as far as their priors allow.
        """
        chosen = slice(None) if runs is None else list(runs)
        total = self._products[chosen].sum(axis=0)
        own, across = total[: self._count, : self._count], total[: self._count, self._among]
        among = total[self._among, self._among]
        return np.asarray(own - across @ np.linalg.solve(among + np.eye(len(among)), across.T))

    def squares(self) -> Array:
        """(E,) square of the size of each effect over its standard error: that of the noise, beside
        the nuisances, or without these that of the noise and of the common errors, by which an
        estimate is then off in full.
        """
        total = self._products.sum(axis=0)[: self._count]
        own, off = np.diag(total), np.sum(total[:, self._among.stop :] ** 2, axis=1)
        alone = np.divide(own**2, own + off, out=np.zeros_like(own), where=own > 0.0)
        return np.minimum(alone, np.maximum(np.diag(self.of()), 0.0))


def alike(products: Array) -> np.ndarray:
    """(E, E) whether what one of two effects changes beyond the other is worth less than the odds
    at which two causes are told apart; products: (E, E) of :meth:`FisherInformation.of`.
    """
    own = np.maximum(np.diag(products), np.finfo(float).tiny)
    cosine = products / np.sqrt(np.outer(own, own))
    apart = np.minimum.outer(own, own) * (1.0 - np.minimum(cosine**2, 1.0))
    return np.asarray((apart < 2.0 * TOLD_APART) & ~np.eye(len(own), dtype=bool))


def isolability(e: Explanation, progress: Progress | None = None) -> tuple[Isolable, ...]:
    """One entry for each effect among the hypotheses of a link, for the one (of an axis, a body)
    that shows most at its largest size.
    """
    model = e.timed()
    found = detectable(model, e.candidates, progress)
    seen = [s for s in found if s.size is not None]
    same = alike(FisherInformation(model, [s.effects for s in seen]).of())
    kinds = np.array([s.kind for s in seen])
    others = {s.kind: tuple(kinds[row]) for s, row in zip(seen, same, strict=True)}
    return tuple(
        Isolable(s.kind, s.parameter, s.unit, s.size, others.get(s.kind, ())) for s in found
    )


@dataclass(frozen=True)
class Detectable:
    """The smallest size of an effect that data would show.

    Attributes:
        candidate: the hypothesis of the effect that shows most. theta: its parameters at that size.
        shows: whether the data show the effect at the largest size that is searched.
    """

    candidate: Candidate
    theta: Array
    shows: bool

    @property
    def effects(self) -> Effects:
        return [self.candidate.at(self.theta)]

    @property
    def size(self) -> float | None:
        """Of the leading parameter, a factor's departure from 1, where the data show the effect;
        the end of its search where they show every size that is searched.
        """
        if not self.shows:
            return None
        names = self.candidate.names
        value = float(self.theta[0]) if names else 1.0
        return abs(value - 1.0) if names and names[0] == "factor" else abs(value)

    @property
    def kind(self) -> str:
        return self.candidate.kind

    @property
    def parameter(self) -> str:
        """The parameter that is its size, or else what it has in place of one."""
        c = self.candidate
        return c.names[0] if c.names else next(iter(c.fixed), "")

    @property
    def unit(self) -> str:
        name = self.parameter.partition(".")[0]
        return self.candidate.effect.unit(name) if name else ""


def detectable(
    model: LinkModel, candidates: Sequence[Candidate], progress: Progress | None = None
) -> list[Detectable]:
    """One for each effect among the candidates: of its hypotheses the one that changes the residual
    most at its largest size, at the smallest size at which it would be named.

    The sizes of all effects are sought together: each round is one replay.
    """
    here = model.likelihood(max(1, len({c.kind for c in candidates})))

    def excess(some: Sequence[Candidate], sizes: Array, squares: Array | None = None) -> Array:
        """Logarithm of each change over the least that shows: it is worth the price of the cause in
        evidence, with certainty, and more than two models of the same physics differ by: -2 log of
        the likelihood falls by the square, with a standard deviation of twice its root.
        """
        each: list[Effects] = [[c.at(_at(c, s))] for c, s in zip(some, sizes, strict=True)]
        squares = FisherInformation(model, each).squares() if squares is None else squares
        prices = np.array([NAMED - here.evidence(0.0, (c,)) for c in some])
        least = CERTAINTY + np.sqrt(CERTAINTY**2 + 2.0 * prices)
        over = np.minimum(np.sqrt(squares) / least, model.over_negligible(each))
        return np.asarray(np.log(np.maximum(over, np.finfo(float).tiny)))

    largest: dict[str, tuple[Candidate, float]] = {}
    full = FisherInformation(model, [[c.at(_at(c, 1.0))] for c in candidates]).squares()
    for c, square in zip(candidates, full, strict=True):
        if c.kind not in largest or square > largest[c.kind][1]:
            largest[c.kind] = (c, square)
    first = [c for c, _ in largest.values()]
    most = excess(first, np.ones(len(first)), np.array([s for _, s in largest.values()]))
    sizes, shows = np.array([1.0 if c.names else 0.0 for c in first]), most > 0.0
    open_ = np.flatnonzero(shows & (sizes > 0.0))
    rounds = itertools.count(1)

    def over(size: Array, which: np.ndarray) -> Array:
        if progress:
            progress(f"round {next(rounds)}")
        return excess([first[int(i)] for i in which], size)

    if len(open_):
        # to the root by T. R. Chandrupatla, Adv. Eng. Softw. 28, 1997
        near = {"xatol": 0.0, "xrtol": 0.0, "fatol": SIZE_ERROR, "frtol": 0.0}
        ends = np.zeros(len(open_)), np.ones(len(open_))
        found = find_root(over, ends, args=(open_,), tolerances=near, maxiter=MOST_ROUNDS)
        # what shows at any size does at next to none
        other = np.where(found.f_bracket[0] > 0.0, 0.0, found.bracket[1])
        sizes[open_] = np.where(found.success, found.x, other)
    return [
        Detectable(c, _at(c, float(size)), bool(there))
        for c, size, there in zip(first, sizes, shows, strict=True)
    ]


def _at(c: Candidate, size: float) -> Array:
    """The parameters of a candidate at a size from 0 to 1: further components of a vector are as
    near to 0 as they are searched, other parameters where a search starts.
    """
    theta = np.array(c.grid[len(c.grid) // 2], dtype=float)
    if len(theta):
        leading = c.names[0].partition(".")[0]
        beside = np.array([name.partition(".")[0] == leading for name in c.names])
        theta = np.where(beside, 0.0, np.where(c.low <= 0, theta, np.maximum(theta, c.low)))
        theta[0] = _value(c, size)
    return np.clip(theta, c.low, c.high)


def _value(c: Candidate, size: float) -> float:
    """The leading parameter for a size from 0 (next to nothing) to 1 (the largest searched)."""
    a, b = float(c.low[0]), float(c.high[0])
    if c.names[0] == "factor":
        return 1.0 + (min(b, 1.5) - 1.0) * 10.0 ** (-5.0 * (1.0 - size))
    if c.effect.vanishes:
        return b * (a / b) ** size if a > 0 else b * (1.0 - size)
    most = max(abs(a), abs(b))
    return most * 10.0 ** (-7.0 * (1.0 - size))
