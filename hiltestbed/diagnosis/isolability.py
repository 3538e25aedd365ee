"""Stage "decide": isolability: the smallest size of each effect that these data would detect, and
which effects would look the same.

The idea of structural fault isolation (E. Frisk, M. Krysander, fault isolability of over-determined
systems), with sensitivities from replays of the links in place of structure: two effects with
parallel residuals cannot be told apart at small size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.result import Isolable
from hiltestbed.diagnosis.settings import DETECTION, PENALTY
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.inference.search import Progress
from hiltestbed.process.progress import UnitTime, time_left_text

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
    directions = {
        s.kind: s.change / np.sqrt(square(s.change)) for s in found if s.change is not None
    }
    out = []
    for s in found:
        likeness = {
            other: abs(float(np.einsum("m,m->", directions[s.kind], d)))
            for other, d in directions.items()
            if other != s.kind and s.kind in directions
        }
        same = tuple(
            o
            for o, v in sorted(likeness.items(), key=lambda item: -item[1])
            if v > LOOK_ALIKE_COSINE
        )
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
        """The effect at that size."""
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
    """One for each effect among the candidates."""
    first = list(_clearest(residual, candidates).values())
    return _smallest(residual, first, progress)[::-1]


def _clearest(residual: Residual, candidates: Sequence[Candidate]) -> dict[str, Candidate]:
    """Of each effect, in reverse order, the hypothesis that changes the residual most."""
    changes = _changes(
        residual, residual(()), candidates, np.array([1.0 if c.names else 0.0 for c in candidates])
    )
    found: dict[str, tuple[float, Candidate]] = {}
    for c, change in zip(reversed(candidates), reversed(changes), strict=True):
        size = square(change)
        if c.kind not in found or size >= found[c.kind][0]:
            found[c.kind] = (size, c)
    return {kind: c for kind, (_, c) in found.items()}


def _smallest(
    residual: Residual, candidates: Sequence[Candidate], progress: Progress | None
) -> list[Detectable]:
    """The smallest size of each candidate that would be detected beyond its penalty.

    The bisections of all candidates go on together: each step is one replay.
    """
    null = residual(())
    need = [DETECTION + PENALTY * max(1, len(c.names)) for c in candidates]
    low, high = np.zeros(len(candidates)), np.ones(len(candidates))
    best: list[Array | None] = [None] * len(candidates)
    for d, i, c in zip(
        _changes(residual, null, candidates, high), range(len(candidates)), candidates, strict=True
    ):
        best[i] = d if square(d) > need[i] else None
        high[i] = 1.0 if c.names else 0.0
    open_ = [i for i, c in enumerate(candidates) if c.names and best[i] is not None]
    pace = UnitTime()
    for done in range(BISECTIONS):
        if progress:
            pace.update(done)
            progress(
                f"round {done + 1} of "
                f"{BISECTIONS}{time_left_text(pace.left(BISECTIONS - done), 'in this step')}"
            )
        middle = 0.5 * (low + high)
        for j, d in zip(
            open_,
            _changes(residual, null, [candidates[j] for j in open_], middle[open_]),
            strict=True,
        ):
            if square(d) > need[j]:
                high[j], best[j] = middle[j], d
            else:
                low[j] = middle[j]
    return [
        Detectable(c, _at(c, float(most)), change)
        for c, change, most in zip(candidates, best, high, strict=True)
    ]


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
