"""Stage "fit": bounded least squares of a hypothesis with few parameters: grid first, then
Levenberg-Marquardt from the best starts.

Takes a `Residual`, the causes as `Candidate` and their starts; gives a `Fit`. A trial is a replay
of all runs; the trials of a Jacobian, of a grid and of a scan share one replay. That is why the
descent is written here: :func:`scipy.optimize.least_squares` asks for one point at a time and takes
three times as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import PENALTY
from hiltestbed.effects.base import Effect
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

# derived: of a parameter's scale, for differences: about the root of a replay's round-off
DIFFERENCE_STEP = 1e-4
MAX_ITERATIONS = 25
CONVERGED_CHI2 = 1e-4  # chosen: change of chi-square below which a fit has converged
SCAN_POINTS = 21  # chosen: within a tenth of a parameter in which chi-square has jumps
MIN_SCAN_STEP = 1e-3  # chosen: of such a parameter, at which its search ends
DAMPINGS_AT_ONCE = 4  # chosen: of the descent, tried in one replay
BOUND_TOLERANCE = 1e-3  # chosen: of the range of a search
# chosen: times the remaining gain by geometric extrapolation; a descent that cannot reach `known`
# stops
EXTRAPOLATION_MARGIN = 10.0
# chosen: of the departure, in the runs on which a costly link is fitted, or its candidates are
# rated, first
FIRST_SHARE = 0.25
# chosen: chi-square per sample, above which a descent on a costly link stops where two steps have
# gained little
FAR_OFF = 10.0
ROUGH_GAIN = 1e-3  # chosen: of chi-square: what is little, 0.05 % of the rms that is left
# chosen: of a descent; then it also stops if the last two gains, repeated, would not reach `known`
MIN_STEPS = 4


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis fitted to a link.

    Attributes:
        causes: the candidates. theta: their parameters, concatenated. chi2: sum of squares in units
            of the noise.
        residual: (M,). jacobian: (M, P) of the residual by the scaled parameters.
        elsewhere: chi-square of what does not show on the link itself, such as the rebound, and
            what smoothing the noise of a recorded input took off.
    """

    causes: tuple[Candidate, ...]
    theta: Array
    chi2: float
    residual: Array
    jacobian: Array
    elsewhere: float = 0.0

    @property
    def penalty(self) -> float:
        """Penalty for the parameters and for the choice among variants, in chi-square."""
        return sum(
            len(c.names) * PENALTY + 2.0 * float(np.log(c.choices)) + (len(c.names) == 0)
            for c in self.causes
        )

    @property
    def score(self) -> float:
        """Chi-square and penalty: smaller is better."""
        return self.chi2 + self.penalty + self.elsewhere

    @property
    def kinds(self) -> tuple[str, ...]:
        """The ids of the causes."""
        return tuple(c.kind for c in self.causes)

    @property
    def keys(self) -> frozenset[tuple]:
        """The hypotheses, in whatever order."""
        return keys_of(self.causes)

    def effects(self) -> list[Effect]:
        """The causes with their parameters."""
        return effects_at(self.causes, self.theta)

    def part(self, index: int) -> Array:
        """Theta of one cause."""
        return self.theta[self.place(index)]

    def place(self, index: int) -> slice:
        """Where the parameters of one cause stand in theta."""
        start = sum(len(c.names) for c in self.causes[:index])
        return slice(start, start + len(self.causes[index].names))

    def of(self, causes: Sequence[Candidate]) -> Array:
        """Theta of the same ``causes`` in another order."""
        return self.theta[self._columns(causes)]

    def ordered(self, causes: Sequence[Candidate]) -> Fit:
        """The same fit with its ``causes`` in another order."""
        columns = self._columns(causes)
        return replace(
            self,
            causes=tuple(causes),
            theta=self.theta[columns],
            jacobian=self.jacobian[:, columns],
        )

    def _columns(self, causes: Sequence[Candidate]) -> list[int]:
        """Place in theta of each parameter of the same ``causes`` in another order."""
        start = {c.key: self.place(i).start for i, c in enumerate(self.causes)}
        return [start[c.key] + j for c in causes for j in range(len(c.names))]

    def without(self, index: int) -> tuple[tuple[Candidate, ...], Array]:
        """The other causes, and their theta."""
        own = self.place(index)
        theta = np.concatenate([self.theta[: own.start], self.theta[own.stop :]])
        return (*self.causes[:index], *self.causes[index + 1 :]), theta


def keys_of(causes: Sequence[Candidate]) -> frozenset[tuple]:
    """The keys of ``causes``, in whatever order."""
    return frozenset(c.key for c in causes)


def effects_at(causes: Sequence[Candidate], theta: Array) -> list[Effect]:
    """The effects of `causes` at theta."""
    out, at = [], 0
    for c in causes:
        out.append(c.at(theta[at : at + len(c.names)]))
        at += len(c.names)
    return out


