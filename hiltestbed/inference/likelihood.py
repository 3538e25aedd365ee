"""The likelihood of a hypothesis, its fit, and its evidence.

The residual of a run is taken for noise of a variance that is not known but not below the run's
floor, and of which ``counts`` samples are independent::

    log L = -1/2 sum over runs of counts log(mean square + floor^2) - 1/2 sum (nuisance/sigma)^2

Each run therefore counts by the *share* of its residual that a hypothesis removes: a run that
departs most does not decide alone. Where a model is wrong, its residuals are smooth and few of them
are independent; the number follows from their autocorrelation (C. J. Geyer, Stat. Sci. 7, 1992:
the initial positive sequence). The evidence of a hypothesis of P parameters is Laplace's
approximation with a prior that is worth one sample (G. Schwarz, Ann. Stat. 6, 1978)::

    log E = log L - P/2 log(sum of counts) - log(number of ways to choose the causes)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.model import Hypothesis, Model

STEP = 1e-4  # of a parameter's scale, for differences: about the root of a kernel's round-off
ITERATIONS = 40
# change of every mean square below which a descent has converged; and of -2 log L: a hundredth of
# what a parameter costs in the evidence
CONVERGED, LEAST_CHANGE = 1e-4, 0.05
Move = tuple[Candidate, ...]  # that join a hypothesis together

NEAR = 1e-3  # of a range, within which an estimate stands at its end
LEAST_COUNT = 4.0  # a run of which fewer samples are independent tells no variance


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its maximum of the posterior.

    Attributes:
        of: the hypothesis. cost: -2 log of the likelihood with the priors of the nuisances.
        evidence: log. left: as :meth:`Model.residuals` gives it.
    """

    of: Hypothesis
    cost: float
    evidence: float
    left: tuple[Array, ...]

    @property
    def causes(self) -> tuple[Candidate, ...]:
        return self.of.causes

    @property
    def keys(self) -> tuple[str, ...]:
        """Identifies the set of causes."""
        return tuple(sorted(str(c.key) for c in self.of.causes))

    def rms(self) -> Array:
        """(R,) of each run's residual."""
        return np.array([math.sqrt(float(np.mean(x * x))) for x in self.left[:-1]])


