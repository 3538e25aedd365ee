"""Stage "replay": decimation of a long record of a slow motion: block means of path and reading, as
long as the departure is preserved.

A damper that is moved at 1 Hz and recorded at 1 kHz tells no more with a thousand rows a second
than with two hundred, and every row costs a step of every hypothesis. A block mean delays path and
reading alike, and preserves a linear law between them. It blurs the instants at which a contact
begins and ends, which tell a delayed sensor from a stamp delay, and a delay from a smooth response:
estimates and rivals are those of a fit to the whole record.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Fit, inflation, null_fit, refit, refit_without
from hiltestbed.diagnosis.heldout import placebo_of
from hiltestbed.diagnosis.links import LinkRun, WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation, first_of_each, with_rivals
from hiltestbed.diagnosis.settings import CLOSE_CHI2, MAX_PARTNERS
from hiltestbed.frames import Array
from hiltestbed.scenario import resolved, scenario_from

# calibrated: share of the reduction in chi-square that decimation may change; ten times the largest
# seen (1.2e-5)
DECIMATION_ERROR = 1e-4

MIN_ROWS = 3000  # chosen: of all runs together, that are always kept
# chosen: share of the departure from the nominal model that may lie between the blocks
MAX_LOSS = 0.02


def decimated(link: WrenchLink) -> WrenchLink:
    """The same link on means of 2, 4, ... rows; itself where that would lose too much. The noise is
    not lowered.

    Links that are simulated or filtered depend on every tick, and are not decimated. The signal
    lost between the blocks is estimated from whole residual there, less the known share of white
    noise.
    """
    rows = sum(len(p) for p in link.paths)
    count = 1
    if rows >= 2 * MIN_ROWS and not link.simulated and link.logged is None:
        rms = _rms(link, link.shown_in_all())
        while rows >= 2 * count * MIN_ROWS and _lost(link, 2 * count) < MAX_LOSS * rms:
            count *= 2
    if count == 1:
        return link
    out = WrenchLink(
        [_run(r, count) for r in link.runs],
        [_means(p, count) for p in link.paths],
        None,
        link.rates and [_means(r, count) for r in link.rates],
    )
    out.of_rows = count
    return out.interpreted(lever=link.lever, blunt=link.blunt, ring=link.ring)


def _rms(link: WrenchLink, modelled: list[Array]) -> float:
    """Rms of the measured readings less `modelled`, in units of their noise."""
    counted = [np.isfinite(r.sigma) for r in link.runs]
    left = [
        ((r.measured - m) / r.sigma)[c]
        for r, m, c in zip(link.runs, modelled, counted, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


def _lost(link: WrenchLink, count: int) -> float:
    """Rms of the signal between blocks of ``count`` rows, in units of the noise, less its share."""
    between = _rms(link, [_between(r.measured, count) for r in link.runs])
    white = np.eye(8 * count)
    own = float(np.mean(np.sum((white - _between(white, count)) ** 2, axis=1)))
    return math.sqrt(max(between**2 - own, 0.0))


def _means(values: Array, count: int) -> Array:
    """(N // count, ...) means of blocks of rows."""
    whole = len(values) // count
    return np.ascontiguousarray(
        values[: whole * count].reshape(whole, count, *values.shape[1:]).mean(axis=1)
    )


def _between(values: Array, count: int) -> Array:
    """(N, C) linear interpolation between the means of blocks."""
    means = _means(values, count)
    centres = np.arange(len(means)) * count + 0.5 * (count - 1)
    rows = np.arange(len(values))
    return np.column_stack([np.interp(rows, centres, column) for column in means.T])


def _run(run: LinkRun, count: int) -> LinkRun:
    rate = run.scenario.rate / count
    sigma = _means(run.sigma, count)  # infinite where one of the rows was not measured
    touching = _means(run.touching[:, None].astype(float), count)[:, 0] > 0.0
    scenario = scenario_from(resolved(run.scenario) | {"rate": rate})
    terms = [None if x is None else _means(x, count) for x in (run.nuisances, run.shared)]
    measured = _means(run.measured, count)
    return LinkRun(scenario, measured, sigma, touching, run.heavy, run.tail, *terms)


def _score(f: Fit) -> float:
    return f.score


def refit_on_all_rows(found: Explanation, link: WrenchLink) -> Explanation:
    """The fits near ``found``, fitted again on ``link``; ``found`` where they leave too much."""
    chosen = found.chosen
    if not (found.departs and found.adequate and chosen.causes) or JITTER in chosen.kinds:
        return found
    residual = Residual(link).downweighted(chosen.effects())
    alike = [f for f in (*found.singles, *found.more) if len(f.causes) == len(chosen.causes)]
    pool = sorted(alike, key=_score)
    within = CLOSE_CHI2 * inflation(chosen) + DECIMATION_ERROR * (found.null.chi2 - chosen.chi2)
    near = [
        f
        for f in first_of_each(pool, "key")
        if f.score - chosen.score < within and JITTER not in f.kinds
    ]
    fits = sorted((refit(residual, f) for f in near[:MAX_PARTNERS] or [chosen]), key=_score)
    best = fits[0]
    leftovers = contact_leftovers(residual, best.effects())
    if not noise_alone(leftovers):
        return found
    several = range(len(best.causes)) if len(best.causes) > 1 else ()
    fewer = [refit_without(residual, best, i) for i in several]
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
