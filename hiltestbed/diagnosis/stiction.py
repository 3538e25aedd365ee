"""Where to start the fit of a platform that sticks.

Each jump begins where the last one ended: some hundred jumps in a row end where they should only for a stick that is right to a
hundred-thousandth and for the right instants a tick, and chi-square is rugged around them. The first jumps tell a stick to a hundredth,
whatever the instants: so a scan of the beginning of the slowest run, which jumps least, that goes on to ever more of it with what fits best
so far, ever finer; then ever finer scans of all runs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links import LinkRun, PlatformLink
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.frames import Array
from hiltestbed.platform.effects.tracking import PlatformFriction

SCANNED = 400  # sticks, on the first jumps
FIRST = 20.0  # of the largest stick, that the command moves in them
FEWEST = 50  # rows of them
SURVIVE = 6  # sticks of each number of instants that go on to twice as many rows
AROUND = 3  # sticks that are tried to either side of each, half as far apart as before
WORSE = 2.0  # times the least chi-square so far: instants that fit worse are given up
FINER = 15  # by which the scans of all runs are refined at a time
KEPT = 4  # of each scan
# A tick: those that facilities take and those between, of which each is nearer to any other than a tenth; finer ones do not differ by what
# is known of a pose.
INSTANTS = (*range(2, 41), *range(44, 81, 4), *range(88, 201, 8))
LIKELY = 2  # of them, beside those of the believed physics, that are searched to the end
FINEST = 1e-5  # of a stick
CLEAR = 6.0  # times the noise: a departure that may be a stick
TOGETHER = 1.5  # mean square of the departures over that of the noise: a stick of s adds some (s/sigma)^2 / 3, noise is known to a fifth


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
    starts = {}
    for instants, near, step in _scanned(link, i, np.geomspace(low, high, SCANNED), sorted({substeps, *INSTANTS}), substeps):
        starts[instants] = finest_sticks(Residual(link), near, step, instants)
    return starts


def _scanned(link: PlatformLink, i: int, tried: Array, instants: Sequence[int], believed: int) -> list[tuple[int, list[float], float]]:
    """The likeliest instants a tick of run ``i``, after those ``believed``: the best sticks of each, and how far apart they lie."""
    run, command = link.runs[i], link.commands[i]
    travel = np.cumsum(np.max(np.abs(np.diff(command[:, :3], axis=0)), axis=1))
    rows = min(run.rows, max(FEWEST, int(np.searchsorted(travel, FIRST * tried[-1])) + 1))
    left, step = {m: list(tried) for m in instants}, float(tried[1] / tried[0]) - 1.0
    while True:
        part = LinkRun(run.scenario, run.measured[:rows], run.sigma[:rows], run.touching[:rows], run.heavy, run.tail)
        residual = Residual(PlatformLink([part], [command[:rows]], [link.deflection[i][:rows]]))
        costs = {m: np.array(_costs(residual, sticks, m)) for m, sticks in left.items()}
        order = sorted(costs, key=lambda m: float(costs[m].min()))
        best = {m: [left[m][j] for j in np.argsort(costs[m], kind="stable")[:SURVIVE]] for m in order}
        if rows == run.rows:
            return [(m, best[m], step) for m in dict.fromkeys((believed, *order[:LIKELY]))]
        rows, step = min(2 * rows, run.rows), step / 2.0
        most = WORSE * float(costs[order[0]].min())
        going = dict.fromkeys((believed, *order[:LIKELY], *(m for m in order if costs[m].min() < most)))
        left = {m: sorted({s * (1.0 + step * j) for s in best[m] for j in range(-AROUND, AROUND + 1)}) for m in going}


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


def _costs(residual: Residual, sticks: Sequence[float] | np.ndarray, instants: int) -> list[float]:
    out: list[float] = []
    for start in range(0, len(sticks), 64):
        effects = [[PlatformFriction.hypothesis({"instants": instants}, stick=float(s))] for s in sticks[start : start + 64]]
        out += [square(r) for r in residual.many(effects)]
    return out
