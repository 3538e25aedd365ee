"""Stage "select": the explanation found on decimated rows is fitted again on all rows: estimates
and rivals are those of the whole record.

A mean over a block of rows blurs the instants at which a contact begins and ends, which tell a
delayed sensor from a stamp delay, and a delay from a smooth response.
"""

from __future__ import annotations

from dataclasses import replace

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import fit, inflation, null_fit, refit
from hiltestbed.diagnosis.heldout import placebo_of
from hiltestbed.diagnosis.links import WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, first_of_each, with_rivals
from hiltestbed.diagnosis.settings import CLOSE_CHI2, DECIMATION_ERROR, MAX_PARTNERS


def refit_on_all_rows(found: Explanation, link: WrenchLink) -> Explanation:
    """``found`` and the fits near it, fitted again on ``link``; ``found`` itself where it does not
    explain all rows.
    """
    chosen = found.chosen
    if not (found.departs and found.adequate and chosen.causes) or JITTER in chosen.kinds:
        return found
    residual = Residual(link).downweighted(chosen.effects())
    pool = sorted(
        (f for f in (*found.singles, *found.more) if len(f.causes) == len(chosen.causes)),
        key=lambda f: f.score,
    )
    within = CLOSE_CHI2 * inflation(chosen) + DECIMATION_ERROR * (found.null.chi2 - chosen.chi2)
    near = [
        f
        for f in first_of_each(pool, "key")
        if f.score - chosen.score < within and JITTER not in f.kinds
    ]
    fits = sorted((refit(residual, f) for f in near[:MAX_PARTNERS]), key=lambda f: f.score) or [
        refit(residual, chosen)
    ]
    best = fits[0]
    leftovers = contact_leftovers(residual, best.effects())
    if not noise_alone(leftovers):
        return found
    fewer = [
        fit(residual, causes, [theta], tries=1)
        for causes, theta in map(best.without, range(len(best.causes)))
        if causes
    ]
    placebo = placebo_of(found.singles, best)
    result = replace(
        found,
        residual=residual,
        null=null_fit(residual),
        chosen=best,
        leftovers=leftovers,
        before=contact_leftovers(residual, ()),
        singles=tuple(refit(residual, f) for f in [placebo] if f is not None),
        more=(*fits, *fewer),
        rivals=(),
    )
    return with_rivals(result, contact_leftovers)
