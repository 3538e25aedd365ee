"""Stage "select": the effects that explain one link: first each alone, then further ones beside the
best, while each exceeds its threshold.

Takes a `Residual` and the candidates; gives an `Explanation`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, Judge, Leftover, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Fit, fit, inflation, keys_of, null_fit, refit, refit_without
from hiltestbed.diagnosis.jitter_and_hum import again
from hiltestbed.diagnosis.rating import rate
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.settings import (
    AMBIGUITY,
    CLOSE_CHI2,
    DETECTION,
    MAX_CAUSES,
    MAX_PARTNERS,
    MIN_EXCESS_TO_GROW,
    SELECTION_INADEQUATE,
)
from hiltestbed.effects.search import Candidate
from hiltestbed.process.progress import UnitTime, time_left_text

# calibrated: selection threshold of a further cause where the causes so far already leave only
# noise
SELECTION = 100.0
BEAM_WIDTH = 5  # chosen: first causes for which a second one is sought
# chosen: pairs of causes for which a third one is sought, on a link whose replay is costly
COSTLY_BEAM_WIDTH = 2
MAX_FITS_PER_EFFECT = 3  # chosen: hypotheses of one effect (axes, variants) that are fitted
MAX_SINGLES = 40  # chosen: single causes that are fitted
# calibrated: most that a fit may gain over its linearised gain; 3.5 was the most of 553 fits on 18
# rig sets
LINEAR_GAIN_MARGIN = 10.0
# chosen: share of the best gain in chi-square; a variant of an effect that gains less rules out its
# other variants
MIN_VARIANT_GAIN = 0.3
# chosen: share of a parameter's range; a value closer to a bound is compared with the bound itself
NEAR_BOUND = 0.1

# a hypothesis from the residual of a fit; chi-square that another has reached
Special = Callable[[Residual, Fit, float], Fit | None]
# the interpretation of a link that fits better; the residual itself where none does
Reread = Callable[[Residual, Fit], Residual]
Identity = Literal["kinds", "places", "key"]  # of sets of causes, see `first_of_each`
Progress = Callable[[str], None]


def labelled(progress: Progress | None, label: str) -> Progress | None:
    """The callback for the parts of a step."""
    return (lambda text: progress(f"{label}: {text}")) if progress else None


CLOCKS = {"sensor.delay", "log.skew"}


@dataclass(frozen=True)
class Explanation:
    """What a search found on one link.

    Attributes:
        residual: under the weights of the search. candidates: that were compared.
        null: the null hypothesis. singles, more: fits of one cause and of several, best first;
            singles contain a given cause beside theirs.
        chosen: the best fit above the thresholds. adequate: whether it leaves only noise. departs:
            whether anything departs at all.
        leftovers: channel to what the chosen fit leaves. before: channel to what the null leaves.
        rivals: for each cause of the chosen fit, the fits that differ in that cause only and cannot
            be told from it.
    """

    residual: Residual
    candidates: tuple[Candidate, ...]
    null: Fit
    chosen: Fit
    adequate: bool
    departs: bool
    leftovers: dict[str, Leftover]
    before: dict[str, Leftover]
    singles: tuple[Fit, ...] = ()
    more: tuple[Fit, ...] = ()
    rivals: tuple[tuple[Fit, ...], ...] = ()

    @property
    def worst(self) -> float:
        """The worst channel's residual over the limit of what passes for noise."""
        return max((left.excess for left in self.leftovers.values()), default=0.0)

    def stamped(self, **shifts: float) -> Explanation:
        """The same with ``shifts`` [s] of :meth:`Link.stamped` that do not show on the link."""
        return replace(self, residual=self.residual.through(self.residual.link.stamped(**shifts)))

    def with_the_other_clock(self, judge: Judge) -> Explanation:
        """With a late sensor and a late stamp as rivals of each other, where both are hypotheses.

        They are rivals where no channel shows what the loop made of the force: only the facility's
        interpolation between rows, which is not known, could tell them apart. So the link itself
        counts as much for the one as for the other.
        """
        clocks = [c for c in self.candidates if c.kind in CLOCKS and not c.variant]
        if self.chosen.causes == () or {c.kind for c in clocks} != CLOCKS:
            return self
        rivals = list(self.rivals or ((),) * len(self.chosen.causes))
        for i, cause in enumerate(self.chosen.causes):
            other = next((c for c in clocks if c.kind != cause.kind), None)
            if (
                cause.kind not in CLOCKS
                or other is None
                or CLOCKS & {*self.chosen.kinds[:i], *self.chosen.kinds[i + 1 :]}
            ):
                continue
            causes = (*self.chosen.causes[:i], other, *self.chosen.causes[i + 1 :])
            late = fit(self.residual, causes, [self.chosen.theta], tries=1)
            if noise_alone(judge(self.residual, late.effects())):
                others = (f for f in rivals[i] if other.kind not in f.kinds)
                rivals[i] = (replace(late, elsewhere=self.chosen.score - late.score), *others)
        return replace(self, rivals=tuple(rivals))