def independent(left: Sequence[Array]) -> Array:
    """(R,) number of independent samples in each residual: the geometric mean over the runs, since
    how many a run has says how lively it is, and not how much it tells.
    """
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
        self._squares = np.asarray(model.floors) ** 2
        self._sigma = model.prior_sigma()

    def counting(self, counts: Array) -> Likelihood:
        """The same with other ``counts``."""
        return Likelihood(self.model, counts, self.choices)

    def bounds(self, causes: Sequence[Candidate]) -> tuple[Array, Array, np.ndarray]:
        """Bounds of the parameters of ``causes`` and of the nuisances, and which are searched by
        ratio.
        """
        low, high, log = _bounds(causes)
        most = np.array([n.most for n in self.model.nuisances])
        return (
            np.concatenate([low, -most]),
            np.concatenate([high, most]),
            np.concatenate([log, np.zeros(len(most), bool)]),
        )

    def start(self) -> Fit:
        """Nothing departs, with the nuisances as the data have them."""
        return self.fit((), [np.zeros(0)])

    def cost(self, left: Sequence[Array]) -> float:
        """-2 log of the likelihood of residuals, with the priors."""
        squares = np.array([float(np.mean(x * x)) for x in left[:-1]])
        out = float(self.counts @ np.log(squares + self._squares) + left[-1] @ left[-1])
        return out if math.isfinite(out) else math.inf

    def evidence(self, cost: float, causes: Sequence[Candidate]) -> float:
        """Log of the evidence of a fit of ``causes``."""
        numbers = sum(max(1, len(c.names)) for c in causes)
        price = 0.5 * numbers * math.log(float(self.counts.sum()))
        ways = sum(math.log(self.choices * c.choices) for c in causes)
        return -0.5 * cost - price - ways

    def again(self, found: Fit) -> Fit:
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
    ) -> Fit:
        """The maximum that Levenberg's and Marquardt's descent reaches from the best of
        ``starts``.
        """
        causes = tuple(causes)
        eta = np.zeros(len(self._sigma)) if nuisances is None else nuisances
        low, high, log = self.bounds(causes)
        best, least, left = None, math.inf, None
        for theta in starts:
            x = np.clip(np.concatenate([theta, eta]), low, high)
            shown = self._left(causes, x)
            cost = self.cost(shown)
            if cost < least or best is None:
                best, least, left = x, cost, shown
        assert best is not None
        assert left is not None
        x, left, least = self._descend(causes, best, left, least, (low, high, log), iterations)
        count = len(x) - len(eta)
        evidence = -math.inf if _ended(x, low, high, log) else self.evidence(least, causes)
        return Fit(Hypothesis(causes, x[:count], x[count:]), least, evidence, tuple(left))

    def _left(self, causes: tuple[Candidate, ...], x: Array) -> list[Array]:
        count = len(x) - len(self._sigma)
        return self.model.residuals(Hypothesis(causes, x[:count], x[count:]))

    def weights(self, left: Sequence[Array]) -> Array:
        """(R + 1,) of the residuals of each run and of the priors, with which their sum of squares
        has the gradient of the cost.
        """
        squares = np.array([float(np.mean(r * r)) for r in left[:-1]]) + self._squares
        rows = np.array([len(r) for r in left[:-1]])
        return np.append(np.sqrt(self.counts / (rows * squares)), 1.0)

    def slopes(self, causes: tuple[Candidate, ...], x: Array, left: Sequence[Array]) -> list[Array]:
        """(N, P) change of each run's residual per unit of each scaled parameter and nuisance."""
        low, high, log = self.bounds(causes)
        scale = self.scale(x, low, high, log)
        out = [np.empty((len(r), len(x))) for r in left]
        for j in range(len(x)):
            step = STEP if x[j] + STEP * scale[j] <= high[j] else -STEP
            moved = x.copy()
            moved[j] += step * scale[j]
            for column, a, b in zip(out, self._left(causes, moved), left, strict=True):
                column[:, j] = (a - b) / step
        return out

    def scale_of(self, causes: Sequence[Candidate], x: Array) -> Array:
        """The scale of each parameter of ``causes`` and of each nuisance."""
        return self.scale(x, *self.bounds(causes))

    def scale(self, x: Array, low: Array, high: Array, log: np.ndarray) -> Array:
        """Of each number, in which it is differentiated and limited: its size, but not less than a
        hundredth of its range; of a nuisance its standard deviation.
        """
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        out = np.where(log, np.abs(x), np.maximum(np.abs(x), 0.01 * width))
        out[len(x) - len(self._sigma) :] = self._sigma
        return out

    def promises(self, base: Fit, moves: Sequence[Move]) -> list[tuple[float, Move, list[Array]]]:
        """Of each move beside ``base`` the evidence that it promises, the best first, and the
        starts to fit it from: to first order at each start, all numbers of ``base`` following.
        """
        x = np.concatenate([base.of.theta, base.of.nuisances])
        known = self.slopes(base.causes, x, base.left)
        out = []
        for move in moves:
            causes, found = (*base.causes, *move), []
            low, high, _ = _bounds(move)
            for start in itertools.product(*(c.grid for c in move)):
                theta = np.clip(
                    np.concatenate([np.array(s, dtype=float) for s in start]), low, high
                )
                full = np.concatenate([base.of.theta, theta, base.of.nuisances])
                shown = self._left(causes, full)
                cost = self.cost(shown)
                if not math.isfinite(cost):
                    continue
                # along the change that the move makes at this start, or begins to make where it
                # makes none, and along what its base may change
                changes = [[b - a] for a, b in zip(base.left, shown, strict=True)]
                if not any(change[0].any() for change in changes):
                    changes = self._begun(causes, full, len(base.of.theta), move, shown)
                rows = [np.column_stack([k, *d]) for k, d in zip(known, changes, strict=True)]
                normal, gradient = self.normal(base.left, rows)
                step = -np.asarray(np.linalg.lstsq(normal, gradient, rcond=1e-10)[0], dtype=float)
                expected = base.cost + self._expected(base.left, rows, step)
                found.append((min(cost, expected), theta))
            if found:
                found.sort(key=lambda item: item[0])
                starts = [np.concatenate([base.of.theta, theta]) for _, theta in found[:3]]
                out.append((self.evidence(found[0][0], causes), move, starts))
        return sorted(out, key=lambda item: -item[0])

    def _begun(
        self,
        causes: tuple[Candidate, ...],
        x: Array,
        first: int,
        move: Move,
        left: Sequence[Array],
    ) -> list[list[Array]]:
        """Of each run the changes of its residual per unit of each scaled parameter of a move,
        whose parameters begin at ``first`` in ``x``.
        """
        low, high, _ = _bounds(move)
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        out: list[list[Array]] = [[] for _ in left]
        for j in range(len(width)):
            moved = x.copy()
            moved[first + j] += STEP * 0.01 * width[j]
            for columns, a, b in zip(out, self._left(causes, moved), left, strict=True):
                columns.append((a - b) / STEP)
        return out

    def _expected(self, left: Sequence[Array], rows: Sequence[Array], step: Array) -> float:
        """Change of the cost if the residuals change by ``rows`` (N, P) times ``step`` (P,)."""
        moved = [r + s @ step for r, s in zip(left, rows, strict=True)]
        return self.cost(moved) - self.cost(left)

    def _descend(self, causes, x, left, cost, bounds, iterations):
        """Levenberg-Marquardt; slopes are kept up by C. G. Broyden's update (Math. Comp. 19, 1965),
        and differenced again where a step with them fails.
        """
        low, high, log = bounds
        damping, slopes, fresh = 1e-3, None, False
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
            slopes = [
                s + np.outer((b - a) - s @ way, way) / max(float(way @ way), 1e-300)
                for s, a, b in zip(slopes, left, shown, strict=True)
            ]
            ratio = np.where(log, 1.0, self.scale(moved, low, high, log) / scale)
            slopes = [s * ratio for s in slopes]
            x, left, cost = moved, shown, new
            if gain < min(CONVERGED * float(self.counts.sum()), LEAST_CHANGE):
                if fresh:
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
                return moved, shown, new, max(damping / 10.0, 1e-9)
            damping = max(damping, 1e-4) * 8.0
        return None

    def normal(self, left: Sequence[Array], slopes: Sequence[Array]) -> tuple[Array, Array]:
        """Normal matrix and gradient of half the cost along the columns of ``slopes``."""
        w = self.weights(left) ** 2
        normal = sum(a * np.einsum("mi,mj->ij", s, s) for a, s in zip(w, slopes, strict=True))
        gradient = sum(
            a * np.einsum("mi,m->i", s, r) for a, s, r in zip(w, slopes, left, strict=True)
        )
        return np.asarray(normal), np.asarray(gradient)


def _ended(x: Array, low: Array, high: Array, log: np.ndarray) -> bool:
    """Whether a number that is searched by ratio stands at an end of its range: that means nothing
    by itself, and what stands there stands in for something else.
    """
    if not log.any():
        return False
    at, a, b = np.log(x[log]), np.log(low[log]), np.log(high[log])
    return bool(np.any(np.minimum(at - a, b - at) < NEAR * (b - a)))


def _bounds(causes: Sequence[Candidate]) -> tuple[Array, Array, np.ndarray]:
    """Bounds of the parameters of ``causes``, and which are searched by ratio."""
    if not causes:
        return np.zeros(0), np.zeros(0), np.zeros(0, bool)
    return (
        np.concatenate([c.low for c in causes]),
        np.concatenate([c.high for c in causes]),
        np.concatenate([c.log for c in causes]).astype(bool),
    )
