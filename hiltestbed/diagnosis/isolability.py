"""Stage "decide": isolability: the smallest size of each effect that these data would detect, and
which effects would look the same.

The idea of structural fault isolation (E. Frisk, M. Krysander, fault isolability of over-determined
systems), with sensitivities from replays of the links in place of structure: two effects with
parallel residuals cannot be told apart at small size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.fit import effects_at
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.result import Isolable
from hiltestbed.diagnosis.search import Progress
from hiltestbed.diagnosis.settings import DETECTION, PENALTY
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array
from hiltestbed.process.progress import Pace, time_left_text

# chosen: of two residuals, above which effects are look-alikes: a tenth of the smaller one's energy
# is its own
LOOK_ALIKE_COSINE = 0.97
BISECTIONS = 12


def isolability(
    residual: Residual, candidates: Sequence[Candidate], progress: Progress | None = None
) -> tuple[Isolable, ...]:
    """One entry for each effect, for the hypothesis that shows most at its largest size."""
    first = _clearest(residual, candidates)
    found = {
        kind: (c, *smallest)
        for (kind, c), smallest in zip(
            first.items(), _smallest(residual, list(first.values()), progress), strict=True
        )
    }
    out = []
    for kind, (c, size, direction) in reversed(found.items()):
        name = c.names[0] if c.names else next(iter(c.fixed), "")
        likeness = {
            other: abs(float(np.einsum("m,m->", direction, d)))
            for other, (_, _, d) in found.items()
            if other != kind and direction is not None and d is not None
        }
        same = tuple(
            o
            for o, v in sorted(likeness.items(), key=lambda item: -item[1])
            if v > LOOK_ALIKE_COSINE
        )
        unit = c.effect.unit(name.partition(".")[0]) if name else ""
        out.append(Isolable(kind, name, unit, size, same, max(likeness.values(), default=0.0)))
    return tuple(out)


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
) -> list[tuple[float | None, Array | None]]:
    """The smallest size of each candidate that would be detected beyond its penalty, and the
    direction of the residual there.

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
    pace = Pace()
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
    out: list[tuple[float | None, Array | None]] = []
    for i, c in enumerate(candidates):
        d = best[i]
        if d is None:
            out.append((None, None))
            continue
        value = _value(c, high[i]) if c.names else 1.0
        size = abs(value - 1.0) if c.names and c.names[0] == "factor" else abs(value)
        out.append((size, d / np.sqrt(square(d))))
    return out


def _changes(
    residual: Residual, null: Array, candidates: Sequence[Candidate], sizes: Array
) -> list[Array]:
    """(M,) change of the residual by each candidate at its size, see :func:`_value`."""
    effects = []
    for c, size in zip(candidates, sizes, strict=True):
        theta = np.array(c.grid[len(c.grid) // 2], dtype=float)
        if len(theta):
            theta[:] = np.where(c.low <= 0, theta, np.maximum(theta, c.low))
            theta[0] = _value(c, float(size))
        effects.append(effects_at((c,), np.clip(theta, c.low, c.high)))
    return [r - null for r in residual.many(effects)] if effects else []


def _value(c: Candidate, size: float) -> float:
    """The leading parameter for a size from 0 (next to nothing) to 1 (the largest searched)."""
    a, b = float(c.low[0]), float(c.high[0])
    if c.names[0] == "factor":
        return 1.0 + (min(b, 1.5) - 1.0) * 10.0 ** (-5.0 * (1.0 - size))
    if c.effect.vanishes:
        return b * (a / b) ** size if a > 0 else b * (1.0 - size)
    most = max(abs(a), abs(b))
    return most * 10.0 ** (-7.0 * (1.0 - size))
