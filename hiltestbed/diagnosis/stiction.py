"""Where to start the fit of a platform that sticks.

Each jump begins where the last one ended: some hundred jumps in a row end where they should only for a stick that is right to a
hundred-thousandth, and chi-square is rugged around it. So a scan of the slowest run, which jumps least, then ever finer scans of all.
"""

from __future__ import annotations

import numpy as np

from hiltestbed.diagnosis.candidates import FINE
from hiltestbed.diagnosis.fit import Residual, square
from hiltestbed.diagnosis.links import FORM, PlatformLink

SCANNED = 500  # sticks, on the slowest run
LONGEST = 2000  # rows of it, above which fewer are scanned
FINER = 15  # by which the scans of all runs are refined at a time
KEPT = 4  # of each scan
FINEST = 1e-5  # of a stick
CLEAR = 6.0  # times the noise: a departure that may be a stick


def stick_starts(link: PlatformLink, noise: float, substeps: int) -> dict[int, list[float]]:
    """Instants a tick to starts for stiction [m], none where the platform departs too little; noise: of the pose [m]."""
    speeds = [float(np.max(np.abs(np.diff(c[:, :3], axis=0)))) for c in link.commands]
    i = int(np.argmin(speeds))
    away = float(np.nanmax(np.abs(link.runs[i].measured - link.predict(i, ()))[1:])) - noise
    if away <= CLEAR * noise:
        return {}
    rows = len(link.runs[i].measured)
    count = max(SCANNED // 5, min(SCANNED, SCANNED * LONGEST // rows))
    # The largest departure is the stick, give or take what the command moves in a tick.
    tried = np.geomspace(max(away - speeds[i] - 4.0 * noise, 0.5 * away), away + speeds[i] + noise, count)
    slowest, starts = Residual(link).on([i]), {}
    for divide in dict.fromkeys((substeps, FINE)):
        costs = [_cost(slowest, float(s), divide) for s in tried]
        near = [float(tried[j]) for j in np.argsort(costs)[:6]]
        starts[divide] = finest_sticks(Residual(link), near, float(tried[1] / tried[0]) - 1.0, divide)
    return starts


def finest_sticks(residual: Residual, near: list[float], step: float, divide: int) -> list[float]:
    """The best sticks [m] about the best of `near`, which lie apart by `step`, a part of them; where they better no stick at all."""
    best = sorted(near, key=lambda s: _cost(residual, s, divide))[:KEPT]
    if _cost(residual, best[0], divide) > square(residual(())):
        return best
    while step > FINEST:
        step /= FINER
        tried = sorted({s * (1.0 + step * j) for s in best for j in range(-FINER, FINER + 1)})
        best = sorted(tried, key=lambda s: _cost(residual, s, divide))[:KEPT]
    return best


def _cost(residual: Residual, stick: float, divide: int) -> float:
    return square(residual([("platform.friction", {"stick": stick, FORM: divide})]))
