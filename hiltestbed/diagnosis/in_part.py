"""Stage "decide": which causes of an explanation hold although more than noise is left.

A stand-in for an effect outside the vocabulary fits only the runs that it was fitted to: its size
differs from run to run, it does not carry over to left-out runs, it varies with the duration of a
run or with the force, it ends at a bound of its search, or other effects do as well in its place.
None of this is true of a cause, whose size is a constant of the rig: a mass that stands in for drag
is larger in longer runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from hiltestbed.diagnosis.adequacy import JITTER, contact_leftovers, noise_alone
from hiltestbed.diagnosis.fit import Bounds, Fit, at_bound, fit, inflation, refit_without
from hiltestbed.diagnosis.grow import log_heldout_rms
from hiltestbed.diagnosis.intervals import derivatives_by_run
from hiltestbed.diagnosis.links import LinkRun
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.search import Explanation, Search, first_of_each
from hiltestbed.diagnosis.settings import (
    AMBIGUITY,
    MAX_PARTNERS,
    MIN_EXPLAINED,
    MIN_HELDOUT_GAIN_IN_PART,
    MIN_RUN_SHARE,
    SMOOTHING_ROWS,
)
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

# chosen: share of a cause's size by which it may differ from run to run where something else acts
# as well
MAX_SIZE_SPREAD = 0.15
# chosen: share of a cause's gain in chi-square, within which another effect is a rival
RIVAL_MARGIN = 0.1

MIN_RUNS = 3
MIN_LONG_RUNS = 2  # of which each holds many independent stretches
# chosen: of a cause, at which its fit to a run alone starts: well beyond what may differ from run
# to run
START_SIZES = (1.0, 0.7, 1.4)
# chosen: relative change of a size per unit of a condition; of a stand-in about 1, the share of it
# in a size
MIN_VARIATION = 0.25
# calibrated: of what is left, that a varying size explains: 16 causes up to 19 %, five stand-ins 27
# to 90 %, others less
MIN_SHARE = 0.25
# chosen: standard deviation of a condition between rows, below which it does not vary
MIN_CONDITION_SPREAD = 0.03


def holding(found: Explanation) -> tuple[int, ...]:
    """Indices of the causes of the chosen fit that hold; none where there are too few runs."""
    if not _enough_evidence(found):
        return ()
    alone = in_each_run(found)
    same = [
        i
        for i in range(len(found.chosen.causes))
        if _same_size(found, alone, i) and not _varies(found, i)
    ]
    return tuple(i for i in same if _worthwhile_without_rival(found, i))


def confirmed(found: Explanation) -> Explanation | None:
    """The explanation with its rivals, if each cause has the same size in most runs and carries
    over to left-out runs; else None.

    An explanation of so many causes can leave only noise by chance, but stand-ins do not pass these
    tests.
    """
    if not found.adequate or not _enough_evidence(found):
        return None
    alone, residual, chosen = in_each_run(found), found.residual, found.chosen
    fewer, rivals = [], []
    for i, cause in enumerate(chosen.causes):
        rest = refit_without(residual, chosen, i)
        if not _same_size(found, alone, i) or not _improves_heldout(found, rest):
            return None
        near = chosen.score + AMBIGUITY * inflation(chosen)
        others = _replacements(found, residual, rest, cause.kind)
        best = min(others, key=lambda f: f.score, default=chosen)
        if best.score < chosen.score:
            return confirmed(replace(found, chosen=best)) if _leaves_noise(residual, best) else None
        close = [f for f in others if f.score < near]
        rivals.append(
            tuple(first_of_each([f for f in close if _leaves_noise(residual, f)], "kinds"))
        )
        fewer.append(rest)
    known = replace(found, rivals=tuple(rivals), more=(*found.more, *fewer))
    return known.with_the_other_clock(contact_leftovers)


def _leaves_noise(residual: Residual, found: Fit) -> bool:
    return noise_alone(contact_leftovers(residual, found.effects()))


def _enough_evidence(found: Explanation) -> bool:
    """Whether there are enough runs, and enough of the departure is explained on left-out ones."""
    few = len(found.residual.runs) < _least(found) or not found.chosen.causes
    return not few and JITTER not in found.chosen.kinds and explained(found) >= MIN_EXPLAINED


def in_each_run(found: Explanation) -> list[list[Fit]]:
    """For each run alone, the fits of the chosen causes that are as good as the best.

    They start from the chosen sizes, and from smaller and larger ones. The fit to all runs is among
    them unchanged: in a run that hardly separates two causes each start ends elsewhere in a long
    valley, and none where it began.
    """
    out, chosen = [], found.chosen
    for i in found.residual.runs:
        run = found.residual.on([i])
        left = run(chosen.effects())
        fits = [replace(chosen, chi2=square(left), residual=left)]
        fits += [fit(run, chosen.causes, [_resized(chosen, size)], tries=1) for size in START_SIZES]
        best = min(fits, key=lambda f: f.chi2)
        out.append([f for f in fits if f.chi2 <= best.chi2 + AMBIGUITY * inflation(best)])
    return out


def _resized(chosen: Fit, size: float) -> Array:
    """The parameters of a fit with each cause ``size`` times as large."""
    theta = chosen.theta.copy()
    for i, cause in enumerate(chosen.causes):
        at = [chosen.place(i).start + j for j in _leading(cause)]
        theta[at] = _neutral(cause) + size * (theta[at] - _neutral(cause))
    return theta


def _leading(cause: Candidate) -> list[int]:
    """The indices of a cause's parameters that are its size."""
    return [
        j for j, name in enumerate(cause.names) if name.partition(".")[0] == cause.effect.leading
    ] or list(range(len(cause.names)))