@dataclass(frozen=True)
class Search:
    """How a link is searched: the candidates, the test whether only noise is left, and hypotheses
    derived from the residual.
    """

    candidates: tuple[Candidate, ...]
    judge: Judge = contact_leftovers
    special: tuple[Special, ...] = ()
    progress: Progress | None = None
    reread: Reread | None = None  # called with the best cause alone, before further ones are sought
    # the residual's level is a bound on an error and no noise: what stays below it shows nothing
    bounded: bool = False
    # threshold of a further cause where those found leave only noise; infinite: none is sought
    beside: float = SELECTION
    # fits under another timing or interpretation, by their causes
    before: Mapping[frozenset[tuple], Fit] = field(default_factory=dict)
    earlier: Explanation | None = None  # under that timing or interpretation

    def after(self, found: Explanation) -> Search:
        """The same search of a link otherwise timed or interpreted, from those estimates."""
        fits = {f.keys: f for f in (*found.more, *found.singles)}
        return replace(self, before={**self.before, **fits}, earlier=found)

    def _as_far_off(self, residual: Residual) -> Explanation | None:
        """The earlier explanation of a costly link, fitted again with another timing or
        interpretation, where each of its fits is far off with that as well: no others are sought
        then, which would take as long as the first search. None where one comes near.
        """
        found = self.earlier
        if found is None or found.adequate or not residual.link.costly:
            return None
        several = first_of_each(found.more, "kinds")[:MAX_PARTNERS]
        pool = [found.chosen, *first_of_each(found.singles, "kinds"), *several]
        pool = [f for f in pool if f.causes and JITTER not in f.kinds]
        there = residual.downweighted(found.chosen.effects())
        fits = [null_fit(there), *_reweighted(there, pool)]
        best = min(fits, key=lambda f: f.score)
        leftovers = self.judge(there, best.effects())
        if max(left.excess for left in leftovers.values()) <= MIN_EXCESS_TO_GROW:
            return None
        singles, more = (
            [f for f in sorted(fits, key=_order) if len(f.causes) in counts]
            for counts in ((1,), (2, 3))
        )
        explained = partial(Explanation, there, self.candidates, fits[0], best, False, True)
        return explained(leftovers, self.judge(residual, ()), tuple(singles), tuple(more))

    def explain(self, residual: Residual, given: Fit | None = None) -> Explanation:
        """The explanation of a link; given: a fit with a cause that another link has shown."""
        if given is None and (same := self._as_far_off(residual)):
            return same
        residual = residual.downweighted(given.effects() if given else ())
        null = refit(residual, given) if given else null_fit(residual)
        before = self.judge(residual, null.effects())
        adequate_null = noise_alone(before)
        if self.bounded and adequate_null and not given:
            return Explanation(residual, self.candidates, null, null, True, False, before, before)
        # threshold of a cause, in units of the misfit
        least = SELECTION if given and adequate_null else DETECTION
        singles = self.extend(residual, null, worth=least if adequate_null else 0.0)
        there = residual.downweighted(singles[0].effects()) if singles else residual
        if there is not residual:
            residual, null = there, refit(there, null)
            beam = _beam(singles, BEAM_WIDTH, variants=not residual.link.costly)
            singles = _reweighted(residual, beam)
            before = self.judge(residual, null.effects())
        counts = singles and (
            not adequate_null or null.score - singles[0].score > least * inflation(singles[0])
        )
        if counts and not given and self.reread:
            other = self.reread(residual, singles[0])
            if other is not residual:
                return replace(self, reread=None, earlier=None).explain(other)
        # under the weights of the best model
        singles += [f for make in self.special if (f := make(residual, null, math.inf)) is not None]
        singles.sort(key=_order)
        best = singles[0] if singles else null
        need = least * inflation(best)
        departs = null.score - best.score > need or not adequate_null
        known = (null,) if given else ()
        if not departs:
            explained = partial(Explanation, residual, self.candidates, null_fit(residual), null)
            return explained(True, given is not None, before, before, (*singles, *known))
        chosen = best if null.score - best.score > need else null
        return self._several(residual, chosen, singles, before, known, given is not None)

    def _several(
        self,
        residual: Residual,
        chosen: Fit,
        singles: list[Fit],
        before: dict[str, Leftover],
        known: tuple[Fit, ...],
        given: bool,
    ) -> Explanation:
        """Further causes beside the best so far, until none exceeds its threshold."""
        leftovers = self.judge(residual, chosen.effects())
        adequate = noise_alone(leftovers)
        more: list[Fit] = []
        level = singles
        for count in range(1, 1 if given else MAX_CAUSES):
            # a third cause would hide in the noise
            if adequate and (count > 1 or math.isinf(self.beside)):
                break
            found: list[Fit] = []
            costly = residual.link.costly
            width = 1 if adequate else COSTLY_BEAM_WIDTH if count > 1 and costly else BEAM_WIDTH
            for base in _beam(level, width, variants=not (adequate or costly)):
                search = self._near(residual, base, found) if count > 1 else self
                worth = self.beside if adequate else 0.0
                found += search.extend(residual, base, MAX_PARTNERS, self.special, found, worth)
            found = first_of_each(sorted(found, key=lambda f: f.score), "key")
            if not found:
                break
            if (downweighted := residual.downweighted(found[0].effects())) is not residual:
                residual = downweighted
                found = sorted(_reweighted(residual, found[:MAX_PARTNERS]), key=lambda f: f.score)
                chosen = again(residual, chosen)
            more = [*found, *more]
            need = (self.beside if adequate else SELECTION_INADEQUATE) * inflation(found[0])
            if chosen.score - found[0].score <= need:
                break
            chosen, level = found[0], found
            leftovers = self.judge(residual, chosen.effects())
            adequate = noise_alone(leftovers)
        if level is not singles and (fewer := self.needed(residual, chosen)) is not chosen:
            chosen, more, leftovers = fewer, [fewer, *more], self.judge(residual, fewer.effects())
            adequate = noise_alone(leftovers)
        explained = partial(Explanation, residual, self.candidates, null_fit(residual), chosen)
        result = explained(adequate, True, leftovers, before, (*singles, *known), tuple(more))
        return result if not (adequate and chosen.causes) else with_rivals(result, self.judge)

    def needed(self, residual: Residual, chosen: Fit) -> Fit:
        """``chosen`` without the causes that only led to better estimates of the others: fitted
        again from where they stand beside them, those do as well. A descent from the starts of a
        cause alone may end in another valley.
        """
        # the likelihood of a jitter is no sum of squares
        if len(chosen.causes) < 2 or JITTER in chosen.kinds:
            return chosen
        share = inflation(chosen)
        most = max(self.beside, SELECTION_INADEQUATE) * share
        for index in range(len(chosen.causes)):
            fewer = refit_without(residual, chosen, index, known=chosen.score + most)
            if fewer.score - chosen.score > most:
                continue
            noise = noise_alone(self.judge(residual, fewer.effects()))
            need = self.beside if noise else SELECTION_INADEQUATE
            if fewer.score - chosen.score <= need * share:
                return self.needed(residual, fewer)
        return chosen

    def _near(self, residual: Residual, base: Fit, found: Sequence[Fit]) -> Search:
        """The same search; beside a fit that leaves only noise, only for rivals of it."""
        best = min(found, key=lambda f: f.score, default=base)
        foreign = set(base.kinds) - set(best.kinds)
        if not foreign:
            return self
        # as when its turn comes
        left = self.judge(residual.downweighted(best.effects()), best.effects())
        if not noise_alone(left):
            return self
        return replace(self, candidates=tuple(c for c in self.candidates if c.kind in best.kinds))

    def extend(
        self,
        residual: Residual,
        base: Fit,
        most: int = MAX_SINGLES,
        special: Sequence[Special] = (),
        beside: Sequence[Fit] = (),
        worth: float = 0.0,
    ) -> list[Fit]:
        """Fits of ``base`` with one more cause, best first.

        A descent that will not come near the best of ``beside``, or not lower chi-square by
        ``worth``, is stopped.
        """
        # its likelihood is no sum of squares: it is added to others, not they to it
        if JITTER in base.kinds:
            return []
        wanted = [
            c for c in self.candidates if not any(_overlap(c, known) for known in base.causes)
        ]
        rated = rate(residual, base, wanted, most)
        fits: list[Fit] = []
        count: dict[str, int] = {}
        limit = min(
            most,
            sum(min(n, MAX_FITS_PER_EFFECT) for n in Counter(c.kind for _, c, _ in rated).values()),
        )
        pace = UnitTime()
        for gain, c, starts in rated:
            count[c.kind] = count.get(c.kind, 0) + 1
            if count[c.kind] > MAX_FITS_PER_EFFECT or len(fits) >= most or _beaten(c, base, fits):
                continue
            near, best = _near_best(base, (*fits, *beside), worth)
            # no beam beside an adequate fit
            enough = len({f.causes[-1].kind for f in fits}) >= BEAM_WIDTH or inflation(best) == 1.0
            if fits and enough and base.chi2 - LINEAR_GAIN_MARGIN * gain > near:
                break
            if self.progress:
                pace.update(len(fits))
                left = time_left_text(pace.left(limit - len(fits)), "at most in this step")
                self.progress(
                    f"fit {len(fits) + 1} of at most {limit}{left}: "
                    f"{' + '.join([*base.kinds, c.kind])}"
                )
            causes, together = (*base.causes, c), [np.concatenate([base.theta, s]) for s in starts]
            tries, earlier = 2 if base.causes else 3, self.before.get(keys_of(causes))
            # simple effects alone are sought anew: it takes little
            if earlier is not None and (base.causes or c.effect.rich):
                tries, together = 1, [earlier.of(causes), *together]
            fits.append(fit(residual, causes, together, tries, near))
        near, _ = _near_best(base, (*fits, *beside), worth)
        fits += [f for make in special if (f := make(residual, base, near)) is not None]
        return sorted(fits, key=_order)


