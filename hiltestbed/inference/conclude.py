"""From a search to what can be said: causes that carry over to runs that were not fitted, with
intervals and rivals.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import Likelihood, PosteriorFit, independent
from hiltestbed.inference.model import Hypothesis, Model, places
from hiltestbed.inference.residuals import Changes, RunResiduals
from hiltestbed.inference.search import SCREENED_STEPS, Searched, extended, named, without

# of the rms on left-out runs, in the mean of its logarithm: what is worth less no test engineer
# asks for
LEAST_GAIN = 0.03
PRIOR_SHARE = 0.95  # of a range, that the 95 % interval of its uniform prior has
RIVALS = 3  # effects that are fitted in the place of a cause
POOL = 8  # sets of effects that are compared on left-out runs
# log of the odds of 19 to 1, at which two explanations count as told apart
TOLD_APART = math.log(19.0)
# the same of 99 to 1, by which a cause has to raise the evidence: where it does not act, it does so
# in one record of a hundred at most (A. A. Markov's inequality for the ratio of two likelihoods)
NAMED = math.log(99.0)
# quantile of Student's t with two runs less one is 12.7; with so few the scatter is bounded by the
# curvature instead, and that of three runs is taken
MOST_QUANTILE = float(student.ppf(0.975, 2))

NO_PRIORS = np.zeros(0)

Progress = Callable[[str], None]
Fold = tuple[str, Model, Model]  # what is left out; the model of the rest; and of that


@dataclass(frozen=True, eq=False)
class Estimate:
    """A parameter of a cause: its name, value and 95 % interval."""

    name: str
    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Confirmed:
    """A cause that holds on runs that were not fitted.

    Attributes:
        cause: the part of an effect. estimates: of its parameters. gain: share of the rms on
            left-out runs that it removes beside the others. probability: that it is this and none
            of the ``rivals``, other effects that explain the data as well.
    """

    cause: Candidate
    estimates: tuple[Estimate, ...]
    gain: float
    probability: float
    rivals: tuple[str, ...]
    others: tuple[PosteriorFit, ...] = ()
    determined: bool = True

    @property
    def effect(self) -> Any:
        """The cause with its estimates."""
        return self.cause.at(np.array([e.value for e in self.estimates]))


@dataclass(frozen=True, eq=False)
class SearchConclusion:
    """What a search and the left-out runs say together.

    Attributes:
        fit: the hypothesis that is offered, fitted to all runs; null: nothing departs.
        causes: of the fit, those that remove most first. before, after: (R,) rms of each run when
            it is left out, in the unit of the record, of the null and of the fit; alone: of a fit
            of the causes that are determined alone, None where all are. visited: what was compared
            by the likelihood. ends: (P, 2) of the 95 % intervals of the parameters of the fit.
        judge: by which hypotheses are compared on left-out runs.
    """

    fit: PosteriorFit
    null: PosteriorFit
    causes: tuple[Confirmed, ...]
    before: Array
    after: Array
    alone: Array | None
    visited: tuple[PosteriorFit, ...]
    ends: Array
    likelihood: Likelihood
    judge: LeftOut


class LeftOut:
    """Hypotheses fitted to all runs but one, and scored on that one."""

    def __init__(self, likelihood: Likelihood, folds: Sequence[Fold]) -> None:
        """folds: names, the runs to fit, and those that are left out."""
        self._whole = likelihood
        self._known: dict[tuple[str, ...], list[PosteriorFit]] = {}
        counts = dict(zip(likelihood.model.runs, likelihood.counts, strict=True))

        def of(model: Model) -> Likelihood:
            return Likelihood(model, np.array([counts[r] for r in model.runs]), likelihood.choices)

        self._folds = [(of(a), of(b)) for _, a, b in folds]

    def fits(self, found: PosteriorFit) -> list[PosteriorFit]:
        """The hypothesis fitted to each set of runs: where the noise is known, in a few steps by
        the slopes of all runs, of which one more or less changes little.
        """
        if found.keys not in self._known:
            start = found.causes, [found.of.theta], found.of.nuisances
            if self._whole.model.noise_known:
                x = np.concatenate([found.of.theta, found.of.nuisances])
                slopes = self._whole.slopes(found.causes, x, found.left)
                fits = [
                    a.fit(*start, SCREENED_STEPS, self._of_fold(slopes, found.left, a.model))
                    for a, _ in self._folds
                ]
            else:
                fits = [a.fit(*start) for a, _ in self._folds]
            self._known[found.keys] = fits
        return self._known[found.keys]

    def _of_fold(self, slopes: Changes, left: RunResiduals, model: Model) -> Changes:
        """The slopes of the samples of all runs that a fold has."""
        pairs = zip(self._whole.model.runs, zip(left.starts, left.rows, strict=True), strict=True)
        places = dict(pairs)
        each = [slopes.samples.T[s : s + n] for s, n in (places[run] for run in model.runs)]
        return Changes(np.concatenate(list(map(model.kept, each))).T, slopes.priors)

    def rms(self, found: PosteriorFit) -> Array:
        """(F,) of each left-out part, as its owner would compare it, in the unit of the record."""
        pairs = zip(self.fits(found), self._folds, strict=True)
        return np.array([_rms(left.model.departure(fit.of)) for fit, (_, left) in pairs])

    def score(self, found: PosteriorFit) -> float:
        """Mean logarithm of the rms of the residuals of the left-out parts; where the noise is
        known, half their cost an independent sample, which above the noise is the same.
        """
        if not self._folds[0][1].model.noise_known:
            return float(np.mean(self._log_rms(found)))
        pairs = list(zip(self.fits(found), self._folds, strict=True))
        scored = [RunResiduals.of([*left.model.scored(f.of), NO_PRIORS]) for f, (_, left) in pairs]
        costs = [left.cost(x) for x, (_, left) in zip(scored, self._folds, strict=True)]
        return sum(costs) / (2.0 * sum(float(left.counts.sum()) for _, left in self._folds))

    def worse(self, one: PosteriorFit, other: PosteriorFit) -> bool:
        """Whether ``one`` predicts the left-out parts worse than the ``other``: by more than
        :data:`LEAST_GAIN`, and by more than a standard error of the difference over the parts (L.
        Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees, 1984).
        """
        more = self._log_rms(one) - self._log_rms(other)
        error = float(np.std(more, ddof=1)) / math.sqrt(len(more))
        return float(np.mean(more)) > max(LEAST_GAIN, error)

    def _log_rms(self, found: PosteriorFit) -> Array:
        """(F,) logarithm of the rms of the residual of each left-out part."""
        pairs = zip(self.fits(found), self._folds, strict=True)
        each = [_rms(left.model.scored(f.of)) for f, (_, left) in pairs]
        return np.log(np.maximum(each, 1e-300))


def _rms(parts: Sequence[Array]) -> float:
    value = math.sqrt(float(np.mean(np.concatenate(parts) ** 2)))
    return value if math.isfinite(value) else math.inf


def conclude(
    found: Searched,
    folds: Sequence[Fold],
    candidates: Sequence[Candidate],
    progress: Progress | None = None,
) -> SearchConclusion:
    """What holds of the best hypothesis: the one with the most evidence, unless another, or one
    with fewer causes, predicts the parts that were not fitted better. Where the noise is known,
    causes are left out, the least useful first, while these are predicted as well without them.
    """
    trial = _Trial(found, folds)
    null, judge = found.null, trial.judge
    if progress:
        progress("left-out runs: the hypotheses with the most evidence")
    offered, weak, alone = _needed(trial, _selected(trial, found, progress))
    if trial.worse_than_none(offered.fit, null):
        offered, weak, alone = trial.settled(null), frozenset(), None
    causes = _confirmed(trial, offered, weak, candidates)
    trial.likelihood.forget()
    return SearchConclusion(
        replace(offered.fit, of=offered.of),
        null,
        causes,
        judge.rms(null),
        judge.rms(offered.fit),
        None if alone is None else judge.rms(alone),
        found.visited,
        offered.ends,
        trial.likelihood,
        judge,
    )


class _Settled(NamedTuple):
    """A fit of the search; of: its numbers by what the owner compares; ends: (P, 2) of their 95 %
    intervals.
    """

    fit: PosteriorFit
    of: Hypothesis
    ends: Array


class _Trial:
    """By what hypotheses are compared: the likelihood of the search, that of what the owner
    compares, and the left-out runs of the latter.
    """

    def __init__(self, found: Searched, folds: Sequence[Fold]) -> None:
        self.likelihood = found.likelihood
        self.known = self.likelihood.model.noise_known
        self.owner, self.judge = _in_time(found, folds) or (
            self.likelihood,
            LeftOut(self.likelihood, folds),
        )

    def settled(self, fit: PosteriorFit) -> _Settled:
        """The fit by what the owner compares. The intervals hold the estimate of the search as
        well: where the two differ, the model is wrong by that much.
        """
        if self.owner is self.likelihood:
            return _Settled(fit, fit.of, intervals(self.owner, fit, self.judge))
        there = self.owner.fit(fit.causes, [fit.of.theta], fit.of.nuisances)
        ends = intervals(self.owner, there, self.judge)
        low, high = np.minimum(ends[:, 0], fit.of.theta), np.maximum(ends[:, 1], fit.of.theta)
        return _Settled(fit, there.of, np.column_stack([low, high]))

    def worse_than_none(self, fit: PosteriorFit, null: PosteriorFit) -> bool:
        """Whether the left-out runs are predicted worse than if nothing departed."""
        if self.known:
            return self.judge.score(fit) > self.judge.score(null)
        more = np.log(self.judge.rms(fit)) - np.log(self.judge.rms(null))
        return float(np.mean(more)) > 0.0


def _selected(trial: _Trial, found: Searched, progress: Progress | None) -> PosteriorFit:
    """The hypothesis with the most evidence that none predicts the left-out runs better than; where
    what is known to be noise alone is left, without the causes that are not needed for that.
    """
    likelihood, judge = trial.likelihood, trial.judge
    fit = found.best if found.best.evidence > found.null.evidence else found.null
    pool = [] if trial.known else _pool(found)
    while True:
        if progress:
            progress(f"left-out runs: {named(fit)}")
        fewer = [without(likelihood, fit, i) for i in range(len(fit.causes))]
        if likelihood.model.leaves_noise(fit.left):
            better = [f for f in fewer if f.evidence > fit.evidence - NAMED]
            better = [f for f in better if likelihood.model.leaves_noise(f.left)]
            better.sort(key=lambda f: -f.evidence)
        elif trial.known:
            better = [f for f in fewer if judge.score(f) <= judge.score(fit)]
            better.sort(key=judge.score)
        else:
            better = [f for f in (*pool, *fewer) if judge.worse(fit, f)]
            better.sort(key=lambda f: -f.evidence)
        if not better:
            break
        fit = better[0]
    return fit


def _needed(
    trial: _Trial, chosen: PosteriorFit
) -> tuple[_Settled, frozenset[int], PosteriorFit | None]:
    """What is ``chosen`` without the causes that the data do not determine. Where the noise is not
    known, those stay without which the left-out runs are predicted worse than by ``chosen``; then
    also those of which the size may be none, and the fit without them, which predicts worse.
    """
    likelihood, judge = trial.likelihood, trial.judge
    fit, needed = trial.settled(chosen), 0
    while len(open_ := undetermined(fit)) > needed:
        fewer = without(likelihood, fit.fit, open_[needed])
        if not trial.known and judge.worse(fewer, chosen):
            needed += 1
        else:
            fit, needed = trial.settled(fewer), 0
    while weak := frozenset(undetermined(fit, size_alone=True)):
        alone = _without_all(likelihood, fit.fit, weak)
        if judge.score(alone) > judge.score(fit.fit):
            return fit, weak, alone
        fit = trial.settled(alone)
    return fit, weak, None


def _without_all(likelihood: Likelihood, fit: PosteriorFit, gone: frozenset[int]) -> PosteriorFit:
    """The other causes fitted again."""
    for key in [fit.causes[i].key for i in sorted(gone)]:
        left = [i for i, c in enumerate(fit.causes) if c.key == key]
        fit = without(likelihood, fit, left[0]) if left else fit
    return fit


def _confirmed(
    trial: _Trial, settled: _Settled, weak: frozenset[int], candidates: Sequence[Candidate]
) -> tuple[Confirmed, ...]:
    """The causes of a fit, those that remove most first, with their rivals among candidates."""
    likelihood, judge = trial.likelihood, trial.judge
    fit, score = replace(settled.fit, of=settled.of), judge.score(settled.fit)
    causes = []
    for i, (cause, own) in enumerate(zip(fit.causes, places(fit.causes), strict=True)):
        ends = settled.ends[own]
        estimates = tuple(
            Estimate(name, float(v), float(low), float(high))
            for name, v, (low, high) in zip(cause.names, fit.of.theta[own], ends, strict=True)
        )
        if likelihood.model.negligible(fit.of, i):
            continue
        fewer = without(likelihood, fit, i)
        worse = _more_left(likelihood, fewer, fit) if trial.known else judge.score(fewer) - score
        others, probability = _rivals(likelihood, fit, i, fewer, candidates)
        gain = 1.0 - math.exp(-worse)
        said = cause, estimates, gain, probability, tuple(others), tuple(others.values())
        causes.append(Confirmed(*said, i not in weak))
    return tuple(sorted(causes, key=lambda c: -c.gain))


def _more_left(likelihood: Likelihood, fewer: PosteriorFit, fit: PosteriorFit) -> float:
    """What a fit with fewer causes leaves more, as the mean logarithm of the rms."""
    costs = [likelihood.cost(f.left) for f in (fewer, fit)]
    return (costs[0] - costs[1]) / (2.0 * float(likelihood.counts.sum()))


def undetermined(settled: _Settled, size_alone: bool = False) -> list[int]:
    """The causes of a fit, the last first, whose size may be none, or of which an interval is as
    wide as that of a uniform prior: the data do not determine them. ``size_alone``: only by the
    first number of a cause, which is its size; of a vector by all.
    """
    causes, out = settled.fit.causes, []
    where = places(causes)
    for index in reversed(range(len(causes))):
        cause, own = causes[index], settled.ends[where[index]]
        if not cause.names:
            continue
        neutral = 1.0 if cause.names[0] == "factor" else 0.0
        size = own if cause.vector else own[:1]
        may_be_none = bool(np.all((size[:, 0] <= neutral) & (neutral <= size[:, 1])))
        none = not cause.effect.vanishes and may_be_none
        rows = np.column_stack([own, cause.low, cause.high])
        rows[cause.log] = np.log(rows[cause.log])
        width = rows[:, 3] - rows[:, 2]
        spans = (rows[:, 1] - rows[:, 0]) >= PRIOR_SHARE * width
        seen = spans[: len(size)] if size_alone else spans
        if none or (seen.all() if cause.vector else seen.any()):
            out.append(index)
    return out


def _pool(found: Searched) -> list[PosteriorFit]:
    """The hypotheses that are compared on left-out runs: of each set of effects the one with the
    most evidence.
    """
    first: dict[frozenset[str], PosteriorFit] = {}
    for f in found.visited:
        first.setdefault(frozenset(c.kind for c in f.causes), f)
    return list(first.values())[:POOL]


def _in_time(found: Searched, folds: Sequence[Fold]) -> tuple[Likelihood, LeftOut] | None:
    """Likelihood and left-out runs of what the owner compares; None where the search compared just
    that.
    """
    there = found.likelihood.model.in_time()
    if there is None:
        return None
    moved = [(name, a.in_time(), b) for name, a, b in folds]
    likelihood = Likelihood(there, independent(there.residuals(found.best.of)))
    return likelihood, LeftOut(likelihood, [(n, a, b) for n, a, b in moved if a is not None])


def intervals(likelihood: Likelihood, fit: PosteriorFit, held: LeftOut) -> Array:
    """(P, 2) ends of the 95 % intervals: of the curvature, or of the scatter of the fits that leave
    one run out (the jackknife: B. Efron, C. Stein, Ann. Stat. 9, 1981), whichever is wider. The
    latter holds where the model is wrong as well; where it is wrong in all runs alike, by what that
    moves the estimates.
    """
    count = len(fit.of.theta)
    if not count:
        return np.zeros((0, 2))
    x = np.concatenate([fit.of.theta, fit.of.nuisances])
    slopes = likelihood.slopes(fit.causes, x, fit.left)
    low = np.concatenate([c.low for c in fit.causes])
    high = np.concatenate([c.high for c in fit.causes])
    scale = likelihood.scale_of(fit.causes, x)
    normal, _ = likelihood.normal(fit.left, slopes)
    inverse = np.linalg.pinv(normal, hermitian=True)
    curved = 1.96 * np.sqrt(np.maximum(np.diag(inverse)[:count], 0.0)) * scale[:count]
    thetas = np.array([f.of.theta for f in held.fits(fit)])
    runs = len(thetas)
    jack = math.sqrt((runs - 1) / runs) * np.linalg.norm(thetas - thetas.mean(axis=0), axis=0)
    quantile = min(float(student.ppf(0.975, max(runs - 1, 1))), MOST_QUANTILE)
    half = np.maximum(curved, quantile * jack)
    precision = likelihood.precision(fit.left)
    for errors in likelihood.model.common_errors(fit.of):
        gradient = slopes.samples @ (precision * np.concatenate(errors))
        half = np.hypot(half, 1.96 * np.abs(inverse @ gradient)[:count] * scale[:count])
    return np.column_stack(
        [np.maximum(fit.of.theta - half, low), np.minimum(fit.of.theta + half, high)]
    )


def _rivals(
    likelihood: Likelihood,
    fit: PosteriorFit,
    index: int,
    fewer: PosteriorFit,
    candidates: Sequence[Candidate],
) -> tuple[dict[str, PosteriorFit], float]:
    """Effects that do as well beside the ``fewer`` in the place of a cause, the best first, each
    with its fit; and the probability of the cause beside them. Another place of the same effect is
    one of them.
    """
    cause = fit.causes[index]

    def evidence(of: PosteriorFit) -> float:
        # where a number of the fit stands at the end of its range, that of its rivals may as well
        ended = fit.evidence == -math.inf
        return likelihood.evidence(likelihood.cost(of.left), of.causes) if ended else of.evidence

    here = evidence(likelihood.again(fit))
    others = [c for c in candidates if c.kind != cause.kind or c.place != cause.place]
    close: dict[str, tuple[float, PosteriorFit]] = {}

    def kinds(of: PosteriorFit) -> Counter[str]:
        return Counter(c.kind for c in of.causes)

    for other in extended(likelihood, fewer, others, RIVALS):
        gap = evidence(other) - here
        # one of a kind that acts already is another part of it, or a second one beside it
        for kind in sorted(kinds(other) - kinds(fewer)):
            if gap > -TOLD_APART and (kind not in close or gap > close[kind][0]):
                close[kind] = (gap, other)
    total = sum(math.exp(min(gap, 0.0)) for gap, _ in close.values())
    ranked = sorted(close, key=lambda k: -close[k][0])
    return {k: close[k][1] for k in ranked}, 1.0 / (1.0 + total)
