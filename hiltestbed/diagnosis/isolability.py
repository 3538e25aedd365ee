"""Stage "decide": isolability: the smallest size of each effect that these data would detect, and
which effects would look the same.

The idea of structural fault isolation (E. Frisk, M. Krysander, fault isolability of over-determined
systems), with sensitivities from replays of the links in place of structure: two effects with
parallel residuals cannot be told apart at small size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.result import Isolable
from hiltestbed.diagnosis.settings import DETECTION
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.search import Progress
from hiltestbed.process.progress import UnitTime, time_left_text

# derived: chi-square for each parameter, by the Bayesian information criterion for some thousand
# independent samples
PENALTY = math.log(1000.0)
# chosen: of two residuals, above which effects are look-alikes: a tenth of the smaller one's energy
# is its own
LOOK_ALIKE_COSINE = 0.97
BISECTIONS = 12


def isolability(
    residual: Residual, candidates: Sequence[Candidate], progress: Progress | None = None
) -> tuple[Isolable, ...]:
    """One entry for each effect among the candidates, for the hypothesis (of an axis, a body) that
    shows most at its largest size.
    """
    found = detectable(residual, candidates, progress)
    seen = {s.kind: s.change for s in found if s.change is not None}
    directions = {kind: change / np.sqrt(square(change)) for kind, change in seen.items()}
    out = []
    for s in found:
        own, likeness = directions.get(s.kind), dict[str, float]()
        if own is not None:
            others = {k: d for k, d in directions.items() if k != s.kind}
            likeness = {k: abs(float(np.einsum("m,m->", own, d))) for k, d in others.items()}
        ranked = sorted(likeness, key=lambda k: -likeness[k])
        same = tuple(k for k in ranked if likeness[k] > LOOK_ALIKE_COSINE)
        most = max(likeness.values(), default=0.0)
        out.append(Isolable(s.kind, s.parameter, s.unit, s.size, same, most))
    return tuple(out)


@dataclass(frozen=True)
class Detectable:
    """The smallest size of an effect that data would show.

    Attributes:
        candidate: the hypothesis of the effect that shows most. theta: its parameters at that size.
        change: (M,) of the residual by it; None where the data do not show the effect.
    """

    candidate: Candidate
    theta: Array
    change: Array | None

    @property
    def effects(self) -> Effects:
        return [self.candidate.at(self.theta)]

    @property
    def size(self) -> float | None:
        """Of the leading parameter, a factor's departure from 1, where the data show the effect;
        the end of its search where they show every size that is searched.
        """
        if self.change is None:
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
    residual: Residual, candidates: Sequence[Candidate], progress: Progress | None = None
) -> list[Detectable]:
    """One for each effect among the candidates: of its hypotheses the one that changes the residual
    most at its largest size, at the smallest size that would be detected beyond its penalty.

    The bisections of all effects go on together: each step is one replay.
    """
    null = residual(())
    largest: dict[str, tuple[Candidate, Array]] = {}
    changes = _changes(residual, null, candidates, np.ones(len(candidates)))
    for c, change in zip(candidates, changes, strict=True):
        if c.kind not in largest or square(change) > square(largest[c.kind][1]):
            largest[c.kind] = (c, change)
    first = [c for c, _ in largest.values()]
    need = [DETECTION + PENALTY * max(1, len(c.names)) for c in first]
    best = [d if square(d) > n else None for (_, d), n in zip(largest.values(), need, strict=True)]
    low, high = np.zeros(len(first)), np.array([1.0 if c.names else 0.0 for c in first])
    open_ = [i for i, c in enumerate(first) if c.names and best[i] is not None]
    pace = UnitTime()
    for done in range(BISECTIONS):
        if progress:
            pace.update(done)
            left = time_left_text(pace.left(BISECTIONS - done), "in this step")
            progress(f"round {done + 1} of {BISECTIONS}{left}")
        middle = 0.5 * (low + high)
        changes = _changes(residual, null, [first[i] for i in open_], middle[open_])
        for i, d in zip(open_, changes, strict=True):
            if square(d) > need[i]:
                high[i], best[i] = middle[i], d
            else:
                low[i] = middle[i]
    each = zip(first, best, high, strict=True)
    return [Detectable(c, _at(c, float(most)), change) for c, change, most in each]


def _changes(
    residual: Residual, null: Array, candidates: Sequence[Candidate], sizes: Array
) -> list[Array]:
    """(M,) change of the residual by each candidate at its size, from 0 (next to nothing) to 1 (the
    largest that is searched).
    """
    effects = [[c.at(_at(c, float(size)))] for c, size in zip(candidates, sizes, strict=True)]
    return [r - null for r in residual.many(effects)] if effects else []


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
