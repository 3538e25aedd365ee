"""Stage "select": which causes to fit beside those found: the reduction of chi-square by each
candidate, linearised at its starts.

Takes a `Residual`, a `Fit` and the candidates; gives them in the order in which they are worth a
fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hiltestbed.diagnosis.fit import Bounds, Fit, Trials, inflation, telling
from hiltestbed.diagnosis.links.base import Effects
from hiltestbed.diagnosis.residual import Residual, square
from hiltestbed.diagnosis.settings import MIN_LINEAR_GAIN
from hiltestbed.effects.search import Candidate
from hiltestbed.frames import Array

# largest reduction of chi-square, linearised at each start, and the starts worth a descent
Rated = tuple[float, Candidate, list[Array]]

# chosen: chi-square per sample, above which the share that a candidate explains in a few runs is
# not chance
LARGE_DEPARTURE = 2.0
RATED_PER_FIT = 4  # chosen: candidates that are rated on all runs, of each that is fitted


def rate(residual: Residual, base: Fit, candidates: Sequence[Candidate], most: int) -> list[Rated]:
    """The candidates that gain more than noise beside ``base``, best first.

    Where a replay is costly, a few runs tell. How much of a large departure a candidate alone
    explains there counts for all runs, since many are fitted; beside other causes they decide which
    candidates are rated on all, ``most`` being fitted.
    """
    tried = [(c, [Bounds.of((c,)).clip(s) for s in c.grid]) for c in candidates]
    runs = telling(residual, base.residual) if residual.link.costly else residual.runs
    if len(runs) < len(residual.runs) and (base.causes or inflation(base) > LARGE_DEPARTURE):
        few = _on(residual, base, runs)
        first = _rated(residual.on(runs), few, tried)
        if not base.causes:
            return [(gain * base.chi2 / few.chi2, c, starts) for gain, c, starts in first]
        tried = [(c, starts) for _, c, starts in first[: RATED_PER_FIT * most]]
    return _rated(residual, base, tried)


def _on(residual: Residual, base: Fit, runs: Sequence[int]) -> Fit:
    """The same fit on some of its runs."""
    parts = residual.parts()
    r = np.concatenate([base.residual[parts[i]] for i in runs])
    return replace(
        base,
        residual=r,
        chi2=square(r),
        jacobian=np.concatenate([base.jacobian[parts[i]] for i in runs]),
    )


def _rated(
    residual: Residual, base: Fit, tried: Sequence[tuple[Candidate, Sequence[Array]]]
) -> list[Rated]:
    """The candidates that gain more than noise does, best first, with the best of their starts."""
    basis, known = _orthonormal(base.jacobian), base.effects()
    trials = [([*known, c.at(theta)], bool(c.names)) for c, starts in tried for theta in starts]
    scored = _scored(residual, base, basis, trials)
    r = _without(basis, base.residual)
    out: list[Rated] = []
    at = 0
    for c, starts in tried:
        gains, lefts = scored[at : at + len(starts), 0], scored[at : at + len(starts), 1]
        at += len(starts)
        best = float(gains.max())
        order = list(dict.fromkeys([int(gains.argmax()), *np.argsort(lefts)[:3].tolist()]))
        if c.vector or (len(starts) == 1 and len(c.names)):
            best = max(best, _by_slopes(residual, known, basis, r, c, starts[int(lefts.argmin())]))
        if best > MIN_LINEAR_GAIN * inflation(base) * 0.5:
            out.append((best, c, [starts[i] for i in order]))
    return sorted(out, key=lambda item: -item[0])


def _scored(
    residual: Residual, base: Fit, basis: Array, tried: Sequence[tuple[Effects, bool]]
) -> Array:
    """``(H, 2)`` of each trial: reduction of chi-square beside ``base``, as it stands or along its
    direction; chi-square it leaves.

    tried: with whether it has a size that can be fitted; a number of whole ticks has none, and
        gains only as it stands.
    """
    out = np.empty((len(tried), 2))
    r = _without(basis, base.residual)
    chunk = max(1, 40_000_000 // (8 * max(1, len(base.residual))))
    for start in range(0, len(tried), chunk):
        for h, moved in enumerate(
            residual.many([effects for effects, _ in tried[start : start + chunk]]), start
        ):
            left = square(moved)
            d = _without(basis, moved - base.residual)
            length, along = square(d), float(np.einsum("m,m->", r, d))
            gain = (
                (along**2 / length if tried[h][1] else -2.0 * along - length)
                if length > 0 and along < 0
                else 0.0
            )
            out[h] = max(base.chi2 - left, gain), left
    return out


def _by_slopes(
    residual: Residual, known: Effects, basis: Array, r: Array, c: Candidate, theta: Array
) -> float:
    """Reduction of chi-square by all parameters of `c` together, from the slopes at theta."""
    trials = Trials(residual, (c,), known)
    columns = trials.slopes(theta, trials([theta])[0])
    q = _orthonormal(np.column_stack([_without(basis, column) for column in columns.T]))
    return float(np.sum(np.einsum("mi,m->i", q, r) ** 2))


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis of the span of the columns (M, P), without dependent ones."""
    if columns.shape[1] == 0:
        return columns
    length = np.sqrt(np.einsum("mi,mi->i", columns, columns))
    q, r = np.linalg.qr(columns / np.where(length > 0.0, length, 1.0))
    return q[:, np.abs(np.diag(r)) > 1e-6]


def _without(basis: Array, r: Array) -> Array:
    """r less its projection on the basis (M, Q); by einsum, since BLAS threads wait for each other
    on a busy machine.
    """
    return r - np.einsum("mi,i->m", basis, np.einsum("mi,m->i", basis, r)) if basis.shape[1] else r
