"""Stage "select": stamps that computed links show: they have no noise of their own, so that what
follows exactly is stamped so.

A linear compensation of readings that lie between rows lies between its own rows; the numerical
model, whose start is known, drifts from its command where its input is late. The links that are
measured are then explained under the stamps that these show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hiltestbed.diagnosis.adequacy import Leftover
from hiltestbed.diagnosis.fit import Fit, fit, null_fit
from hiltestbed.diagnosis.links import CompensationLink, Link, Timing
from hiltestbed.diagnosis.links.base import NO_SHIFT
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
    link, tick = residual.link, residual.link.runs[0].scenario.tick
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
    link, tick = residual.link, residual.link.runs[0].scenario.tick
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
    """Whether a computed channel follows exactly from its input: it leaves less than its own noise,
    which is no part of the input's.
    """
    return bool(leftovers) and all(
        left.variance < MAX_EXACT_VARIANCE for left in leftovers.values()
    )


def only_late_record(explanations: Mapping[str, Explanation]) -> bool:
    """Whether nothing departs but a part of a row by which wrench_meas is stamped late, as by
    `log.skew`.
    """
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
            tick, timing = e.residual.link.runs[0].scenario.tick, e.residual.link.timing
            for channel, late in ((given, -timing.before), (output, timing.delay)):
                out.setdefault(channel, late if abs(late) > MIN_STAMP_ROWS * tick else 0.0)
    return out if any(out.values()) else {}


def rows_in_common(stamps: Mapping[str, float], tick: float) -> list[int]:
    """Whole rows, 0 first, by which all channels may be stamped later than by ``stamps`` [s], which
    show what they have between them.
    """
    most = (MAX_STAMP_ROWS + MIN_STAMP_ROWS) * tick
    return [
        0,
        *(n for n in (1, -1) if all(abs(late + n * tick) <= most for late in stamps.values())),
    ]


def least_left(links: Sequence[Link]) -> int:
    """The index of the computed link of which least is left under its best timing: 0 unless another
    leaves clearly less.

    Its output follows exactly, so that less than a single sample's rounding tells them apart.
    """

    def left(link: Link) -> float:
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
