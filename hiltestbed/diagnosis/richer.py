"""An effect with many numbers, where effects with fewer leave more than noise, or where it does alone what several of them do.

Where such an effect is at work, those with fewer numbers stand in for parts of it, and each of them pays. It is therefore sought without
them: alone, and beside those of the causes found that it does not resemble. What it makes needless goes. It has to lower the
residual of runs that were left out as well, since so many numbers bend to much that is no drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hiltestbed.diagnosis.adequacy import JITTER, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit, inflation, nothing, refit
from hiltestbed.diagnosis.grow import carried
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, Search, with_rivals
from hiltestbed.diagnosis.settings import MOST_CAUSES, PARTNERS, SELECTION_INADEQUATE, WORTH_IN_PART
from hiltestbed.effects.search import Candidate


@dataclass(frozen=True)
class Richer:
    """``search``: of the link, among effects with few numbers; ``candidates``: the hypotheses of effects with many."""

    search: Search
    candidates: tuple[Candidate, ...]

    def in_place_of(self, found: Explanation, residual: Residual | None = None) -> Explanation:
        """The explanation with such an effect in place of what stood in for it; ``found`` itself where none does better.

        residual: of the link in another place, in which it is sought; else where it was found.
        """
        if not self.candidates or not found.departs or (found.adequate and len(found.chosen.causes) < 2):
            return found
        residual = residual or found.residual
        known = min((f for f in (found.chosen, *found.singles, *found.more) if JITTER not in f.kinds), key=lambda f: f.score)
        known = known if residual is found.residual else refit(residual, known)
        seek = replace(self.search, candidates=self.candidates)
        singles = seek.extend(residual, nothing(residual))
        if not singles:
            return found
        if found.adequate:
            best, tried = singles[0], singles
            better = best.score < found.chosen.score and noise_alone(self.search.judge(residual, best.effects()))
        else:
            best, tried = self._several(residual, singles, known)
            better = _pays(best, known) and carried(residual, known) - carried(residual, best) >= WORTH_IN_PART
        if not better:
            return found
        leftovers = self.search.judge(residual, best.effects())
        explanation = Explanation(
            residual, (*self.candidates, *found.candidates), nothing(residual), best, noise_alone(leftovers), True, leftovers, found.before,
            (*singles, *found.singles), (*tried, *found.more),
        )  # fmt: skip
        return with_rivals(explanation, self.search.judge) if explanation.adequate else explanation

    def _several(self, residual: Residual, singles: Sequence[Fit], known: Fit) -> tuple[Fit, list[Fit]]:
        """The best with further causes, as many as pay, and all that was fitted."""
        tried = [*singles, *self._beside(residual, singles[0], known)]
        best = min(tried, key=lambda f: f.score)
        further = replace(self.search, candidates=(*self.candidates, *self.search.candidates))
        while len(best.causes) < MOST_CAUSES and not noise_alone(self.search.judge(residual, best.effects())):
            more = further.extend(residual, best, PARTNERS)
            tried += more
            if not more or not _pays(more[0], best):
                break
            best = more[0]
        return self._needed(residual, best), tried

    def _beside(self, residual: Residual, single: Fit, known: Fit) -> list[Fit]:
        """Fits beside those of the ``known`` causes that the effect does not resemble."""
        effect = single.causes[0].effect
        other = [i for i, c in enumerate(known.causes) if c.kind not in (*effect.resembles, single.causes[0].kind)]
        if not other:
            return []
        causes = tuple(known.causes[i] for i in other)
        theta = [value for i in other for value in known.part(i)]
        base = fit(residual, causes, [theta], tries=1)
        return replace(self.search, candidates=self.candidates).extend(residual, base)

    def _needed(self, residual: Residual, found: Fit) -> Fit:
        """Without the causes that pay no more."""
        for c in found.causes:
            index = next(i for i, other in enumerate(found.causes) if other is c)
            if len(found.causes) > 1:
                causes, theta = found.without(index)
                fewer = fit(residual, causes, [theta], tries=1)
                found = found if _pays(found, fewer) else fewer
        return found


def _pays(more: Fit, fewer: Fit) -> bool:
    return fewer.score - more.score > SELECTION_INADEQUATE * inflation(more)