def _neutral(cause: Candidate) -> float:
    return 1.0 if cause.effect.leading == "factor" else 0.0


def _same_size(found: Explanation, alone: list[list[Fit]], index: int) -> bool:
    chosen = found.chosen
    return not at_bound(chosen.causes[index], chosen.part(index)) and same_in_each(
        chosen, alone, index, _least(found)
    )


def _varies(found: Explanation, index: int) -> bool:
    cause = found.chosen.causes[index]
    return varies(found.residual, found.chosen, index, _leading(cause), _neutral(cause))


def _least(found: Explanation) -> int:
    return MIN_LONG_RUNS if found.residual.link.witnesses else MIN_RUNS


def explained(found: Explanation) -> float:
    """Share of the departure that the chosen fit explains on left-out runs, in mean square."""
    before, after = (
        math.exp(2.0 * log_heldout_rms(found.residual, f)) - 1.0 for f in (found.null, found.chosen)
    )
    return 1.0 - max(after, 0.0) / before if before > 0.0 else 0.0


def same_in_each(chosen: Fit, alone: list[list[Fit]], index: int, least: int) -> bool:
    """Whether most runs alone, and at least ``least``, give a cause the size that it has in all
    runs.

    A run that any size fits equally well is not counted.
    """
    cause = chosen.causes[index]
    leading, neutral = _leading(cause), _neutral(cause)
    size = chosen.part(index)[leading] - neutral
    scale = float(np.linalg.norm(size))
    if not leading or scale == 0.0:
        return False

    def near(f: Fit) -> bool:
        off = float(np.linalg.norm(f.part(index)[leading] - neutral - size))
        return off <= MAX_SIZE_SPREAD * scale

    off = [[near(f) for f in fits] for fits in alone]
    same, other = sum(map(all, off)), sum(not any(each) for each in off)
    return same >= max(least, MIN_RUN_SHARE * (same + other))


def _worthwhile_without_rival(found: Explanation, index: int) -> bool:
    """Whether a cause carries over to left-out runs, and no other effect does as well."""
    residual, chosen = found.residual, found.chosen
    fewer = refit_without(residual, chosen, index)
    if not _improves_heldout(found, fewer):
        return False
    margin = max(AMBIGUITY * inflation(chosen), RIVAL_MARGIN * (fewer.chi2 - chosen.chi2))
    return not any(
        rival.score < chosen.score + margin
        for rival in _replacements(found, residual, fewer, chosen.causes[index].kind)
    )


