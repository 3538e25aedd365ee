"""Where no few effects come near the noise: how far the vocabulary goes, cause by cause.

It says how much of a departure known physics carries, and what that leaves. A further cause has to pay in chi-square and on runs that were
left out, where what is fitted to leftovers does not carry over.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit, inflation
from hiltestbed.diagnosis.heldout import left_out
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import FAR_OFF, MOST_CAUSES_IN_PART, SELECTION_INADEQUATE, WORTH

TRIED = 3  # further causes that are fitted beside those found


def far_off(found: Explanation) -> bool:
    """Whether the best that was found leaves so much more than noise that there is something to grow into."""
    return not found.adequate and found.worst > FAR_OFF


def grow(found: Explanation, search: Search) -> Fit:
    """The best that several causes do, beside the best that was found: as many as pay, and no more once they leave noise alone."""
    residual = found.residual
    best = min([found.chosen, *found.singles, *found.more], key=lambda f: f.score)
    if JITTER in best.kinds:  # noise, beside which nothing is weighed
        return best
    before = carried(residual, best)
    while len(best.causes) < MOST_CAUSES_IN_PART and not noise_alone(search.judge(residual, best.effects())):
        for more in search.extend(residual, best, TRIED):
            after = carried(residual, more) if _pays(more, best) else math.inf
            if after < before + math.log(1.0 - WORTH):
                best, before = more, after
                break
        else:
            break
    return _needed(residual, best)


def _pays(more: Fit, fewer: Fit) -> bool:
    return fewer.score - more.score > SELECTION_INADEQUATE * inflation(more)


def carried(residual: Residual, found: Fit) -> float:
    """Logarithm of the rms on left-out runs, mean over the runs; of the fit itself where there is one run alone."""
    if len(residual.runs) < 2:
        return 0.5 * math.log(max(found.chi2, 1e-300))
    return float(np.mean([0.5 * math.log(max(left_out(residual, i, found), 1e-300)) for i in residual.runs]))


def _needed(residual: Residual, found: Fit) -> Fit:
    """Without the causes that the others have made needless."""
    for c in found.causes:
        index = next((i for i, other in enumerate(found.causes) if other is c), None)
        if index is None or len(found.causes) == 1:
            continue
        causes, theta = found.without(index)
        fewer = fit(residual, causes, [theta], tries=1)
        if not _pays(found, fewer) or carried(residual, fewer) < carried(residual, found):
            found = fewer
    return found
