"""Stage "select": a wrench_meas that is stamped late: what the compensation and the contact
together show of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.fit import BOUND_TOLERANCE, Fit, fit, inflation, null_fit, refit
from hiltestbed.diagnosis.jitter import JITTER
from hiltestbed.diagnosis.layout import Layout
from hiltestbed.diagnosis.links import LinkRun, WrenchLink
from hiltestbed.diagnosis.residual import Residual
from hiltestbed.diagnosis.search import Explanation
from hiltestbed.diagnosis.settings import DETECTION, MAX_NOISE_SIGMA, MAX_SKEW_RESIDUAL
from hiltestbed.diagnosis.stamps import exact
from hiltestbed.diagnosis.timing import MAX_UNNAMED_DELAY_ROWS
from hiltestbed.effects.log import log_parameters
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.replay.wrench import shifted


def stamped_late(layout: Layout, link: WrenchLink, compensation: Explanation | None) -> list[Fit]:
    """The hypotheses of a record that is stamped late, the likelier first; none where the
    compensation shows no late record.

    The compensation determines the delay to a tick. A contact that does not show it may hide it: a
    late reading looks like less damping. There is no estimate within the tick if the compensation
    follows exactly with a row, or if the contact is later still: the record is then as late as the
    compensation shows, and the sensor may be late as well.
    """
    skew = log_parameters(compensation.chosen.effects()).skew if compensation else 0.0
    if compensation is None or not skew:
        return []
    residual = Residual(link)
    candidates = EFFECTS["log.skew"].candidates(replace(layout.scales, late=skew))
    fits = sorted((fit(residual, (c,), c.grid) for c in candidates), key=lambda f: f.chi2)
    stamp = skew <= MAX_UNNAMED_DELAY_ROWS * layout.scales.tick and exact(compensation.leftovers)
    if stamp or fits[0].theta[0] >= (1.0 - BOUND_TOLERANCE) * fits[0].causes[0].high[0]:
        fits = [fit(residual, (c.held(0, skew),), [()]) for f in fits for c in f.causes]
    residual = residual.downweighted(fits[0].effects())
    fits = [refit(residual, f) for f in fits]
    borne_out = null_fit(residual).chi2 - fits[0].chi2 > DETECTION
    if borne_out or compensation.chosen.chi2 < MAX_SKEW_RESIDUAL * compensation.null.chi2:
        return fits
    return []


def other_reading_betters(found: Explanation, other: Fit) -> bool:
    """Whether the chosen causes, the first of which is a late record, fit better with the
    interpretation of `other` for it.
    """
    causes = (*other.causes, *found.chosen.causes[1:])
    if any(c.kind == JITTER for c in causes):
        return False
    again = fit(found.residual, causes, [found.chosen.theta], tries=1)
    return again.chi2 < found.chosen.chi2 - DETECTION * inflation(found.chosen)


def used_readings(run: LinkRun, modelled: Array, in_time: Array, ticks: int) -> Array:
    """(N, 6) the readings that the loop used, of which the record, `run.measured`, was stamped so
    many ticks late.

    modelled: (N, 6) prediction of the record. in_time: of the loop's readings. Only the noise, the
        difference of record and model, is
    shifted: across a touch a reading cannot be interpolated from the rows beside it, and a larger
        difference there is a model error.
    """
    most = MAX_NOISE_SIGMA * np.where(np.isfinite(run.sigma), run.sigma, 0.0)
    return in_time + shifted(np.clip(run.measured - modelled, -most, most), float(ticks))


def without_end(run: LinkRun, ticks: int) -> LinkRun:
    """Without the last rows: the loop's last readings were stamped after the end of the record."""
    sigma = run.sigma.copy()
    sigma[len(sigma) - ticks :] = np.inf
    return replace(run, sigma=sigma)
