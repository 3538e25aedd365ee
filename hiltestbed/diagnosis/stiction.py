"""Where to start the fit of a platform that sticks.

Each jump begins where the last one ended: some hundred jumps in a row end where they should only for a stick that is right to a
hundred-thousandth, and chi-square is rugged around it. So a scan of the slowest run, which jumps least, then ever finer scans of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hiltestbed.diagnosis.links import PlatformLink
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.frames import Array
from hiltestbed.platform.effects.tracking import PlatformFriction

SCANNED = 500  # sticks, on the slowest run
LONGEST = 2000  # rows of it, above which fewer are scanned
FINER = 15  # by which the scans of all runs are refined at a time
KEPT = 4  # of each scan
INSTANTS = (2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 28, 40, 60, 100, 200)  # a tick: finer ones differ by less than a pose is known
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
    rows = link.runs[i].rows
    count = max(SCANNED // 5, min(SCANNED, SCANNED * LONGEST // rows))
    # The largest departure is the stick, give or take what the command moves in a tick.
    tried = np.geomspace(max(away - speeds[i] - 4.0 * noise, 0.5 * away), away + speeds[i] + noise, count)
    slowest, starts = Residual(link, [i]), {}
    scans = {instants: _costs(slowest, tried, instants) for instants in sorted({substeps, *INSTANTS})}
    likely = sorted(scans, key=lambda instants: min(scans[instants]))[:LIKELY]
    for instants in dict.fromkeys((substeps, *likely)):
        costs = scans[instants]
        near = [float(tried[j]) for j in np.argsort(costs)[:6]]
        starts[instants] = finest_sticks(Residual(link), near, float(tried[1] / tried[0]) - 1.0, instants)
    return starts


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
