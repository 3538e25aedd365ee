"""A facility's identification of contact stiffness and damping in the loop: least squares of F = k
x + c v + b on each axis.

Force and pose refer to the same instant (the pose is delayed). A sample is used if there is contact
one tick before and after it. The sums are accumulated, so that the estimate uses all samples so
far.
"""

from __future__ import annotations

import math

from hiltestbed.compiled.jit import njit

SUMS = 10  # 1, x, v, y, xx, xv, vv, xy, vy, yy
LEAST = 8  # samples
TRAVEL = 1e-6  # m, rad: standard deviation of x below which an axis is not excited
EXPLAINED = 0.9  # smallest fraction of the force's variance that a valid estimate explains


@njit(cache=True)
def take(pending, sums, gated, late, rate, force):
    """Store this tick's samples and accumulate those of the tick before, once the contact has
    lasted three ticks.

    pending: (2, 6, 3) x, v, F of this tick and of the one before. late: (12,) pose at the force's
        instant. rate: (6,). force: (6,).
    """
    pending[1] = pending[0]
    for i in range(6):
        pending[0, i, 0] = late[i] if gated > 0.0 else 0.0
        pending[0, i, 1] = rate[i] if gated > 0.0 else 0.0
        pending[0, i, 2] = force[i]
    if gated < 3.0:
        return
    for i in range(6):
        x, v, y = pending[1, i, 0], pending[1, i, 1], pending[1, i, 2]
        terms = (1.0, x, v, y, x * x, x * v, v * v, x * y, v * y, y * y)
        for j in range(SUMS):
            sums[i, j] += terms[j]


@njit(cache=True)
def estimate(gated, sums, found):
    """Solve for stiffness and damping, `found` (6, 2); NaN for an axis whose force they do not
    explain.
    """
    if gated < 3.0:
        return
    for i in range(6):
        n = sums[i, 0]
        if n < LEAST:
            continue
        x, v, y = sums[i, 1] / n, sums[i, 2] / n, sums[i, 3] / n
        xx, xv, vv = sums[i, 4] - n * x * x, sums[i, 5] - n * x * v, sums[i, 6] - n * v * v
        xy, vy, yy = sums[i, 7] - n * x * y, sums[i, 8] - n * v * y, sums[i, 9] - n * y * y
        det = xx * vv - xv * xv
        if xx < n * TRAVEL**2 or det <= 1e-10 * xx * vv:
            continue
        stiffness, damping = (vv * xy - xv * vy) / det, (xx * vy - xv * xy) / det
        if stiffness * xy + damping * vy < EXPLAINED * yy:
            found[i] = math.nan
        else:
            found[i, 0], found[i, 1] = stiffness, damping