def null_fit(residual: Residual) -> Fit:
    """The null hypothesis: nothing departs."""
    r = residual(())
    return Fit((), np.zeros(0), square(r), r, np.zeros((len(r), 0)))


class Bounds(NamedTuple):
    """(P,) lower and upper bounds of parameters, and whether their scale is logarithmic."""

    low: Array
    high: Array
    log: np.ndarray

    @classmethod
    def of(cls, causes: Sequence[Candidate]) -> Bounds:
        """Those of all parameters of ``causes``, concatenated."""
        return cls(
            np.concatenate([np.zeros(0), *(c.low for c in causes)]),
            np.concatenate([np.zeros(0), *(c.high for c in causes)]),
            np.concatenate([np.zeros(0, bool), *(c.log for c in causes)]),
        )

    def clip(self, theta: Sequence[float] | Array) -> Array:
        """Theta within the bounds."""
        return np.clip(np.asarray(theta, dtype=float), self.low, self.high)

    def scales(self, theta: Array) -> Array:
        """d theta / d scaled parameter: theta itself on a logarithmic scale, else the larger of
        theta and a hundredth of the range.
        """
        width = np.where(np.isfinite(self.high - self.low), self.high - self.low, 1.0)
        return np.where(self.log, np.abs(theta), np.maximum(np.abs(theta), 0.01 * width))


class Trials:
    """The replays of a residual under causes with any parameters, beside ``known`` effects."""

    def __init__(
        self, residual: Residual, causes: Sequence[Candidate], known: Effects = ()
    ) -> None:
        self.residual, self.causes, self.known = residual, tuple(causes), known
        self.bounds = Bounds.of(causes)

    def __call__(self, thetas: Sequence[Array] | Array) -> Array:
        """(H, M) residuals at each theta, in one replay."""
        return self.residual.many([[*self.known, *effects_at(self.causes, t)] for t in thetas])

    def slopes(self, theta: Array, r: Array, step: float = DIFFERENCE_STEP) -> Array:
        """(M, P) derivative of the residual, ``r`` at theta, by the scaled parameters; a step
        beyond the bounds is reversed.
        """
        if len(theta) == 0:
            return np.zeros((len(r), 0))
        scale, moved, widths = self.bounds.scales(theta), [], []
        for j in range(len(theta)):
            d = step * scale[j]
            d = -d if theta[j] + d > self.bounds.high[j] else d
            there = theta.copy()
            there[j] += d
            moved.append(there)
            widths.append(d / scale[j])
        return ((self(moved) - r) / np.array(widths)[:, None]).T


def at_bound(cause: Candidate, theta: Array) -> bool:
    """Whether a parameter stands at a bound of its search."""
    width = np.where(np.isfinite(cause.high - cause.low), cause.high - cause.low, np.inf)
    near = BOUND_TOLERANCE * np.where(cause.log, np.abs(theta), width)
    near = np.where(np.isfinite(near), near, 0.0)
    return bool(np.any((theta <= cause.low + near) | (theta >= cause.high - near)))


def fit(
    residual: Residual,
    causes: Sequence[Candidate],
    starts: Sequence[Sequence[float] | Array],
    tries: int = 2,
    known: float = np.inf,
) -> Fit:
    """The best of several descents from the best of `starts` (each for all causes, concatenated).

    known: chi-square that another hypothesis has reached; a descent that will not come near it is
        stopped.
    """
    causes, costly = tuple(causes), residual.link.costly
    trials = Trials(residual, causes)
    thetas = [trials.bounds.clip(s) for s in starts]
    if (
        tries > 1
        and len(trials.bounds.low)
        and costly
        and len(few := telling(residual, trials(thetas[:1])[0])) < len(residual.runs)
    ):
        first = fit(residual.on(few), causes, thetas, tries, known)
        if first.chi2 > known:  # as all the more on all runs
            r = trials([first.theta])[0]
            away = residual.smoothed_away(first.effects())
            return Fit(causes, first.theta, square(r), r, trials.slopes(first.theta, r), away)
        thetas, tries = [first.theta], 1
    found = trials(thetas)
    rated = sorted(((square(r), i) for i, r in enumerate(found)), key=lambda item: item[0])
    if not len(trials.bounds.low):
        chi2, i = rated[0]
        return Fit(causes, thetas[i], chi2, found[i], np.zeros((found.shape[1], 0)))
    descents: list[Fit] = []
    for _, i in rated[:tries]:
        reached = min([known, *(f.chi2 for f in descents)])
        descents.append(_descend(trials, thetas[i], found[i], reached, costly))
    best = _polish(trials, min(descents, key=lambda f: f.chi2))
    return replace(best, elsewhere=residual.smoothed_away(best.effects()))


