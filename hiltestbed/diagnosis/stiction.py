"""Stage "select": starts for the fit of a platform with stiction.

Each jump begins where the last one ended, so that some hundred jumps in a row end in the right place only for a stick that is right to
1e-5 and for the right number of instants a tick: chi-square is rugged. The first jumps determine the stick to a hundredth, whatever the
instants. So the beginning of the slowest run, which jumps least, is scanned first; what fits best is scanned again on more and more rows,
of the other runs too, ever finer; then in ever finer scans on all rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.links import PlatformLink
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.frames import Array
from hiltestbed.jit import njit
from hiltestbed.platform.effects.tracking import PlatformFriction

SCAN_POINTS = 400  # chosen: sticks, on the first jumps
SCAN_TRAVEL = 20.0  # chosen: of the largest stick: travel of the command in the first scan
MIN_SCAN_ROWS = 50  # chosen: rows of the first scan
MAX_SCAN_ROWS = 4000  # chosen: rows of the last scan
ROW_GROWTH = 1.5  # chosen: times as many rows in each next scan: the tolerance of a stick shrinks as the number of jumps grows
MAX_SAMPLE_CHI2 = 25.0  # chosen: chi-square of a sample, so that a jump in the wrong row counts no more however far it goes
SURVIVOR_MARGIN = 2.0 * MAX_SAMPLE_CHI2  # chosen: chi-square above the best, within which a stick is scanned again
STICKS_AT_ONCE = 64  # chosen: replayed together
MAX_STRETCHES = 8  # intervals of such sticks for each number of instants
STICKS_PER_SCAN = 160  # chosen: sticks in them
MAX_CHI2_RATIO = 2.0  # chosen: times the least chi-square so far: numbers of instants that fit worse are dropped
MAX_INSTANTS_KEPT = 24  # chosen: numbers of instants that are scanned again
REFINEMENT = 15  # chosen: of the step, from one scan of all runs to the next
STICKS_KEPT = 4  # of each scan
INSTANTS = (*range(2, 41), *range(44, 81, 4), *range(88, 201, 8))  # a tick; later also those half way between two that fit
MAX_INSTANTS_SEARCHED = 2  # numbers of instants, beside those of the believed physics, that are searched to the end
FIRST_STEP = 1e-4  # of a stick: the accuracy of the scans before
LAST_STEP = 1e-6  # of a stick
DEPARTURE_SIGMA = 6.0  # chosen: times the noise: a departure that may be a stick
MIN_MEAN_SQUARE = 1.5  # chosen: of the departures, over the noise's: a stick of s adds some (s/sigma)^2 / 3; the noise is known to a fifth


Stretches = list[tuple[float, float, float]]  # least chi-square, and the sticks [m] that bound the interval


def stick_starts(link: PlatformLink, noise: float, substeps: int) -> dict[int, list[float]]:
    """Instants a tick to starts for stiction [m]; empty where the platform departs too little; noise: of the pose [m]."""
    speeds = [float(np.max(np.abs(np.diff(c[:, :3], axis=0)))) for c in link.commands]
    i = int(np.argmin(speeds))
    sigma = link.runs[i].sigma[1:, :3]
    known = np.isfinite(sigma)
    departed = np.abs(link.runs[i].measured - link.shown(i))[1:, :3]
    away = float(np.max(departed[known], initial=0.0)) - noise
    alone = away > DEPARTURE_SIGMA * noise and bool((departed > DEPARTURE_SIGMA * sigma).any())  # above its doubt
    if not alone and _mean_square(departed[known] / sigma[known]) <= MIN_MEAN_SQUARE:
        return {}
    # The largest departure is the stick, within the travel of the command in a tick.
    low, high = max(away - speeds[i] - 4.0 * noise, 0.5 * away), away + speeds[i] + noise
    likely = _scanned(link, list(np.argsort(speeds)), np.geomspace(low, high, SCAN_POINTS), substeps)
    return {instants: refined_sticks(Residual(link), near, FIRST_STEP, instants) for instants, near in likely}


def _scanned(link: PlatformLink, order: Sequence[int], tried: Array, believed: int) -> list[tuple[int, list[float]]]:
    """The likeliest numbers of instants a tick with the best sticks of each, from the first rows of the runs in an ``order``."""
    travel = np.cumsum(np.max(np.abs(np.diff(link.commands[order[0]][:, :3], axis=0)), axis=1))
    rows, whole = (
        max(MIN_SCAN_ROWS, int(np.searchsorted(travel, SCAN_TRAVEL * tried[-1])) + 1),
        min(MAX_SCAN_ROWS, sum(r.rows for r in link.runs)),
    )
    rows = min(rows, whole)
    left = dict.fromkeys(sorted({believed, *INSTANTS}), tried)
    known: dict[int, Stretches] = {}  # on all rows
    while left:
        part = _beginning(link, order, rows)
        found = known | {m: _survivors(sticks, capped_chi2(part, sticks, m)) for m, sticks in left.items()}
        best = sorted(found, key=lambda m: found[m][0][0])
        if rows == whole:
            known, going = found, best[:MAX_INSTANTS_SEARCHED]
        else:
            going = [
                m
                for m in best[:MAX_INSTANTS_KEPT]
                if m in best[:MAX_INSTANTS_SEARCHED] or found[m][0][0] <= MAX_CHI2_RATIO * found[best[0]][0][0]
            ]
        near = {other: m for m in reversed(going) for other in _neighbours(m, sorted(found))}
        near |= {m: m for m in (believed, *going)} if rows < whole else {}
        rows = min(int(ROW_GROWTH * rows), whole)
        left = {m: _sticks_in(found[other]) for m, other in near.items()}
    likely = [
        m for m in dict.fromkeys((believed, *best[:MAX_INSTANTS_SEARCHED])) if known[m][0][0] <= MAX_CHI2_RATIO * known[best[0]][0][0]
    ]
    return [(m, list(_sticks_in(known[m]))) for m in likely]


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


def _survivors(sticks: Array, costs: Array) -> Stretches:
    """The intervals of ``sticks`` that fit about as well as the best, best first: least chi-square, and the sticks that bound it."""
    fits = costs <= costs.min() + SURVIVOR_MARGIN
    first = np.flatnonzero(fits & ~np.r_[False, fits[:-1]])
    last = np.flatnonzero(fits & ~np.r_[fits[1:], False])
    found = [
        (float(costs[a : b + 1].min()), float(sticks[max(a - 1, 0)]), float(sticks[min(b + 1, len(sticks) - 1)]))
        for a, b in zip(first, last, strict=True)
    ]
    return sorted(found)[:MAX_STRETCHES]


def _sticks_in(found: Stretches) -> Array:
    """Sticks to try in these intervals, more in the wider ones."""
    whole = sum(high - low for _, low, high in found)
    return np.unique([s for _, low, high in found for s in np.linspace(low, high, 5 + int(STICKS_PER_SCAN * (high - low) / whole))])


def _neighbours(m: int, known: Sequence[int]) -> set[int]:
    """Numbers of instants half way between one that fits and its neighbours."""
    j = known.index(m)
    return {(m + known[k]) // 2 for k in (j - 1, j + 1) if 0 <= k < len(known)} - set(known)


def _mean_square(values: Array) -> float:
    return square(values) / max(1, len(values))


def refined_sticks(residual: Residual, near: Sequence[float], step: float, instants: int) -> list[float]:
    """The best sticks [m] around the best of `near`, which lie a relative `step` apart; where they are better than no stick at all."""
    costs = _chi2_of(residual, near, instants)
    best = [near[j] for j in np.argsort(costs)[:STICKS_KEPT]]
    if min(costs) > square(residual(())):
        return best
    while step > LAST_STEP:
        step /= REFINEMENT
        tried = sorted({s * (1.0 + step * j) for s in best for j in range(-REFINEMENT, REFINEMENT + 1)})
        costs = _chi2_of(residual, tried, instants)
        best = [tried[j] for j in np.argsort(costs)[:STICKS_KEPT]]
    return best


def _chi2_of(residual: Residual, sticks: Sequence[float], instants: int) -> list[float]:
    """Chi-square of each of ``sticks``."""
    out: list[float] = []
    for start in range(0, len(sticks), STICKS_AT_ONCE):
        effects = [[PlatformFriction.hypothesis({"instants": instants}, stick=float(s))] for s in sticks[start : start + STICKS_AT_ONCE]]
        out += [square(r) for r in residual.many(effects)]
    return out


def capped_chi2(link: PlatformLink, sticks: Array, instants: int) -> Array:
    """Chi-square of each of ``sticks`` on a link without a timing of its own; no sample counts for more than :data:`MAX_SAMPLE_CHI2`.

    Thousands of replays are compared. A :class:`Residual` of each would take several times as long as its replay: each is summed at once,
    and the attitude, the same for every stick, is summed once.
    """
    turned = [z[:, 3:] for z in Residual(link).by_run([()])[0]]
    out = np.full(len(sticks), sum(float(np.minimum(z * z, MAX_SAMPLE_CHI2).sum()) for z in turned))
    for start in range(0, len(sticks), STICKS_AT_ONCE):
        some = sticks[start : start + STICKS_AT_ONCE]
        effects = [PlatformFriction.hypothesis({"instants": instants}, stick=float(s)) for s in some]
        places = link.places([(i, [effect]) for effect in effects for i in range(len(link.runs))])
        for i, run in enumerate(link.runs):
            goal, sigma = run.measured[:, :3] - link.deflection[i][:, :3], run.sigma[:, :3]
            _add_capped(places[i :: len(link.runs)], goal, sigma, MAX_SAMPLE_CHI2, out[start : start + len(some)])
    return out


@njit(cache=True)
def _add_capped(places, goal, sigma, most, out):
    """Add to ``out`` (H,) the squares of ``goal`` (N, 3) less ``places`` (H, >= N, 3) over ``sigma`` (N, 3), at most ``most`` each."""
    for h in range(len(out)):
        total = 0.0
        for k in range(len(goal)):
            for j in range(3):
                square = ((goal[k, j] - places[h, k, j]) / sigma[k, j]) ** 2
                total += square if square < most else most
        out[h] += total