def _reweighted(residual: Residual, fits: Sequence[Fit]) -> list[Fit]:
    """The fits, best first, fitted again under other weights; costly ones if they come near."""
    out: list[Fit] = []
    for f in fits:
        best = min(out, key=lambda other: other.chi2, default=None)
        near = (
            best.chi2 + CLOSE_CHI2 * inflation(best) if best and residual.link.costly else math.inf
        )
        out.append(again(residual, f, near))
    return out


def _near_best(base: Fit, fits: Sequence[Fit], worth: float) -> tuple[float, Fit]:
    """Chi-square that a further fit has to reach, and the best; worth: least gain on ``base``."""
    best = min(fits, key=lambda f: f.chi2, default=base)
    return min(best.chi2 + CLOSE_CHI2 * inflation(best), base.chi2 - worth), best


def _overlap(c: Candidate, other: Candidate) -> bool:
    """Whether two hypotheses are of one effect, or one of a rich effect like the other's."""
    parts = [a.kind in b.effect.resembles for a, b in ((c, other), (other, c)) if b.effect.rich]
    return c.kind == other.kind or any(parts)


def _beaten(c: Candidate, base: Fit, fits: Sequence[Fit]) -> bool:
    """Whether another variant gains so little that this one need not be tried."""
    best = max((base.chi2 - f.chi2 for f in fits), default=0.0)
    twins = [f for f in fits if f.causes[-1].kind == c.kind and f.causes[-1].fixed == c.fixed]
    return any(base.chi2 - f.chi2 < MIN_VARIANT_GAIN * best for f in twins)


