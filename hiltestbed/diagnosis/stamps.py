"""Stage "select": stamps that computed links show: they have no noise of their own, so that what
follows exactly is stamped so.

A linear compensation of readings that lie between rows lies between its own rows; the numerical
model, whose start is known, drifts from its command where its input is late. The links that are
measured are then explained under the stamps that these show. A wrench_meas that is stamped late
shows in compensation and contact together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.adequacy import Leftover
from hiltestbed.diagnosis.fit import BOUND_TOLERANCE, Fit, fit, inflation, null_fit, refit
from hiltestbed.diagnosis.jitter_and_hum import JITTER
from hiltestbed.diagnosis.layout import DatasetLayout
from hiltestbed.diagnosis.links import CompensationLink, LinkRun, ModelLink, Timing, WrenchLink
from hiltestbed.diagnosis.links.base import NO_SHIFT
from hiltestbed.diagnosis.noise import OUTLIER_SIGMA
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation, Search
from hiltestbed.diagnosis.settings import DETECTION
from hiltestbed.diagnosis.timing import (
    EARLY,
    EITHER,
    LINK_CHANNELS,
    MAX_STAMP_ROWS,
    MAX_UNNAMED_DELAY_ROWS,
    fit_with_timing,
    shift_candidate,
    timing_candidates,
    without_ends,
)
from hiltestbed.effects.log import log_parameters
from hiltestbed.effects.table import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.replay.wrench import shifted

# chosen: share of a stamp delay's chi-square in the compensation, which interpolation between rows
# may leave
MAX_SKEW_RESIDUAL = 0.2

MIN_STAMP_ROWS = 1e-4  # chosen: by which a channel is stamped off: less is round-off
# derived: of what a computed channel may leave; one that does not follow exactly leaves 1, its own
# noise, or more
MAX_EXACT_VARIANCE = 0.5


def exactly_stamped(residual: Residual, search: Search) -> Residual | None:
    """The compensation with stamps of output and input that leave next to nothing; None where there
    are none, or it is not linear.

    What was interpolated between rows follows exactly only with the same interpolation, and a
    linear compensation commutes with it: no other explanation leaves nothing. Whole rows by which
    both stamps are off do not show: the smallest stamps are taken, and none where both are whole,
    since either may be off. An input that is later than stamps may be is `log.skew`.
    """
    link, tick = residual.link, residual.link.tick
    memory = link.memory() if isinstance(link, CompensationLink) else None
    if memory is None:
        return None
    there = without_ends(residual, round(memory / tick))  # of what came before the record
    null = null_fit(there)
    if null.chi2 < DETECTION:
        return None
    late_input = shift_candidate(link, {"before": EARLY})
    both, alone = _both_stamps(there, null), fit_with_timing(there, null, late_input)
    late, early, least = (
        (0.0, alone.theta[0] / tick, alone.chi2) if alone.chi2 < both[2] + DETECTION else both
    )
    if square(there([Timing(delay=round(late + early) * tick)])) < least + DETECTION:
        return None
    whole = (
        min((round(late), round(-early)), key=lambda n: max(abs(late - n), abs(early + n)))
        if late
        else 0
    )
    if early + whole < -MAX_UNNAMED_DELAY_ROWS:
        return None
    stamps = Timing(delay=(late - whole) * tick, before=(early + whole) * tick)
    placed = Residual(link.with_timing(link.timing.plus(stamps)), there.runs, there.weight)
    return placed if exact(search.judge(placed, ())) else None


def _both_stamps(residual: Residual, null: Fit) -> tuple[float, float, float]:
    """Rows by which output and input of a link are stamped late and early, and chi-square: whole
    rows are tried beside what a fit finds, since chi-square has a kink there.
    """
    link, tick = residual.link, residual.link.tick
    both = shift_candidate(link, {"delay": EITHER, "before": EITHER})
    found = fit_with_timing(residual, null, both)
    tried = [(*(found.theta / tick), found.chi2)]
    for j in range(2):
        rows = float(round(found.theta[j] / tick))
        other = fit(residual, (both.held(j, rows * tick),), [found.theta[[1 - j]]], tries=1)
        shifts = np.insert(other.theta / tick, j, rows)
        tried.append((float(shifts[0]), float(shifts[1]), other.chi2))
    return min(tried, key=lambda t: t[2])


def exact(leftovers: Mapping[str, Leftover]) -> bool:
    """Whether a computed channel follows exactly: it leaves less than its own noise."""
    return bool(leftovers) and all(
        left.variance < MAX_EXACT_VARIANCE for left in leftovers.values()
    )


def only_late_record(explanations: Mapping[str, Explanation]) -> bool:
    """Whether nothing departs but a part of a row by which wrench_meas is stamped late."""
    links = {name: e.residual.link for name, e in explanations.items()}
    if "compensation" not in links or any(e.departs for e in explanations.values()):
        return False
    others = [link.timing for name, link in links.items() if name not in ("compensation", "wrench")]
    timing = links["compensation"].timing
    return (
        timing.before < 0.0
        and timing == Timing(before=timing.before)
        and all(other == NO_SHIFT for other in others)
    )


def stamps_known(explanations: Mapping[str, Explanation]) -> dict[str, float]:
    """Channel to the time [s] by which it is stamped late, for those of which links without noise
    show it; empty where none is off.

    The compensation shows what its two channels have between them; the numerical model, whose start
    is known, shows the command's.
    """
    out = {}
    for name, e in explanations.items():
        if name in ("compensation", "dynamics") and e.adequate:
            output, given = LINK_CHANNELS[name]
            tick, timing = e.residual.link.tick, e.residual.link.timing
            for channel, late in ((given, -timing.before), (output, timing.delay)):
                out.setdefault(channel, late if abs(late) > MIN_STAMP_ROWS * tick else 0.0)
    return out if any(out.values()) else {}


def rows_in_common(stamps: Mapping[str, float], tick: float) -> list[int]:
    """Whole rows, 0 first, by which all channels may be stamped later than by ``stamps`` [s]."""
    most = (MAX_STAMP_ROWS + MIN_STAMP_ROWS) * tick
    return [
        0,
        *(n for n in (1, -1) if all(abs(late + n * tick) <= most for late in stamps.values())),
    ]


def least_left(links: Sequence[ModelLink]) -> int:
    """The index of the computed link of which least is left under its best timing: 0 unless another
    leaves clearly less.

    Its output follows exactly, so that less than a single sample's rounding tells them apart.
    """

    def left(link: ModelLink) -> float:
        residual = without_ends(Residual(link))
        null = null_fit(residual)
        return min(
            [
                null.chi2,
                *(fit_with_timing(residual, null, place).chi2 for place in timing_candidates(link)),
            ]
        )

    chi2 = [left(link) for link in links]
    least = int(np.argmin(chi2))
    return least if chi2[least] < min(chi2[0] - 1.0, 0.5 * chi2[0]) else 0


def stamped_late(
    layout: DatasetLayout, link: WrenchLink, compensation: Explanation | None
) -> list[Fit]:
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
    """Whether the causes fit better with the interpretation of `other` for a late record."""
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
    most = OUTLIER_SIGMA * np.where(np.isfinite(run.sigma), run.sigma, 0.0)
    return in_time + shifted(np.clip(run.measured - modelled, -most, most), float(ticks))


def without_end(run: LinkRun, ticks: int) -> LinkRun:
    """Without the last rows: the loop's last readings were stamped after the end of the record."""
    sigma = run.sigma.copy()
    sigma[len(sigma) - ticks :] = np.inf
    return replace(run, sigma=sigma)