def telling(residual: Residual, r: Array) -> list[int]:
    """The runs that depart most a row, with :data:`FIRST_SHARE` of the departure; r: (M,) of all
    runs under some hypothesis.
    """
    misfit = {i: square(r[part]) for i, part in residual.parts().items()}
    out: list[int] = []
    for i in sorted(misfit, key=lambda i: -misfit[i] / residual.link.runs[i].rows):
        if sum(misfit[j] for j in out) < FIRST_SHARE * sum(misfit.values()):
            out.append(i)
    return sorted(out)


def refit(residual: Residual, found: Fit, known: float = np.inf) -> Fit:
    """The same hypothesis fitted again from its last estimate; known: as of :func:`fit`."""
    if found.causes:
        return fit(residual, found.causes, [found.theta], tries=1, known=known)
    return null_fit(residual)


def refit_without(residual: Residual, found: Fit, index: int, known: float = np.inf) -> Fit:
    """The other causes of a hypothesis, fitted again; known: as of :func:`fit`."""
    causes, theta = found.without(index)
    return fit(residual, causes, [theta], tries=1, known=known) if causes else null_fit(residual)


def _descend(trials: Trials, theta: Array, r: Array, known: float, rough: bool) -> Fit:
    """rough: whether a descent also stops where it is far off and two steps have gained little."""
    chi2, damping, before = square(r), 1e-3, np.inf
    jacobian = np.zeros((len(r), len(theta)))
    far = FAR_OFF * np.count_nonzero(r)
    for step in range(MAX_ITERATIONS):
        jacobian = trials.slopes(theta, r)
        better = _step(trials, theta, r, jacobian, damping)
        if better is None:
            break
        theta, r, damping = better
        gain, chi2 = chi2 - square(r), square(r)
        if gain < max(_resolution(chi2, r), 1e-7 * chi2):
            break
        if rough and chi2 > far and max(gain, before) < ROUGH_GAIN * chi2:
            break
        if step >= MIN_STEPS and chi2 - max(gain, before) * (MAX_ITERATIONS - step) > known:
            break
        if (
            gain < before < np.inf
            and chi2 - EXTRAPOLATION_MARGIN * gain * gain / (before - gain) > known
        ):
            break
        before = gain
    return Fit(trials.causes, theta, chi2, r, jacobian)


def _step(
    trials: Trials, theta: Array, r: Array, jacobian: Array, damping: float
) -> tuple[Array, Array, float] | None:
    """The first of increasingly damped steps that lowers chi-square: theta, residual, and the next
    damping; None where none does.
    """
    chi2, scale = square(r), trials.bounds.scales(theta)
    gradient = np.einsum("mi,m->i", jacobian, r)
    normal = np.einsum("mi,mj->ij", jacobian, jacobian)
    for attempt in range(3):
        tried, dampings = [], []
        for _ in range(1 if attempt == 0 else DAMPINGS_AT_ONCE):
            step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            step = np.clip(step, -1.0, 1.0)
            there = np.where(trials.bounds.log, theta * np.exp(step), theta + step * scale)
            tried.append(trials.bounds.clip(there))
            dampings.append(damping)
            damping = max(damping, 1e-4) * 8.0
        for moved, left, used in zip(tried, trials(tried), dampings, strict=True):
            if square(left) < chi2:
                return moved, left, max(used / 10.0, 1e-9)
    return None


def _resolution(chi2: float, r: Array) -> float:
    """Change of chi-square below which a fit has converged; it scales with the misfit."""
    return CONVERGED_CHI2 * max(1.0, chi2 / len(r))


def _polish(trials: Trials, found: Fit) -> Fit:
    """Scan and pattern search on the parameters in which chi-square has jumps."""
    jumpy = [c.effect.jumps == name for c in found.causes for name in c.names]
    theta, chi2, r = found.theta, found.chi2, found.residual
    for j in np.flatnonzero(jumpy):
        step = 0.1
        # a valley between two jumps may be narrower than a step
        parts = list(np.linspace(-step, step, SCAN_POINTS))
        while step > MIN_SCAN_STEP:
            tried = np.tile(theta, (len(parts), 1))
            tried[:, j] = theta[j] * (1.0 + np.array(parts))
            tried = trials.bounds.clip(tried)
            results = trials(tried)
            costs = [square(row) for row in results]
            best = int(np.argmin(costs))
            if costs[best] < chi2 - _resolution(chi2, r):
                theta, r, chi2 = tried[best], results[best], costs[best]
            else:
                step *= 0.4
            parts = [step, -step]
    return replace(found, theta=theta, residual=r, chi2=chi2)


def inflation(found: Fit) -> float:
    """Chi-square per sample, at least 1, with which thresholds on its differences scale."""
    return max(1.0, square(found.residual) / max(1, np.count_nonzero(found.residual)))
