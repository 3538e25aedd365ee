"""Stage "decide": a sentence on the residual of an explanation: on which channel, in which phase,
and with which quantity it correlates.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.diagnosis.contradiction import contradiction, range_of_half
from hiltestbed.diagnosis.links import PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.frames import Array

SMOOTHING_ROWS = 9  # chosen: of the running mean before the correlation
MIN_CORRELATION = 0.6  # chosen: from which a quantity is named


def describe(explanation: Explanation, name: str) -> str:
    """A sentence on the residual of the chosen explanation."""
    residual, effects = explanation.residual, explanation.chosen.effects()
    link = residual.link
    channel = max(explanation.leftovers, key=lambda c: explanation.leftovers[c].excess)
    column = link.channels.index(channel)
    phases, shape = _phases(residual, effects, column), _shape(residual, effects, column)
    worst = max(phases, key=lambda p: phases[p])
    figures = ", ".join(f"{phase} {value:.2g}" for phase, value in phases.items())
    along = (
        f"; it correlates with {shape}"
        if shape
        else "; it correlates with none of penetration, rate, their product, force or time"
    )
    contrary = contradiction(explanation)
    contradicted = f"; {contrary}" if contrary else ""
    words = " and ".join(explanation.chosen.kinds)
    taken = f"with {words} removed, " if words else ""
    return (
        f"{name}: {taken}the largest residual is on {channel}, {worst} (times the noise: "
        f"{figures}){along}{_where(residual, effects, column)}"
        f"{contradicted}"
    )


def _where(residual: Residual, effects: Effects, column: int) -> str:
    """Where along the insertion half of the residual in contact sits, in words; empty on links
    without a path.
    """
    link = residual.link
    if not isinstance(link, WrenchLink):
        return ""
    parts = [
        (link.paths[i][inside, 2], residual.of_run(i, effects)[inside, column])
        for i in residual.runs
        if (inside := link.runs[i].touching).any()
    ]
    if not parts:
        return ""
    position, left = (np.concatenate(p) for p in zip(*parts, strict=True))
    low, high = (1e3 * x for x in range_of_half(position, left))
    first, last = 1e3 * position.min(), 1e3 * position.max()
    return (
        f"; half of it sits between {low:.3g} and {high:.3g} mm of pz, of {first:.3g} to "
        f"{last:.3g} mm in contact"
    )


def _phases(residual: Residual, effects: Effects, column: int) -> dict[str, float]:
    parts: dict[str, list[Array]] = {
        "before the touch": [],
        "while loading": [],
        "while unloading": [],
        "after the contact": [],
    }
    for i in residual.runs:
        z, run = residual.of_run(i, effects)[:, column], residual.link.runs[i]
        touched = np.logical_or.accumulate(run.touching)
        parts["before the touch"].append(z[~touched])
        parts["after the contact"].append(z[touched & ~run.touching])
        inside = np.flatnonzero(run.touching)
        if len(inside):
            force = np.abs(run.measured[:, min(2, run.measured.shape[1] - 1)])
            top = inside[int(np.argmax(force[inside]))]
            parts["while loading"].append(z[inside[inside <= top]])
            parts["while unloading"].append(z[inside[inside > top]])
    joined = {phase: np.concatenate(z) for phase, z in parts.items() if z}
    return {phase: float(np.sqrt(np.mean(z * z))) for phase, z in joined.items() if len(z)}


def _shape(residual: Residual, effects: Effects, column: int) -> str:
    link = residual.link
    paths = (
        link.paths
        if isinstance(link, WrenchLink)
        else link.commands
        if isinstance(link, PlatformLink)
        else None
    )
    left, columns = [], []
    for i in residual.runs:
        run = link.runs[i]
        z = np.convolve(
            residual.of_run(i, effects)[:, column], np.ones(SMOOTHING_ROWS) / SMOOTHING_ROWS, "same"
        )
        depth = paths[i][:, 2] if paths is not None else np.zeros(len(z))
        rate = np.gradient(depth, run.scenario.tick)
        force = link.shown(i, effects)[:, min(2, len(link.channels) - 1)]
        t = np.arange(len(z)) * run.scenario.tick
        inside = run.touching if run.touching.any() else np.ones(len(z), dtype=bool)
        start = t[inside][0]
        left.append(z[inside])
        columns.append(
            np.column_stack(
                [
                    depth,
                    rate,
                    depth * rate,
                    np.abs(depth) * np.sign(rate),
                    np.sign(rate),
                    depth**3,
                    force,
                    t - start,
                ]
            )[inside]
        )
    y, x = np.concatenate(left), np.concatenate(columns)
    names = (
        "the penetration",
        "its rate",
        "penetration times rate",
        "penetration, with the sign of the rate",
        "the sign of the rate",
        "the cube of the penetration",
        "the force",
        "the time in contact",
    )
    if len(y) < 20 or np.std(y) == 0:
        return ""
    known = np.std(x, axis=0) > 0
    match = [
        abs(float(np.corrcoef(y, x[:, j])[0, 1])) if known[j] else 0.0 for j in range(len(names))
    ]
    best = int(np.argmax(match))
    return f"{names[best]} (correlation {match[best]:.2f})" if match[best] > MIN_CORRELATION else ""
