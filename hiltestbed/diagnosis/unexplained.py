"""Stage "decide": what can be said of a departure that no effect explains: what its residual
correlates with, where in position it sits, and whether the runs contradict each other.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.diagnosis.explain import Explanation, effects_of
from hiltestbed.diagnosis.link_model import NOTHING
from hiltestbed.diagnosis.links import PlatformLink, WrenchLink
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.plain import listed
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.frames import Array
from hiltestbed.inference.likelihood import PosteriorFit
from hiltestbed.inference.residuals import range_of_half
from hiltestbed.inference.search import extended

SHAPE_ROWS = 9  # chosen: of the running mean before the correlation
MIN_CORRELATION = 0.6  # chosen: from which a quantity is named


def describe(explanation: Explanation, name: str) -> str:
    residual, effects = explanation.residual(), explanation.effects()
    link, leftovers = residual.link, explanation.leftovers()
    channel = max(leftovers, key=lambda c: leftovers[c].excess)
    column = link.channels.index(channel)
    phases, shape = _phases(residual, effects, column), _shape(residual, effects, column)
    worst = max(phases, key=lambda p: phases[p])
    figures = ", ".join(f"{phase} {value:.2g}" for phase, value in phases.items())
    along = shape or "none of penetration, rate, their product, force or time"
    words = " and ".join(explanation.kinds)
    taken = f"with {words} removed, " if words else ""
    return (
        f"{name}: {taken}the largest residual is on {channel}, {worst} (times the noise: "
        f"{figures}); it correlates with {along}{_where(residual, effects, column)}"
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
    names = ("before the touch", "while loading", "while unloading", "after the contact")
    parts: dict[str, list[Array]] = {name: [] for name in names}
    for i in residual.runs:
        z, run = residual.of_run(i, effects)[:, column], residual.link.runs[i]
        inside, touched = np.flatnonzero(run.touching), np.logical_or.accumulate(run.touching)
        split = [z[~touched], z[:0], z[:0], z[touched & ~run.touching]]
        if len(inside):
            force = np.abs(run.measured[:, min(2, run.measured.shape[1] - 1)])
            top = inside[int(np.argmax(force[inside]))]
            split[1:3] = z[inside[inside <= top]], z[inside[inside > top]]
        for name, own in zip(names, split, strict=True):
            parts[name].append(own)
    joined = {phase: np.concatenate(z) for phase, z in parts.items()}
    return {phase: float(np.sqrt(np.mean(z * z))) for phase, z in joined.items() if len(z)}


def _shape(residual: Residual, effects: Effects, column: int) -> str:
    link = residual.link
    paths = link.paths if isinstance(link, WrenchLink) else None
    paths = link.commands if isinstance(link, PlatformLink) else paths
    left, columns, quantities = [], [], {}
    for i in residual.runs:
        run, window = link.runs[i], np.ones(SHAPE_ROWS) / SHAPE_ROWS
        z = np.convolve(residual.of_run(i, effects)[:, column], window, "same")
        depth = paths[i][:, 2] if paths is not None else np.zeros(len(z))
        rate = np.gradient(depth, run.scenario.tick)
        inside = run.touching if run.touching.any() else np.ones(len(z), dtype=bool)
        t = np.arange(len(z)) * run.scenario.tick
        quantities = {
            "the penetration": depth,
            "its rate": rate,
            "penetration times rate": depth * rate,
            "penetration, with the sign of the rate": np.abs(depth) * np.sign(rate),
            "the sign of the rate": np.sign(rate),
            "the cube of the penetration": depth**3,
            "the force": link.shown(i, effects)[:, min(2, len(link.channels) - 1)],
            "the time in contact": t - t[inside][0],
        }
        left.append(z[inside])
        columns.append(np.column_stack(list(quantities.values()))[inside])
    y, x, names = np.concatenate(left), np.concatenate(columns), list(quantities)
    if len(y) < 20 or np.std(y) == 0:
        return ""
    match = [abs(float(np.corrcoef(y, c)[0, 1])) if np.std(c) > 0 else 0.0 for c in x.T]
    best = int(np.argmax(match))
    return f"{names[best]} (correlation {match[best]:.2f})" if match[best] > MIN_CORRELATION else ""


def contradiction(found: Explanation) -> str:
    """One effect that leaves only noise in each run alone, with sizes that differ, in words; empty
    where no single effect does, or where there is one run.

    Sizes differ where the evidence of fits to each run exceeds that of one fit to all.
    """
    count = len(found.model.members)
    if count < 2:
        return ""
    for known in _single_causes(found):
        alone = [found.alone(n, known) for n in range(count)]
        if not all(model.leaves_noise(f.left) for model, f in alone):
            continue
        each = [f for _, f in alone]
        joint = found.likelihood.fit(known.causes, [known.of.theta])
        if sum(f.evidence for f in each) > joint.evidence:
            sizes = ", ".join(
                f"{listed(effects_of(f)[0].parameters())} in run {i}"
                for i, f in zip(found.model.members, each, strict=True)
            )
            return (
                f"the runs contradict each other: {effects_of(known)[0].kind} explains each of "
                f"them alone, with a size that changes from run to run, or with what differs "
                f"between them ({sizes})"
            )
    return ""


def _single_causes(found: Explanation) -> list[PosteriorFit]:
    """Fits of one cause: those to all runs, and those to the run that departs most of causes that
    explain nothing of all together, as sizes on both sides of the nominal one do.
    """
    models = [found.model.on([n]) for n in range(len(found.model.members))]
    worst = max(models, key=lambda model: model.excess(model.residuals(NOTHING)))
    here = worst.likelihood()
    out = {effects_of(f)[0].kind: f for f in found.singles()}
    for fit in extended(here, here.start(), found.candidates):
        if len(effects := effects_of(fit)) == 1:
            out.setdefault(effects[0].kind, fit)
    return list(out.values())
