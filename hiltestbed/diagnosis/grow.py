"""Stage "select", where few effects leave more than noise: how much of a departure the vocabulary
explains, one cause at a time.

It gives the share of a departure that known physics explains, and what that leaves. A further cause
must lower chi-square, and the residual on left-out runs, where a fit to mere leftovers does not
carry over.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, noise_alone
from hiltestbed.diagnosis.fit import Fit, inflation, refit_without
from hiltestbed.diagnosis.heldout import left_out
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import (
    MAX_CAUSES_IN_PART,
    MIN_EXCESS_TO_GROW,
    MIN_HELDOUT_GAIN,
    SELECTION_INADEQUATE,
)

MAX_FURTHER = 3  # chosen: further causes that are fitted beside those found


def far_off(found: Explanation) -> bool:
    """Whether the best fit leaves so much more than noise that further causes can be fitted."""
    return not found.adequate and found.worst > MIN_EXCESS_TO_GROW


def grow(found: Explanation, search: Search) -> Fit:
    """The best fit of several causes, beginning with the best so far: as many as exceed the
    thresholds, until only noise is left.
    """
    residual = found.residual
    best = min([found.chosen, *found.singles, *found.more], key=lambda f: f.score)
    # its likelihood is no sum of squares: no further cause can be compared
    if JITTER in best.kinds:
        return best
    before = log_heldout_rms(residual, best)
    while len(best.causes) < MAX_CAUSES_IN_PART and not noise_alone(
        search.judge(residual, best.effects())
    ):
        for more in search.extend(residual, best, MAX_FURTHER):
            after = log_heldout_rms(residual, more) if _exceeds_threshold(more, best) else math.inf
            if after < before + math.log(1.0 - MIN_HELDOUT_GAIN):
                best, before = more, after
                break
        else:
            break
    return _pruned(residual, best, before)


def _exceeds_threshold(more: Fit, fewer: Fit) -> bool:
    return fewer.score - more.score > SELECTION_INADEQUATE * inflation(more)


def log_heldout_rms(residual: Residual, found: Fit) -> float:
    """Logarithm of the rms on left-out runs, mean over the runs; of the fit itself if there is only
    one run.
    """
    if len(residual.runs) < 2:
        return 0.5 * math.log(max(found.chi2, 1e-300))
    return float(
        np.mean([0.5 * math.log(max(left_out(residual, i, found), 1e-300)) for i in residual.runs])
    )


def _pruned(residual: Residual, found: Fit, before: float) -> Fit:
    """Without the causes that the others have made needless; before: logarithm of the rms on
    left-out runs with all of them.
    """
    for c in found.causes:
        index = next((i for i, other in enumerate(found.causes) if other is c), None)
        if index is None or len(found.causes) == 1:
            continue
        fewer = refit_without(residual, found, index)
        needed = _exceeds_threshold(found, fewer)
        after = log_heldout_rms(residual, fewer)
        if not needed or after < before:
            found, before = fewer, after
    return found
