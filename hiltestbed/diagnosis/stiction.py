"""Where to start the fit of a platform that sticks.

Each jump begins where the last one ended: some hundred jumps in a row end where they should only for a stick that is right to a
hundred-thousandth and for the right instants a tick, and chi-square is rugged around them. The first jumps tell a stick to a hundredth,
whatever the instants: so a scan of the beginning of the slowest run, which jumps least, that goes on to ever more rows, of the other runs
after it, with what fits best so far, ever finer; then ever finer scans of all there is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.links import PlatformLink
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.frames import Array
from hiltestbed.platform.effects.tracking import PlatformFriction

SCANNED = 400  # sticks, on the first jumps
FIRST = 20.0  # of the largest stick, that the command moves in them
FEWEST = 50  # rows of them
ROWS = 4000  # that are scanned in all
FURTHER = 1.5  # times as many rows, each time: what a stick may be off by shrinks as the jumps grow in number
MISPLACED = 25.0  # of chi-square, that a jump in the wrong row counts for, however far it goes
ALIKE = 2.0 * MISPLACED  # of chi-square, by which a stick may fit worse than the best one, and go on
SURVIVE = 8  # stretches of such sticks, of each number of instants
TRIED = 160  # sticks in them
WORSE = 2.0  # times the least chi-square so far: instants that fit worse are given up
MOST = 24  # numbers of instants that go on
FINER = 15  # by which the scans of all runs are refined at a time
KEPT = 4  # of each scan
INSTANTS = (*range(2, 41), *range(44, 81, 4), *range(88, 201, 8))  # a tick; later those between the ones that fit and the next, too
LIKELY = 2  # of them, beside those of the believed physics, that may be searched to the end
STEP = 1e-4  # of a stick, to which they tell it
FINEST = 1e-6  # of a stick
CLEAR = 6.0  # times the noise: a departure that may be a stick
TOGETHER = 1.5  # mean square of the departures over that of the noise: a stick of s adds some (s/sigma)^2 / 3, noise is known to a fifth


Stretches = list[tuple[float, float, float]]  # best chi-square, and the sticks [m] between which it lies


def stick_starts(link: PlatformLink, noise: float, substeps: int) -> dict[int, list[float]]:
    """Instants a tick to starts for stiction [m], none where the platform departs too little; noise: of the pose [m]."""
    speeds = [float(np.max(np.abs(np.diff(c[:, :3], axis=0)))) for c in link.commands]
    i = int(np.argmin(speeds))
    sigma = link.runs[i].sigma[1:, :3]
    known = np.isfinite(sigma)
    departed = np.abs(link.runs[i].measured - link.shown(i))[1:, :3]
    away = float(np.max(departed[known], initial=0.0)) - noise
    alone = away > CLEAR * noise and bool((departed > CLEAR * sigma).any())  # beyond what is not known of how the drives give way
    if not alone and _mean_square(departed[known] / sigma[known]) <= TOGETHER:
        return {}
    # The largest departure is the stick, give or take what the command moves in a tick.
    low, high = max(away - speeds[i] - 4.0 * noise, 0.5 * away), away + speeds[i] + noise
    likely = _scanned(link, list(np.argsort(speeds)), np.geomspace(low, high, SCANNED), substeps)
    return {instants: finest_sticks(Residual(link), near, STEP, instants) for instants, near in likely}


def _scanned(link: PlatformLink, order: Sequence[int], tried: Array, believed: int) -> list[tuple[int, list[float]]]:
    """The likeliest instants a tick with the best sticks of each, from the first rows of the runs in an ``order``."""
    travel = np.cumsum(np.max(np.abs(np.diff(link.commands[order[0]][:, :3], axis=0)), axis=1))
    rows, whole = max(FEWEST, int(np.searchsorted(travel, FIRST * tried[-1])) + 1), min(ROWS, sum(r.rows for r in link.runs))
    rows = min(rows, whole)
    left = dict.fromkeys(sorted({believed, *INSTANTS}), tried)
    known: dict[int, Stretches] = {}  # on all rows
    while left:
        residual = Residual(_beginning(link, order, rows))
        found = known | {m: _alike(sticks, np.array(_costs(residual, sticks, m, MISPLACED))) for m, sticks in left.items()}
        best = sorted(found, key=lambda m: found[m][0][0])
        if rows == whole:
            known, going = found, best[:LIKELY]
        else:
            going = [m for m in best[:MOST] if m in best[:LIKELY] or found[m][0][0] <= WORSE * found[best[0]][0][0]]
        near = {other: m for m in reversed(going) for other in _between(m, sorted(found))}
        near |= {m: m for m in (believed, *going)} if rows < whole else {}
        rows = min(int(FURTHER * rows), whole)
        left = {m: _within(found[other]) for m, other in near.items()}
    likely = [m for m in dict.fromkeys((believed, *best[:LIKELY])) if known[m][0][0] <= WORSE * known[best[0]][0][0]]
    return [(m, list(_within(known[m]))) for m in likely]


def _beginning(link: PlatformLink, order: Sequence[int], rows: int) -> PlatformLink:
    """The first ``rows`` of a link's runs in an ``order``."""
    runs, commands, deflection = [], [], []
    for i in order:
        run, part = link.runs[i], slice(min(rows, link.runs[i].rows))
        if part.stop == 0:
            break
        runs.append(replace(run, measured=run.measured[part], sigma=run.sigma[part], touching=run.touching[part]))
        commands.append(link.commands[i][part])
        deflection.append(link.deflection[i][part])
        rows -= part.stop
    return PlatformLink(runs, commands, deflection)


