"""The likelihood of a hypothesis, its fit, and its evidence.

The residual of a run is taken for normal noise of a variance that is not known but not below the
run's floor, and of which ``counts`` samples are independent. At the variance that fits best,
v = max(mean square, floor^2)::

    log L = -1/2 sum over runs of counts (log v + mean square/v) - 1/2 sum (nuisance/sigma)^2

Above its floor each run therefore counts by the *share* of its residual that a hypothesis removes:
a run that departs most does not decide alone. At the floor it counts by its chi-square. Where the
floor is itself only an estimate, as of a machine, log v is that of mean square + floor^2. Where a
model is wrong, its residuals are smooth and few of them are independent; the number follows from
their autocorrelation (C. J. Geyer, Stat. Sci. 7, 1992: the initial positive sequence). The evidence
of a hypothesis of P parameters is Laplace's approximation with a prior that is worth one sample
(G. Schwarz, Ann. Stat. 6, 1978)::

    log E = log L - P/2 log(sum of counts) - log(number of ways to choose the causes)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.model import Hypothesis, Model, places
from hiltestbed.inference.residuals import Changes, Gram, RunResiduals

BEGUN = 3  # values of the nuisances from which a fit of nothing is begun, the best of their starts
STEP = 1e-4  # of a parameter's scale, for differences: about the root of a kernel's round-off
ITERATIONS = 40
# change of every mean square below which a descent has converged; and of -2 log L: a hundredth of
# what a parameter costs in the evidence
CONVERGED, LEAST_CHANGE = 1e-4, 0.05
Move = tuple[Candidate, ...]  # that join a hypothesis together
Start = tuple[tuple[float, ...], ...]  # of each candidate of a move
PROMISED_AT_ONCE = 64  # hypotheses whose predictions are held at once
FITTED_SHAPES = 3  # of the starts of a move that a fit compares, the best
# share of a number in which the prediction jumps: to each side of it that is scanned, points of the
# scan, and the step at which the search ends
SCAN, SCAN_POINTS, SCAN_END = 0.1, 21, 1e-3

# of a mean square over that of the noise, from which a run departs; share of what is left of such
# runs, in the mean logarithm of its rms, that a further cause has to remove
DEPARTING, LEAST_SHARE = 2.0, 0.03
# of the curvature of a number, that is added to it at first: so little that a direction that only
# priors determine is followed at once
LEAST_DAMPING = 1e-9
# the same where the noise is not known: the cost, a logarithm of mean squares, is no parabola
FIRST_DAMPING = 1e-3
NEAR = 1e-3  # of a range, within which an estimate stands at its end
LEAST_COUNT = 4.0  # a run of which fewer samples are independent tells no variance


@dataclass(frozen=True, eq=False)
class PosteriorFit:
    """A hypothesis at its maximum of the posterior.

    Attributes:
        of: the hypothesis. cost: -2 log of the likelihood with the priors of the nuisances.
        evidence: log. left: the residuals.
    """

    of: Hypothesis
    cost: float
    evidence: float
    left: RunResiduals

    @property
    def causes(self) -> tuple[Candidate, ...]:
        return self.of.causes

    @property
    def keys(self) -> tuple[str, ...]:
        """Identifies the set of causes."""
        return tuple(sorted(str(c.key) for c in self.of.causes))

    def rms(self) -> Array:
        """(R,) of each run's residual."""
        return np.sqrt(self.left.squares())


def independent(left: Sequence[Array], noise_known: bool = False) -> Array:
    """(R,) number of independent samples in each residual: the geometric mean over the runs, since
    how many a run has says how lively it is, and not how much it tells; all samples where the noise
    is known to be white.
    """
    if noise_known:
        return np.array([float(len(x)) for x in left[:-1]])
    counts = [max(len(x) / _correlated(x), LEAST_COUNT) for x in left[:-1]]
    return np.full(len(counts), float(np.exp(np.mean(np.log(counts)))))