def _improves_heldout(found: Explanation, fewer: Fit) -> bool:
    """Whether the chosen fit leaves enough less on left-out runs than with ``fewer`` causes."""
    return (
        log_heldout_rms(found.residual, fewer) - log_heldout_rms(found.residual, found.chosen)
        >= MIN_HELDOUT_GAIN_IN_PART
    )


def _replacements(found: Explanation, residual: Residual, fewer: Fit, kind: str) -> list[Fit]:
    others = tuple(c for c in found.candidates if c.kind != kind)
    return Search(others).extend(residual, fewer, MAX_PARTNERS)


def varies(residual: Residual, chosen: Fit, index: int, sizes: list[int], neutral: float) -> bool:
    """Whether the size of a cause depends on a condition: a size in proportion to it, beside all
    parameters, explains much of what is left.

    Args:
        chosen: the fit. index: of the cause. sizes: its parameters in `Fit.part` that are its size.
            neutral: their value without it.
    """
    by_run = derivatives_by_run(residual, chosen)
    left, jacobian = (np.concatenate(parts) for parts in zip(*by_run, strict=True))
    place, scale = chosen.place(index), Bounds.of(chosen.causes).scales(chosen.theta)
    relative = ((chosen.part(index)[sizes] - neutral) / scale[place][sizes])[:, None]
    # of the misfits, by the size relative to itself
    by_size = (jacobian[:, place][:, sizes] @ relative)[:, 0]
    weight = by_size**2
    if not weight.any():
        return False
    basis = np.linalg.qr(jacobian)[0]
    rest = _beside(basis, left)
    for condition in conditions(
        [residual.link.runs[i] for i in residual.runs], [len(r) for r, _ in by_run]
    ):
        offset = condition - np.average(condition, weights=weight)
        if np.sqrt(np.average(offset**2, weights=weight)) < MIN_CONDITION_SPREAD:
            continue
        varied = _beside(basis, by_size * offset)
        square = float(varied @ varied)
        # least squares beside all parameters
        change = -float(varied @ rest) / square if square > 0.0 else 0.0
        if change**2 * square > MIN_SHARE * float(left @ left) and abs(change) > MIN_VARIATION:
            return True
    return False


def conditions(runs: Sequence[LinkRun], rows: Sequence[int]) -> list[Array]:
    """(M,) of each condition at the misfits of runs, of which each has so many as ``rows`` says:
    the logarithms of the duration of the run, of that of its contacts and of its largest reading; 1
    in contact, 0 outside; the time, from 0 to 1; the way of the motion, 1 or -1.
    """
    of_run = [
        [float(np.log(len(r.measured))) for r in runs],
        [float(np.log(max(1, np.count_nonzero(r.touching)))) for r in runs],
        [float(np.log(max(np.abs(r.measured).max(initial=0.0), 1e-300))) for r in runs],
    ]
    of_row = [
        [r.touching.astype(float) for r in runs],
        [np.linspace(0.0, 1.0, len(r.measured)) for r in runs],
        [_way(r.measured) for r in runs],
    ]
    channels = [r.measured.shape[1] for r in runs]
    expanded = [
        np.concatenate([np.repeat(x, c) for x, c in zip(parts, channels, strict=True)])
        for parts in of_row
    ]
    return [np.repeat(values, rows) for values in of_run] + expanded


def _way(measured: Array) -> Array:
    """(N,) sign of the change of the channel that changes most."""
    most = measured[:, int(np.argmax(np.ptp(measured, axis=0)))]
    return np.sign(np.gradient(uniform_filter1d(most, SMOOTHING_ROWS)))


def _beside(basis: Array, column: Array) -> Array:
    """(M,) the part of a column (M,) that is orthogonal to a basis (M, P)."""
    return np.asarray(column - basis @ (basis.T @ column), dtype=np.float64)