def _alike(sticks: Array, costs: Array) -> Stretches:
    """Chi-square of the best stretches of ``sticks``, in order, that fit about as well as the best, each with the sticks that bound it."""
    fits = costs <= costs.min() + ALIKE
    first = np.flatnonzero(fits & ~np.r_[False, fits[:-1]])
    last = np.flatnonzero(fits & ~np.r_[fits[1:], False])
    found = [
        (float(costs[a : b + 1].min()), float(sticks[max(a - 1, 0)]), float(sticks[min(b + 1, len(sticks) - 1)]))
        for a, b in zip(first, last, strict=True)
    ]
    return sorted(found)[:SURVIVE]


def _within(found: Stretches) -> Array:
    """Sticks to try in such stretches, more in the wider ones."""
    whole = sum(high - low for _, low, high in found)
    return np.unique([s for _, low, high in found for s in np.linspace(low, high, 5 + int(TRIED * (high - low) / whole))])


def _between(m: int, known: Sequence[int]) -> set[int]:
    """Numbers of instants half way from one that fits to those next to it."""
    j = known.index(m)
    return {(m + known[k]) // 2 for k in (j - 1, j + 1) if 0 <= k < len(known)} - set(known)


def _mean_square(values: Array) -> float:
    return square(values) / max(1, len(values))


def finest_sticks(residual: Residual, near: Sequence[float], step: float, instants: int) -> list[float]:
    """The best sticks [m] about the best of `near`, which lie apart by `step`, a part of them; where they better no stick at all."""
    costs = _costs(residual, near, instants)
    best = [near[j] for j in np.argsort(costs)[:KEPT]]
    if min(costs) > square(residual(())):
        return best
    while step > FINEST:
        step /= FINER
        tried = sorted({s * (1.0 + step * j) for s in best for j in range(-FINER, FINER + 1)})
        costs = _costs(residual, tried, instants)
        best = [tried[j] for j in np.argsort(costs)[:KEPT]]
    return best


def _costs(residual: Residual, sticks: Sequence[float] | np.ndarray, instants: int, most: float = math.inf) -> list[float]:
    """Chi-square of each of ``sticks``; no sample counts for more than ``most``."""
    out: list[float] = []
    for start in range(0, len(sticks), 64):
        effects = [[PlatformFriction.hypothesis({"instants": instants}, stick=float(s))] for s in sticks[start : start + 64]]
        out += [square(r) if math.isinf(most) else float(np.minimum(r * r, most).sum()) for r in residual.many(effects)]
    return out