def _correlated(x: Array) -> float:
    """Samples that count as one: 1 + 2 sum of the autocorrelation while its pairs are positive."""
    n = len(x)
    size = 1 << (2 * n - 1).bit_length()
    power = np.abs(np.fft.rfft(x, size)) ** 2
    r = np.fft.irfft(power, size)[: n // 2]
    if len(r) < 4 or r[0] <= 0.0:
        return 1.0
    rho = r / r[0]
    pairs = rho[1 : len(rho) - 1 : 2] + rho[2 : len(rho) : 2]
    ends = np.flatnonzero(pairs <= 0.0)
    return float(1.0 + 2.0 * np.sum(pairs[: ends[0]] if len(ends) else pairs))


class Likelihood:
    """The likelihood of the runs of a model.

    Attributes:
        model: of the runs. counts: (R,) independent samples. choices: ways to choose one cause.
    """

    def __init__(self, model: Model, counts: Array, choices: int = 1) -> None:
        self.model, self.counts, self.choices = model, counts, choices
        # what moves change alone, of the samples and of the model's own priors, and further priors;
        # kept for all likelihoods of one model
        self._alone: dict[tuple[Any, ...], tuple[Any, Array, Array]] = {}
        # of these counts, the fit where nothing departs
        self._nothing: dict[bytes, PosteriorFit] = {}
        # (M,) of each sample the unit in which that is kept, and the present one over it
        self._unit, self._units = model.sample_weights(), 1.0
        self._squares = np.maximum(np.asarray(model.floors) ** 2, np.finfo(float).tiny)
        self._sigma = model.prior_sigma()

    def counting(self, counts: Array) -> Likelihood:
        """The same with other ``counts``."""
        out = copy(self)
        out.counts = counts
        return out

    def choosing(self, choices: int) -> Likelihood:
        """The same with so many ways to choose one cause."""
        out = copy(self)
        out.choices = choices
        return out

    def through(self, model: Model) -> Likelihood:
        """That of a model of the same samples with other weights; what moves change alone is taken
        from this one.
        """
        out = copy(self)
        out.model, out._units = model, model.sample_weights() / self._unit
        out._nothing = {}
        return out

    def forget(self) -> None:
        """Let go of what was predicted of moves alone, here and in all others of the same model."""
        self._alone.clear()

    def bounds(self, causes: Sequence[Candidate]) -> tuple[Array, Array, np.ndarray]:
        """Bounds of the parameters of ``causes`` and of the nuisances, and which are searched by
        ratio.
        """
        low, high, log = _bounds(causes)
        most = np.array([n.most for n in self.model.nuisances])
        least = np.array([-n.most if n.least is None else n.least for n in self.model.nuisances])
        return (
            np.concatenate([low, least]),
            np.concatenate([high, most]),
            np.concatenate([log, np.zeros(len(most), bool)]),
        )

    def start(self) -> PosteriorFit:
        """Nothing departs, with the nuisances as the data have them."""
        key = self.counts.tobytes()
        if key not in self._nothing:
            grid = itertools.product(*((0.0, *n.starts) for n in self.model.nuisances))
            tried = [np.array(values) for values in grid]
            costs = [self.cost(left) for left in self.lefts((), tried)]
            best = [tried[i] for i in np.argsort(costs)[:BEGUN]]
            fits = [self.fit((), [np.zeros(0)], eta) for eta in best]
            self._nothing[key] = min(fits, key=lambda f: f.cost)
        return self._nothing[key]

    def cost(self, left: RunResiduals) -> float:
        """-2 log of the likelihood of residuals, with the priors."""
        return self._cost(left.squares(), float(left.priors @ left.priors))

    def _cost(self, squares: Array, priors: float) -> float:
        """The same of (R,) mean squares, and the sum of squares of the priors."""
        variance = self._variance(squares)
        least = squares / variance if self.model.noise_known else 0.0
        out = float(self.counts @ (np.log(variance) + least)) + priors
        return out if math.isfinite(out) else math.inf

    def _variance(self, squares: Array) -> Array:
        """(R,) of the noise of each run, by the mean square of its residual."""
        if self.model.noise_known:
            return np.maximum(squares, self._squares)
        return squares + self._squares

    def evidence(self, cost: float, causes: Sequence[Candidate]) -> float:
        """Log of the evidence of a fit of ``causes``."""
        numbers = sum(max(1, len(c.names)) for c in causes)
        price = 0.5 * numbers * math.log(float(self.counts.sum()))
        ways = sum(math.log(self.choices * c.choices) for c in causes)
        return -0.5 * cost - price - ways

    def most_gain(self, found: PosteriorFit) -> float:
        """What any further cause could add to the log likelihood of a fit: with no residual left,
        the noise of each run is its floor.
        """
        return 0.5 * (found.cost - float(self.counts @ np.log(self._squares)))

    def least_gain(self, found: PosteriorFit) -> float:
        """Of the log likelihood, by which a further cause has to raise it: where the noise is known
        and far more than noise is left, causes that remove a small share of it chase what has no
        name.
        """
        if not self.model.noise_known:
            return 0.0
        squares = found.left.squares()
        departing = squares > DEPARTING * self._squares
        return LEAST_SHARE * float(self.counts[departing].sum())

    def least_price(self, candidates: Sequence[Candidate]) -> float:
        """What the cheapest of further causes costs in evidence."""
        return min((-self.evidence(0.0, (c,)) for c in candidates), default=math.inf)

    def again(self, found: PosteriorFit) -> PosteriorFit:
        """A fit of another likelihood, scored by this one as it stands."""
        cost = self.cost(found.left)
        ended = found.evidence == -math.inf
        evidence = -math.inf if ended else self.evidence(cost, found.causes)
        return replace(found, cost=cost, evidence=evidence)

    def fit(
        self,
        causes: Sequence[Candidate],
        starts: Sequence[Array],
        nuisances: Array | None = None,
        iterations: int = ITERATIONS,
        known: Changes | None = None,
    ) -> PosteriorFit:
        """The maximum that Levenberg's and Marquardt's descent reaches from the best of
        ``starts``.

        Args:
            known: of the first causes, and last of the nuisances, about what the :meth:`slopes`
                are: only those of the others are computed at first.
        """
        causes, nothing = tuple(causes), np.zeros(len(self._sigma))
        eta = nothing if nuisances is None else nuisances
        found = self._fit_from(causes, starts, eta, iterations, known)
        eta = found.of.nuisances
        if not self.model.noise_known or not causes or not np.any(np.abs(eta) > self._sigma):
            return found
        # what a time stands in for, a cause may explain
        late = sum(v for v, n in zip(eta, self.model.nuisances, strict=True) if n.unit == "s")
        times = np.array([c.unit(n) == "s" for c in causes for n in c.names])
        starts = [found.of.theta + by * times for by in (0.0, late, -late)]
        other = self._fit_from(causes, starts, nothing, iterations, known)
        return min(found, other, key=lambda f: f.cost)

    def _fit_from(
        self,
        causes: tuple[Candidate, ...],
        starts: Sequence[Array],
        eta: Array,
        iterations: int,
        known: Changes | None,
    ) -> PosteriorFit:
        """The maximum that is reached from values ``eta`` of the nuisances."""
        low, high, log = self.bounds(causes)
        begun = [np.clip(np.concatenate([theta, eta]), low, high) for theta in starts]
        shown = self.lefts(causes, begun)
        costs = [self.cost(left) for left in shown]
        first = int(np.argmin(costs))
        x, left, least = begun[first], shown[first], costs[first]
        slopes = None if known is None else self._completed(known, causes, x, left)
        x, left, least = self._descend(causes, x, left, least, slopes, (low, high, log), iterations)
        if iterations == ITERATIONS:
            x, left, least = self._scanned(causes, x, left, least, (low, high))
        count = len(x) - len(eta)
        ended = _at_end(causes, x)
        of = Hypothesis(causes, x[:count], x[count:])
        ended = ended or (iterations == ITERATIONS and self.model.contradicts(of, left))
        evidence = -math.inf if ended else self.evidence(least, causes)
        return PosteriorFit(of, least, evidence, left)

    def _left(self, causes: tuple[Candidate, ...], x: Array) -> RunResiduals:
        return self.lefts(causes, [x])[0]

    def lefts(self, causes: tuple[Candidate, ...], xs: Sequence[Array]) -> list[RunResiduals]:
        """Residuals of a hypothesis at several values of its numbers."""
        return self._many([(causes, x) for x in xs])

    def _many(self, points: Sequence[tuple[tuple[Candidate, ...], Array]]) -> list[RunResiduals]:
        """Residuals of hypotheses, each with its numbers."""
        return self.model.many([self._at(causes, x) for causes, x in points])

    def _at(self, causes: tuple[Candidate, ...], x: Array) -> Hypothesis:
        count = len(x) - len(self._sigma)
        return Hypothesis(causes, x[:count], x[count:])

    def _scanned(self, causes, x, left, cost, bounds):
        """The best within a tenth of each number in which the prediction jumps, where slopes are no
        guide: a scan, and a pattern search (R. Hooke, T. A. Jeeves, J. ACM 8, 1961).
        """
        jumps = [c.effect.jumps == name for c in causes for name in c.names]
        for j in np.flatnonzero(jumps):
            step, parts = SCAN, np.linspace(-SCAN, SCAN, SCAN_POINTS)
            while step > SCAN_END:
                tried = np.tile(x, (len(parts), 1))
                tried[:, j] = np.clip(x[j] * (1.0 + parts), bounds[0][j], bounds[1][j])
                shown = self.lefts(causes, list(tried))
                costs = [self.cost(s) for s in shown]
                best = int(np.argmin(costs))
                if costs[best] < cost - LEAST_CHANGE:
                    x, left, cost = tried[best], shown[best], costs[best]
                else:
                    step *= 0.4
                parts = np.array([step, -step])
        return x, left, cost

    def precision(self, left: RunResiduals) -> Array:
        """(M,) of each sample, with which the sum of squares has the gradient of the cost."""
        return np.repeat(self._precision(left), left.rows)

    def _precision(self, left: RunResiduals) -> Array:
        """(R,) of the samples of each run."""
        return self.counts / (left.rows * self._variance(left.squares()))

    def slopes(
        self,
        causes: tuple[Candidate, ...],
        x: Array,
        left: RunResiduals,
        among: slice = slice(None),
    ) -> Changes:
        """Of the residuals per unit of each scaled parameter and nuisance, or of those ``among``
        them.
        """
        low, high, log = self.bounds(causes)
        scale = self.scale(x, low, high, log)
        steps = np.where(x + STEP * scale <= high, STEP, -STEP)
        moved = self.lefts(causes, list((x + np.diag(steps * scale))[among]))
        pairs = list(zip(moved, steps[among], strict=True))
        return Changes(
            np.array([(m.samples - left.samples) / step for m, step in pairs]).reshape(
                len(pairs), len(left.samples)
            ),
            np.array([(m.priors - left.priors) / step for m, step in pairs]).reshape(
                len(pairs), len(left.priors)
            ),
        )

    def _completed(
        self, known: Changes, causes: tuple[Candidate, ...], x: Array, left: RunResiduals
    ) -> Changes:
        """Slopes of which those of the first causes and of the nuisances are ``known``."""
        first, own = len(known.samples) - len(self._sigma), known.priors.shape[1]
        new = self.slopes(causes, x, left, slice(first, len(x) - len(self._sigma)))
        priors = np.zeros((len(known.priors), len(left.priors)))
        priors[:, :own] = known.priors
        return Changes(
            np.concatenate([known.samples[:first], new.samples, known.samples[first:]]),
            np.concatenate([priors[:first], new.priors, priors[first:]]),
        )

    def scale_of(self, causes: Sequence[Candidate], x: Array) -> Array:
        """The scale of each parameter of ``causes`` and of each nuisance."""
        return self.scale(x, *self.bounds(causes))

    def scale(self, x: Array, low: Array, high: Array, log: np.ndarray) -> Array:
        """Of each number, in which it is differentiated and limited: its size, but not less than a
        hundredth of its range; of a nuisance its standard deviation, or its size where the noise is
        known and a nuisance may be many of them.
        """
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        out = np.where(log, np.abs(x), np.maximum(np.abs(x), 0.01 * width))
        nuisances = slice(len(x) - len(self._sigma), None)
        size = np.abs(x[nuisances]) if self.model.noise_known else 0.0
        out[nuisances] = np.maximum(size, self._sigma)
        return out

    def promises(
        self, base: PosteriorFit, known: Changes, moves: Sequence[Move]
    ) -> list[tuple[float, Move, list[Array]]]:
        """Of each move beside ``base`` the evidence that it promises, the best first, and the
        starts to fit it from: to first order at each start of another shape, all numbers of
        ``base`` following by their slopes, ``known``. Along what a move changes in proportion to
        one of its parameters, the best size follows from one start.

        Where the noise is known, a move is taken to change the residuals as it does without the
        causes of ``base``: that is predicted once, and what promises most is fitted.
        """
        gram, begun = Gram.of(base.left, known), []
        for n, move in enumerate(moves):
            begun += [(n, start) for start in itertools.product(*(c.shapes() for c in move))]
        points = [(n, _started(moves[n], start)) for n, start in begun]
        found: dict[int, list[tuple[float, Start]]] = {}
        changes = self._changes(base, moves, points)
        for (n, theta), (_, start), change in zip(points, begun, changes, strict=True):
            causes = (*base.causes, *moves[n])
            at = causes, np.concatenate([base.of.theta, theta, base.of.nuisances])
            reached = self._promised(base, (known, gram), moves[n], at, change)
            if reached is not None:
                found.setdefault(n, []).append((reached, start))
        out = []
        for n, reached_from in found.items():
            reached_from.sort(key=lambda item: item[0])
            first, *others = (start for _, start in reached_from[:FITTED_SHAPES])
            alike = itertools.product(
                *(c.of_shape(s) for c, s in zip(moves[n], first, strict=True))
            )
            thetas = [_started(moves[n], start) for start in (*alike, *others)]
            starts = [np.concatenate([base.of.theta, theta]) for theta in thetas]
            causes = (*base.causes, *moves[n])
            out.append((self.evidence(reached_from[0][0], causes), moves[n], starts))
        return sorted(out, key=lambda item: -item[0])

    def _changes(
        self, base: PosteriorFit, moves: Sequence[Move], points: Sequence[tuple[int, Array]]
    ) -> Iterator[Changes]:
        """Of the residuals of ``base`` by each of the moves, given by number and starting values;
        to the priors those of the move are added.
        """
        none, own = np.zeros(len(self._sigma)), len(base.left.priors)
        for first in range(0, len(points), PROMISED_AT_ONCE):
            block = points[first : first + PROMISED_AT_ONCE]
            if not self.model.noise_known:
                at = [
                    (
                        (*base.causes, *moves[n]),
                        np.concatenate([base.of.theta, theta, base.of.nuisances]),
                    )
                    for n, theta in block
                ]
                for left in self._many(at):
                    priors = left.priors.copy()
                    priors[:own] -= base.left.priors
                    yield Changes((left.samples - base.left.samples)[None], priors[None])
                continue
            keys = [(*(c.key for c in moves[n]), *theta) for n, theta in block]
            new = [i for i, key in enumerate(keys) if key not in self._alone]
            if new:
                moved = [(moves[block[i][0]], np.concatenate([block[i][1], none])) for i in new]
                null, *lefts = self._many([((), none), *moved])
                shared = len(null.priors)
                for i, left in zip(new, lefts, strict=True):
                    change = (left.samples - null.samples) / self._units
                    priors = left.priors[:shared] - null.priors
                    more = left.priors[shared:]
                    self._alone[keys[i]] = change.astype(np.float32), priors, more
            for key in keys:
                change, priors, more = self._alone[key]
                priors = np.concatenate([priors, np.zeros(own - len(priors)), more])
                yield Changes((change * self._units)[None], priors[None])

    def _promised(
        self,
        base: PosteriorFit,
        known: tuple[Changes, Gram],
        move: Move,
        at: tuple[tuple[Candidate, ...], Array],
        change: Changes,
    ) -> float | None:
        """The cost to which a move leads from one of its starts, to first order; None where it
        leads nowhere.

        It is that along the change that the move makes at this start, or begins to make where it
        makes none, and along what its base may change.
        """
        left = base.left.with_priors(np.zeros(change.priors.shape[1] - len(base.left.priors)))
        gram = known[1].and_(left, known[0], change)
        full = np.zeros(len(gram.along))
        full[-1] = 1.0
        cost = self._moved(left, gram, full)
        if not math.isfinite(cost):
            return None
        if not change.samples.any() and not change.priors.any():
            change = self._begun(*at, len(base.of.theta), move, left)
            gram = known[1].and_(left, known[0], change)
        normal, gradient = self._normal(left, gram)
        step = -np.asarray(np.linalg.lstsq(normal, gradient, rcond=1e-10)[0], dtype=float)
        return min(cost, self._moved(left, gram, step))

    def _begun(
        self, causes: tuple[Candidate, ...], x: Array, first: int, move: Move, left: RunResiduals
    ) -> Changes:
        """Of the residuals per unit of each scaled parameter of a move, whose parameters begin at
        ``first`` in ``x``.
        """
        low, high, _ = _bounds(move)
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        points = np.tile(x, (len(width), 1))
        points[:, first : first + len(width)] += np.diag(STEP * 0.01 * width)
        moved = self.lefts(causes, list(points))
        return Changes(
            np.array([m.samples - left.samples for m in moved]) / STEP,
            np.array([m.priors - left.priors for m in moved]) / STEP,
        )

    def _moved(self, left: RunResiduals, gram: Gram, step: Array) -> float:
        """The cost if the residuals change by ``step`` (P,) times the changes of ``gram``."""
        squares = np.einsum("i,j,ijr->r", step, step, gram.products) + 2.0 * step @ gram.along
        squares = np.maximum(left.squares() + squares / left.rows, 0.0)
        priors = left.priors @ left.priors + 2.0 * step @ gram.along_priors
        return self._cost(squares, float(priors + step @ gram.priors @ step))

    def _descend(self, causes, x, left, cost, slopes, bounds, iterations):
        """Levenberg-Marquardt; slopes are kept up by C. G. Broyden's update (Math. Comp. 19, 1965),
        and differenced again where a step with them fails.
        """
        low, high, log = bounds
        known = self.model.noise_known
        damping, fresh = LEAST_DAMPING if known else FIRST_DAMPING, False
        for _ in range(iterations):
            if not len(x) or not math.isfinite(cost):
                break
            scale = self.scale(x, low, high, log)
            if slopes is None:
                slopes, fresh = self.slopes(causes, x, left), True
            tries = 6 if fresh else 2
            found = self._step(causes, x, left, cost, slopes, (damping, tries), bounds)
            if found is None:
                if fresh:
                    break
                slopes = None
                continue
            moved, shown, new, damping = found
            gain = cost - new
            way = (moved - x) / scale
            way[log] = np.log(moved[log] / x[log])
            # in the scales of the next step
            ratio = np.where(log, 1.0, self.scale(moved, low, high, log) / scale)[:, None]
            share = (way / max(float(way @ way), 1e-300))[:, None]
            missed = shown.samples - left.samples - way @ slopes.samples
            missed_priors = shown.priors - left.priors - way @ slopes.priors
            slopes = Changes(
                (slopes.samples + share * missed) * ratio,
                (slopes.priors + share * missed_priors) * ratio,
            )
            x, left, cost = moved, shown, new
            if gain < min(CONVERGED * float(self.counts.sum()), LEAST_CHANGE):
                if fresh or (known and iterations < ITERATIONS):
                    break
                slopes = None
                continue
            fresh = False
        return x, left, cost

    def _step(self, causes, x, left, cost, slopes, damped, bounds):
        """The first of increasingly damped steps that lowers the cost; None where none does."""
        (damping, tries), (low, high, log) = damped, bounds
        scale = self.scale(x, low, high, log)
        normal, gradient = self.normal(left, slopes)
        for _ in range(tries):
            # not against a bound at which it stands
            free = ~(((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0)))
            if not free.any():
                return None
            step = np.zeros(len(x))
            inner = normal[np.ix_(free, free)]
            eased = inner + damping * np.diag(np.diag(inner) + 1e-12)
            step[free] = np.clip(-np.linalg.solve(eased, gradient[free]), -1.0, 1.0)
            moved = np.clip(np.where(log, x * np.exp(step), x + step * scale), low, high)
            shown = self._left(causes, moved)
            new = self.cost(shown)
            if new < cost:
                return moved, shown, new, max(damping / 10.0, LEAST_DAMPING)
            damping = max(damping, 1e-4) * 8.0
        return None

    def normal(self, left: RunResiduals, slopes: Changes) -> tuple[Array, Array]:
        """Normal matrix (P, P) and gradient (P,) of half the cost along ``slopes``."""
        weighed = slopes.samples * self.precision(left)
        return (
            weighed @ slopes.samples.T + slopes.priors @ slopes.priors.T,
            weighed @ left.samples + slopes.priors @ left.priors,
        )

    def _normal(self, left: RunResiduals, gram: Gram) -> tuple[Array, Array]:
        """The same by scalar products."""
        precision = self._precision(left)
        return gram.products @ precision + gram.priors, gram.along @ precision + gram.along_priors


def _at_end(causes: Sequence[Candidate], x: Array) -> bool:
    """Whether a number of a cause stands at an end of its range, other than at the 0 of one that is
    searched by difference, where it is none: that means nothing by itself, and what stands there
    stands in for something else.
    """
    for c, own in zip(causes, places(causes), strict=True):
        ends = np.array([x[own], c.low, c.high])
        ends[:, c.log] = np.log(ends[:, c.log])
        at, low, high = ends
        width = NEAR * (high - low)
        lowest = (at <= low + width) & (c.log | (c.low < 0.0))
        if np.any((at >= high - width) | lowest):
            return True
    return False


def _started(move: Move, start: Start) -> Array:
    """The parameters of a move at a start, within their bounds."""
    low, high, _ = _bounds(move)
    return np.clip(np.concatenate([np.array(s, dtype=float) for s in start]), low, high)


def _bounds(causes: Sequence[Candidate]) -> tuple[Array, Array, np.ndarray]:
    """Bounds of the parameters of ``causes``, and which are searched by ratio."""
    if not causes:
        return np.zeros(0), np.zeros(0), np.zeros(0, bool)
    return (
        np.concatenate([c.low for c in causes]),
        np.concatenate([c.high for c in causes]),
        np.concatenate([c.log for c in causes]).astype(bool),
    )