def _order(f: Fit) -> tuple[float, float]:
    return round(f.score, 1), _boldness(f)


def _boldness(f: Fit) -> float:
    """Distance of the factors from one: of two equal fits the less bold one goes first."""
    return sum(
        abs(math.log(max(e.parameters()["factor"], 1e-9)))
        for e in f.effects()
        if "factor" in e.parameters()
    )


def _beam(fits: Sequence[Fit], width: int, variants: bool) -> list[Fit]:
    """The best fits, best first, that are continued: of ``width`` sets of effects, the best of
    each.

    variants: also the best set with another variant, if that leaves clearly more: beside a further
        cause it may be the better one.
    """
    if not fits:
        return []
    first = fits[0]
    need = SELECTION_INADEQUATE * inflation(first)
    alike = [
        f for f in first_of_each(fits, "key") if _causes(f, "places") == _causes(first, "places")
    ]
    others = [f for f in alike if f.score - first.score > need] if variants else []
    return [first, *others[:1], *first_of_each(fits, "kinds")[1:width]]


def _causes(f: Fit, by: Identity) -> tuple[str, ...]:
    each = ({"kinds": c.kind, "places": (c.kind, *c.place), "key": c.key} for c in f.causes)
    return tuple(sorted(str(c[by]) for c in each))


