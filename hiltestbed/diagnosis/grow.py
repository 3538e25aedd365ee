"""Where no one or two effects come near the noise: how far the vocabulary goes, cause by cause.

What is found here names nothing: the verdict is given before. It says how much of a departure known physics carries, and what that
leaves. A further cause has to pay in chi-square and on runs that were left out, where what is fitted to leftovers does not carry over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hiltestbed.diagnosis.candidates import Candidate
from hiltestbed.diagnosis.fit import Fit, Residual, fit
from hiltestbed.diagnosis.heldout import left_out
from hiltestbed.diagnosis.search import JITTER, PAYS_INADEQUATE, Explanation, extend, inflation

MOST = 5  # causes
TRIED = 3  # further causes that are fitted beside those found
WORTH = 0.02  # of the residual on left-out runs, geometric mean over them, by which a further cause has to lower it
FAR_OFF = 10.0  # times the limit of what passes for noise: nearer to it, a further cause would go into what is not known of the noise


def far_off(found: Explanation) -> bool:
    """Whether the best that was found leaves so much more than noise that there is something to grow into."""
    return not found.adequate and max(left.excess for left in found.leftovers.values()) > FAR_OFF


def grow(residual: Residual, found: Explanation, candidates: Sequence[Candidate], progress: Callable[[str], None] | None = None) -> Fit:
    """The best that up to MOST causes do, beside the best that was found."""
    best = min([found.chosen, *found.singles, *found.pairs], key=lambda f: f.score)
    if JITTER in {c.effect for c in best.causes}:  # noise, beside which nothing is weighed
        return best
    before = _carried(residual, best)
    while len(best.causes) < MOST:
        for more in extend(residual, best, candidates, progress, (), TRIED):
            after = _carried(residual, more) if _pays(more, best) else math.inf
            if after < before + math.log(1.0 - WORTH):
                best, before = more, after
                break
        else:
            break
    return _needed(residual, best)


def _pays(more: Fit, fewer: Fit) -> bool:
    return fewer.score - more.score > PAYS_INADEQUATE * inflation(more)


def _carried(residual: Residual, found: Fit) -> float:
    """Logarithm of the rms on left-out runs, mean over the runs; of the fit itself where there is one run alone."""
    if len(residual.runs) < 2:
        return 0.5 * math.log(max(found.chi2, 1e-300))
    return float(np.mean([0.5 * math.log(max(left_out(residual, i, found), 1e-300)) for i in residual.runs]))


def _needed(residual: Residual, found: Fit) -> Fit:
    """Without the causes that the others have made needless."""
    for c in found.causes:
        rest = [i for i, other in enumerate(found.causes) if other is not c]
        if not rest:
            continue
        fewer = fit(residual, [found.causes[i] for i in rest], [np.concatenate([found.part(i) for i in rest])], tries=1)
        if not _pays(found, fewer) or _carried(residual, fewer) < _carried(residual, found):
            found = fewer
    return found
