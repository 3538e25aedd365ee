"""Stage "select", where few effects leave more than noise: how much of a departure the vocabulary
explains, one cause at a time.

It gives the share of a departure that known physics explains, and what that leaves. A further cause
must lower chi-square, and the residual on left-out runs, where a fit to mere leftovers does not
carry over.

Effects with many parameters are tried where simpler effects leave more than noise, or where one of
them replaces several simpler ones, which stand in for parts of it and each lower chi-square by more
than their penalty. Such an effect is therefore sought without them: alone, and together with those
of the causes found that it does not resemble.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit, inflation, null_fit, refit, refit_without
from hiltestbed.diagnosis.heldout import left_out
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search, with_rivals
from hiltestbed.diagnosis.settings import (
    MAX_CAUSES,
    MAX_PARTNERS,
    MIN_EXCESS_TO_GROW,
    MIN_HELDOUT_GAIN,
    MIN_HELDOUT_GAIN_IN_PART,
    SELECTION_INADEQUATE,
)
from hiltestbed.effects.search import Candidate

MAX_CAUSES_IN_PART = 5  # chosen: that are tried where those found leave more than noise

MAX_FURTHER = 3  # chosen: further causes that are fitted beside those found


def far_off(found: Explanation) -> bool:
    """Whether the best fit leaves so much more than noise that further causes can be fitted."""
    return not found.adequate and found.worst > MIN_EXCESS_TO_GROW


def grow(found: Explanation, search: Search) -> Fit:
    """The best fit of as many causes as exceed the thresholds, until only noise is left."""
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
    """Logarithm of the rms on left-out runs, mean over the runs; of a single run, of the fit."""
    if len(residual.runs) < 2:
        return 0.5 * math.log(max(found.chi2, 1e-300))
    return float(
        np.mean([0.5 * math.log(max(left_out(residual, i, found), 1e-300)) for i in residual.runs])
    )


def _pruned(residual: Residual, found: Fit, before: float) -> Fit:
    """Without needless causes; before: logarithm of the rms on left-out runs with all of them."""
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


@dataclass(frozen=True)
class Richer:
    """A link's ``search`` among simple effects, and ``candidates`` with many parameters."""

    search: Search
    candidates: tuple[Candidate, ...]

    def in_place_of(self, found: Explanation, residual: Residual | None = None) -> Explanation:
        """The explanation with such an effect instead of its stand-ins; ``found`` itself if none is
        better.

        residual: of the link with another timing, with which it is sought; by default that of
            ``found``.
        """
        if (
            not self.candidates
            or not found.departs
            or (found.adequate and len(found.chosen.causes) < 2)
        ):
            return found
        residual = residual or found.residual
        known = min(
            (f for f in (found.chosen, *found.singles, *found.more) if JITTER not in f.kinds),
            key=lambda f: f.score,
        )
        known = known if residual is found.residual else refit(residual, known)
        seek = replace(self.search, candidates=self.candidates)
        singles = seek.extend(residual, null_fit(residual))
        if not singles:
            return found
        if found.adequate:
            best, tried = singles[0], singles
            better = best.score < found.chosen.score and noise_alone(
                self.search.judge(residual, best.effects())
            )
        else:
            best, tried = self._several(residual, singles, known)
            better = (
                _pays(best, known)
                and log_heldout_rms(residual, known) - log_heldout_rms(residual, best)
                >= MIN_HELDOUT_GAIN_IN_PART
            )
        if not better:
            return found
        leftovers = self.search.judge(residual, best.effects())
        candidates, null = (*self.candidates, *found.candidates), null_fit(residual)
        explained = partial(Explanation, residual, candidates, null, best, noise_alone(leftovers))
        fits = ((*singles, *found.singles), (*tried, *found.more))
        explanation = explained(True, leftovers, found.before, *fits)
        return with_rivals(explanation, self.search.judge) if explanation.adequate else explanation

    def _several(
        self, residual: Residual, singles: Sequence[Fit], known: Fit
    ) -> tuple[Fit, list[Fit]]:
        """The best fit with as many further causes as pay, and all fits that were made."""
        tried = [*singles, *self._beside(residual, singles[0], known)]
        best = min(tried, key=lambda f: f.score)
        further = replace(self.search, candidates=(*self.candidates, *self.search.candidates))
        while len(best.causes) < MAX_CAUSES and not noise_alone(
            self.search.judge(residual, best.effects())
        ):
            more = further.extend(residual, best, MAX_PARTNERS)
            tried += more
            if not more or not _pays(more[0], best):
                break
            best = more[0]
        return self.search.needed(residual, best), tried

    def _beside(self, residual: Residual, single: Fit, known: Fit) -> list[Fit]:
        """Fits together with those of the ``known`` causes that the effect does not resemble."""
        alike = (*single.causes[0].effect.resembles, single.causes[0].kind)
        other = [i for i, c in enumerate(known.causes) if c.kind not in alike]
        if not other:
            return []
        causes = tuple(known.causes[i] for i in other)
        theta = [value for i in other for value in known.part(i)]
        base = fit(residual, causes, [theta], tries=1)
        return replace(self.search, candidates=self.candidates).extend(residual, base)


def _pays(more: Fit, fewer: Fit) -> bool:
    """Whether the further cause lowers the score by more than the selection threshold."""
    return fewer.score - more.score > SELECTION_INADEQUATE * inflation(more)