def first_of_each(fits: Sequence[Fit], by: Identity) -> list[Fit]:
    """The first fit of each set of causes; ``by``: whether sets with the same ``kinds``, with the
    same kinds on the same axes and bodies (``places``), or with the same hypotheses (``key``), are
    one.
    """
    seen, out = set(), []
    for f in fits:
        causes = _causes(f, by)
        if causes not in seen:
            seen.add(causes)
            out.append(f)
    return out


def _limit_of(residual: Residual, chosen: Fit, index: int, other: Fit) -> bool:
    """Whether ``other`` has, in place of a cause, one of more parameters at a bound of its range,
    where it reduces to that cause.

    An estimate that noise has moved off the bound counts as at the bound, if the fit with the
    parameter held there is as good.
    """
    own = next((i for i, kind in enumerate(other.kinds) if kind not in chosen.kinds), None)
    if own is None:  # the same effect on another axis or body
        return False
    richer, theta = other.causes[own], other.part(own)
    if len(richer.names) <= len(chosen.causes[index].names) or richer.vector:
        return False
    ends = np.where(theta - richer.low < richer.high - theta, richer.low, richer.high)
    close = np.flatnonzero(np.abs(theta - ends) < NEAR_BOUND * (richer.high - richer.low))
    for j in close:
        held = richer.held(int(j), float(ends[j]))
        causes = (*other.causes[:own], held, *other.causes[own + 1 :])
        start = np.delete(other.theta, other.place(own).start + j)
        if fit(residual, causes, [start], tries=1).chi2 - other.chi2 < AMBIGUITY * inflation(other):
            return True
    return False


def _only_difference(chosen: Fit, other: Fit) -> int | None:
    """The cause of ``chosen`` that ``other`` does not have; None where there is not exactly one.

    Between fits of the same effects an axis or a body makes a difference; between others it does
    not.
    """
    same_kinds = sorted(chosen.kinds) == sorted(other.kinds)
    own, others = (
        [(c.kind, c.place if same_kinds else ()) for c in f.causes] for f in (chosen, other)
    )
    missing = [i for i, cause in enumerate(own) if cause not in others]
    return missing[0] if len(missing) == 1 else None


def with_rivals(found: Explanation, judge: Judge) -> Explanation:
    """The explanation with its rivals: the fits that differ from the chosen one in one cause and
    cannot be told from it.

    The same effect on another axis or body is a rival like any other effect.
    """
    chosen = found.chosen
    pool = [f for f in (*found.singles, *found.more) if len(f.causes) == len(chosen.causes)]
    most = chosen.score + AMBIGUITY * inflation(chosen)
    close = [f for f in pool if f is not chosen and f.score < most]
    same = [f for f in close if sorted(f.kinds) == sorted(chosen.kinds)]
    elsewhere = first_of_each(same, "places")
    others = first_of_each([f for f in close if f not in same], "kinds")
    rivals: list[list[Fit]] = [[] for _ in chosen.causes]
    for f in (*elsewhere, *others):
        index = _only_difference(chosen, f)
        if index is None or _limit_of(found.residual, chosen, index, f):
            continue
        if noise_alone(judge(found.residual, f.effects())):
            rivals[index].append(f)
    return replace(found, rivals=tuple(map(tuple, rivals))).with_the_other_clock(judge)
