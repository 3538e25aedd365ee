"""Effects with many parameters, tried where simpler effects leave more than noise, or where one of
them replaces several simpler ones.

Where such an effect acts, simpler effects stand in for parts of it, and each of them lowers
chi-square by more than its penalty. It is
therefore sought without them: alone, and together with those of the causes found that it does not
resemble. Causes that it makes redundant are removed. It also has to lower the residual of left-out
runs, since so many parameters can fit much that is not a drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hiltestbed.diagnosis.adequacy import JITTER, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit, inflation, null_fit, refit
from hiltestbed.diagnosis.grow import log_heldout_rms
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search, with_rivals
from hiltestbed.diagnosis.settings import (
    MAX_CAUSES,
    MAX_PARTNERS,
    MIN_HELDOUT_GAIN_IN_PART,
    SELECTION_INADEQUATE,
)
from hiltestbed.effects.search import Candidate


@dataclass(frozen=True)
class Richer:
    """``search``: of the link, among the simpler effects; ``candidates``: the hypotheses of the
    effects with many parameters.
    """

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
        explanation = Explanation(
            residual,
            (*self.candidates, *found.candidates),
            null_fit(residual),
            best,
            noise_alone(leftovers),
            True,
            leftovers,
            found.before,
            (*singles, *found.singles),
            (*tried, *found.more),
        )
        return with_rivals(explanation, self.search.judge) if explanation.adequate else explanation

    def _several(
        self, residual: Residual, singles: Sequence[Fit], known: Fit
    ) -> tuple[Fit, list[Fit]]:
        """The best fit with as many further causes as lower chi-square by more than the penalty,
        and all fits that were made.
        """
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
        effect = single.causes[0].effect
        other = [
            i
            for i, c in enumerate(known.causes)
            if c.kind not in (*effect.resembles, single.causes[0].kind)
        ]
        if not other:
            return []
        causes = tuple(known.causes[i] for i in other)
        theta = [value for i in other for value in known.part(i)]
        base = fit(residual, causes, [theta], tries=1)
        return replace(self.search, candidates=self.candidates).extend(residual, base)


def _pays(more: Fit, fewer: Fit) -> bool:
    """Whether the further cause lowers the score by more than the selection threshold."""
    return fewer.score - more.score > SELECTION_INADEQUATE * inflation(more)
