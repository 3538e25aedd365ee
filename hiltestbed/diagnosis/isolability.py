"""What these data could show of each effect: the smallest size that raises the alarm, and which effects would look the same.

The idea of structural fault isolation (E. Frisk, M. Krysander, fault isolability of over-determined systems) with sensitivities from
replaying the links in place of structure: two effects whose residuals point the same way cannot be told apart at small size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.candidates import Candidate
from hiltestbed.diagnosis.fit import LEAST_PENALTY, Residual, effects_at, square
from hiltestbed.diagnosis.output.result import Isolable
from hiltestbed.diagnosis.search import ALARM
from hiltestbed.effects.vocabulary import EFFECTS
from hiltestbed.frames import Array

ALIKE = 0.97  # cosine of two residuals, from which they look the same
HALVINGS = 6
FEWER_IS_MORE = {
    "sensor.highpass", "sensor.saturation", "contact.hard_stop", "frame.compliance", "frame.mode", "platform.lag", "platform.mode",
    "platform.speed_limit",
}  # fmt: skip


def isolability(residual: Residual, candidates: Sequence[Candidate]) -> tuple[Isolable, ...]:
    """One entry for each effect among the candidates; the first form of each."""
    null = residual(())
    first = {c.effect: c for c in reversed(candidates)}
    found = {effect: _smallest(residual, null, c) for effect, c in reversed(first.items())}
    out = []
    for effect, (size, direction) in found.items():
        c = first[effect]
        name = c.names[0] if c.names else next(iter(c.fixed), "")
        likeness = {
            other: abs(float(np.einsum("m,m->", direction, d)))
            for other, (_, d) in found.items()
            if other != effect and direction is not None and d is not None
        }
        same = tuple(o for o, v in sorted(likeness.items(), key=lambda item: -item[1]) if v > ALIKE)
        unit = EFFECTS[effect].parameters[name.partition(".")[0]].unit if name else ""
        out.append(Isolable(effect, name, unit, size, same, max(likeness.values(), default=0.0)))
    return tuple(out)


def _smallest(residual: Residual, null: Array, c: Candidate) -> tuple[float | None, Array | None]:
    """The smallest size whose residual is worth ALARM beyond its penalty, and the residual's direction there."""
    need = ALARM + LEAST_PENALTY * max(1, len(c.names))

    def change(size: float) -> Array:
        theta = np.array(c.grid[len(c.grid) // 2], dtype=float)
        if len(theta):
            theta[:] = np.where(c.low <= 0, theta, np.maximum(theta, c.low))
            theta[0] = _value(c, size)
        return residual(effects_at((c,), np.clip(theta, c.low, c.high))) - null

    if not c.names:
        d = change(1.0)
        return (1.0, d / np.sqrt(square(d))) if square(d) > need else (None, None)
    low, high = 0.0, 1.0
    d = change(high)
    if square(d) < need:
        return None, None
    for _ in range(HALVINGS * 2):
        middle = 0.5 * (low + high)
        moved = change(middle)
        if square(moved) > need:
            high, d = middle, moved
        else:
            low = middle
    value = _value(c, high)
    size = abs(value - 1.0) if c.names[0] == "factor" else abs(value)
    return size, d / np.sqrt(square(d))


def _value(c: Candidate, size: float) -> float:
    """The leading parameter for a size from 0 (next to nothing) to 1 (the most that is searched)."""
    a, b = float(c.low[0]), float(c.high[0])
    if c.names[0] == "factor":
        return 1.0 + (min(b, 1.5) - 1.0) * 10.0 ** (-5.0 * (1.0 - size))
    if c.effect in FEWER_IS_MORE:
        return b * (a / b) ** size if a > 0 else b * (1.0 - size)
    most = max(abs(a), abs(b))
    return most * 10.0 ** (-7.0 * (1.0 - size))
