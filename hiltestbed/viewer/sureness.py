"""Whether a running estimate has settled, judged from its past changes.

The difference of the estimate from n samples and that from the first n/2 of them has the variance
of the estimate itself: nested efficient estimates have Var(a_(n/2) - a_n) = Var(a_(n/2)) -
Var(a_n), which is Var(a_n) if the variance falls as 1/n. The change of the estimate over the second
half of its samples is therefore as large as its error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hiltestbed.analysis.assessment import UNSURE
from hiltestbed.frames import Array

CHECKED = 300  # rows at which an estimate is compared with its past


def unsure(values: Array, counted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """``(rows,)`` where an estimate ``values`` ``(rows,)`` has changed by more than a tenth over
    the second half of its samples.

    ``counted`` ``(rows,)``: rows that contributed a sample; between these rows the result is held.
    Rows without an estimate are unsure.
    """
    known = np.isfinite(values)
    rows = np.flatnonzero(counted & known)
    out = np.ones(len(values), dtype=bool)
    if not len(rows):
        return out
    places = np.unique(np.linspace(0, len(rows) - 1, CHECKED).astype(int))
    samples = values[rows]
    doubt = np.array(
        [np.ptp(samples[p // 2 : p + 1]) > UNSURE * abs(samples[p]) or p == 0 for p in places]
    )
    at = np.searchsorted(rows[places], np.arange(len(values)), side="right") - 1
    out[at >= 0] = doubt[at[at >= 0]]
    return out | ~known
