"""When a rig counts as diverged."""

from __future__ import annotations

import math

from hiltestbed.compiled.jit import njit


@njit(cache=True)
def has_diverged(qpos, qvel, limit):
    """Whether a joint rate of one run reaches ``limit``, or a joint's position or rate is not
    finite.
    """
    for rate in qvel:
        if not abs(rate) < limit:  # true of NaN too
            return True
    for position in qpos:
        if not math.isfinite(position):
            return True
    return False
