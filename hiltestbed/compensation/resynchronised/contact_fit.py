"""The delay of the force and the law of the contact, fitted together.

During a contact c absorbs an error of the delay: the force of k x + c v, taken for one that acted
a little earlier or later, is that of c +- k times the error. The touch is not absorbed: with it the
force sets in, with c v at depth zero. All samples from before the touch until now are therefore one
least-squares problem; it is linear in the columns of the law, and the delay and the touch point are
searched. The laws, the simpler first::

    F = k x + c v
    F = k x + c v + e x v               e: damping that grows with the depth
    F = k x + c v + e x v + s (x - a)   s: a stop beyond the depth a, for x > a

(the second: K. Hunt, F. Crossley, J. Appl. Mech. 42, 1975). No coefficient is negative. What the
user has told stands until the samples refuse it: a free delay and each further column must lower
the chi-square by more than REFUSED.

Beyond the noise, what replaces them has to explain EXPLAINED of the misfit: a delay that jitters
makes a misfit at the touch that some other delay or law always makes a little smaller.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array
from hiltestbed.sensor.chain import FILTERED, filtered

COLUMNS = 4
LAWS = np.array([2, 3, 4])  # columns of each law
CERTAIN = 3.84  # rise of chi-square at the ends of a 95 % interval of one parameter
REFUSED = 9.0  # fall of chi-square: three standard deviations of one parameter
EXPLAINED = 0.9  # share of the misfit beyond the noise: what is left then changes c by a third
TOUCH_SD = 5e-5  # [m] of the touch point of a known or flat surface: that of a good alignment
DELAY_SD = 0.3  # of the told delay: what facilities report for an amplifier or a bus not measured
NARROW, WIDE = 0.4, 2.5  # times the told delay: searched
DELAYS, TOUCHES, KNOTS = 60, 17, 7  # points searched
SHALLOW, DEEP = 0.3, 0.95  # of the depth so far, between which a stop is searched
BEFORE = 6  # [ticks] before the first force that any delay could have, still in the window
LATE = 4  # [ticks] before the first force that exceeds the noise, in which the touch is searched
GROWTH = 1.25  # samples of a contact at the next fit, over those at the last
RESOLUTION = 0.01  # [ticks] of the delay
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Columns of a solution.
DELAY, POINT, KNOT, CHI, SPREAD, SOLUTION = range(6)


class ContactWindow(NamedTuple):
    """A contact so far, at ticks, ``(n,)``.

    s, u: position [m] and rate [m/s] along the gradient. y: force as read [N]. variance: of its
    noise [N^2]. first: the first sample that counts. felt: the first that exceeds the noise.
    substeps: in a tick, between which the sensor interpolates. held: whether the rate is constant
    within a tick. smooth, leak: (2,) of the sensor's filters. told: [ticks]. expected: [m] touch
    point.
    """

    s: Array
    u: Array
    y: Array
    variance: float
    first: int
    felt: int
    substeps: float
    held: bool
    smooth: Array
    leak: Array
    told: float
    expected: float


@njit(cache=True)
def columns(m, delay, touch, knot, rows):
    """The law's columns as a sensor with the delay [ticks] shows them, into ``rows`` (n, 4)."""
    n = m.s.shape[0]
    memory = np.zeros((COLUMNS, FILTERED))
    x, v = np.empty(2), np.empty(2)
    for i in range(m.first, n):
        at = (i - delay) * m.substeps
        early = math.floor(at)
        for e in range(2):
            t = (early + e) / m.substeps
            j = min(max(int(math.ceil(t - 1e-9)), 1), n - 1)
            part = t - (j - 1)
            x[e] = m.s[j - 1] + part * (m.s[j] - m.s[j - 1]) - touch
            v[e] = m.u[j] if m.held else m.u[j - 1] + part * (m.u[j] - m.u[j - 1])
            if x[e] <= 0.0:
                x[e], v[e] = 0.0, 0.0
        part, row = at - early, rows[i]
        row[0] = (1.0 - part) * x[0] + part * x[1]
        row[1] = (1.0 - part) * v[0] + part * v[1]
        row[2] = (1.0 - part) * x[0] * v[0] + part * x[1] * v[1]
        row[3] = (1.0 - part) * max(x[0] - knot, 0.0) + part * max(x[1] - knot, 0.0)
        for c in range(COLUMNS):
            row[c] = filtered(row[c], m.smooth, m.leak, memory[c])


@njit(cache=True)
def chi_square(m, used, trial, rows, law):
    """Chi-square of the samples and of what was told, with the best law of ``used`` columns.

    trial: (SOLUTION,) delay, touch point and knot; CHI is written. law: (4,) coefficients, out.
    """
    columns(m, trial[DELAY], trial[POINT], trial[KNOT], rows)
    a, b = np.zeros((used, used)), np.zeros(used)
    total = 0.0
    for i in range(m.first, m.s.shape[0]):
        y = m.y[i]
        for c in range(used):
            b[c] += rows[i, c] * y
            for d in range(c + 1):
                a[c, d] += rows[i, c] * rows[i, d]
        total += y * y
    law[:] = 0.0
    told = (trial[DELAY] / m.told - 1.0) / DELAY_SD
    point = (trial[POINT] - m.expected) / TOUCH_SD
    left = (total - _explained(a, b, law[:used])) / m.variance
    trial[CHI] = left + told * told + point * point


@njit(cache=True)
def _explained(a, b, x):
    """``b.x``, where x >= 0 solves the normal equations ``a x = b``, by Cholesky; a column that
    would be negative, or that the others make up, is left out.
    """
    n = b.shape[0]
    taken = np.ones(n, dtype=np.bool_)
    l, z = np.zeros((n, n)), np.zeros(n)
    while True:
        out = 0.0
        for c in range(n):
            x[c], z[c] = 0.0, 0.0
            l[c, :] = 0.0
            if not taken[c]:
                continue
            for d in range(c):
                rest = a[c, d]
                for e in range(d):
                    rest -= l[c, e] * l[d, e]
                l[c, d] = rest / l[d, d] if l[d, d] > 0.0 else 0.0
            pivot, rest = a[c, c], b[c]
            for e in range(c):
                pivot -= l[c, e] * l[c, e]
                rest -= l[c, e] * z[e]
            if pivot > 1e-8 * a[c, c] and a[c, c] > 0.0:
                l[c, c] = math.sqrt(pivot)
                z[c] = rest / l[c, c]
                out += z[c] * z[c]
        worst, least = -1, 0.0
        for c in range(n - 1, -1, -1):
            if l[c, c] > 0.0:
                rest = z[c]
                for e in range(c + 1, n):
                    rest -= l[e, c] * x[e]
                x[c] = rest / l[c, c]
                if x[c] * math.sqrt(a[c, c]) < least:
                    worst, least = c, x[c] * math.sqrt(a[c, c])
        if worst < 0:
            return out
        taken[worst] = False


@njit(cache=True)
def _at(m, used, loose, delay, rows, law, best):
    """The best touch point, if ``loose``, and knot for a delay, into ``best`` (SOLUTION,)."""
    n = m.s.shape[0]
    trial = np.zeros(SOLUTION)
    trial[DELAY], trial[POINT] = delay, m.expected
    deepest = 0.0
    for j in range(m.first, n):
        deepest = max(deepest, m.s[max(int(j - delay), 0)] - m.expected)
    best[CHI] = np.inf
    for p in range(TOUCHES if loose else 1):
        if loose:
            at = max(m.felt - LATE * p / (TOUCHES - 1) - delay, 0.0)
            j = min(int(at), n - 2)
            trial[POINT] = m.s[j] + (at - j) * (m.s[j + 1] - m.s[j])
        for q in range(KNOTS if used == COLUMNS else 1):
            trial[KNOT] = (SHALLOW + (DEEP - SHALLOW) * q / (KNOTS - 1)) * deepest
            chi_square(m, used, trial, rows, law)
            if trial[CHI] < best[CHI]:
                best[:] = trial


@njit(cache=True)
def _searched(m, used, loose, rows, law, best):
    """The best delay, into ``best`` (SOLUTION,): a grid, then golden section."""
    trial = np.zeros(SOLUTION)
    least, most = max(NARROW * m.told, 1.0), max(WIDE * m.told, 2.0)
    step = (most - least) / (DELAYS - 1)
    best[CHI] = np.inf
    for p in range(DELAYS):
        _at(m, used, loose, least + step * p, rows, law, trial)
        if trial[CHI] < best[CHI]:
            best[:] = trial
    low, high = max(best[DELAY] - step, least), min(best[DELAY] + step, most)
    while high - low > RESOLUTION:
        one, two = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        _at(m, used, loose, one, rows, law, trial)
        left = trial[CHI]
        if left < best[CHI]:
            best[:] = trial
        _at(m, used, loose, two, rows, law, trial)
        if trial[CHI] < best[CHI]:
            best[:] = trial
        if left < trial[CHI]:
            high = two
        else:
            low = one


@njit(cache=True)
def _centre(m, used, loose, rows, law, best):
    """Move the delay to the middle of its 95 % interval, whose half width is SPREAD: between two
    readings the force may set in at any instant, with the same chi-square.
    """
    trial = np.zeros(SOLUTION)
    limit = best[CHI] + CERTAIN * max(1.0, best[CHI] / degrees(m))
    ends = np.empty(2)
    for e in range(2):
        inside = best[DELAY]
        outside = max(inside - 2.0, 1.0) if e == 0 else inside + 2.0
        while abs(outside - inside) > RESOLUTION:
            _at(m, used, loose, 0.5 * (inside + outside), rows, law, trial)
            if trial[CHI] < limit:
                inside = trial[DELAY]
            else:
                outside = trial[DELAY]
        ends[e] = inside
    _at(m, used, loose, 0.5 * (ends[0] + ends[1]), rows, law, trial)
    if trial[CHI] < limit:
        best[:] = trial
    best[SPREAD] = 0.5 * (ends[1] - ends[0])


@njit(cache=True, inline="always")
def degrees(m):
    """Degrees of freedom of the samples."""
    return max(m.s.shape[0] - m.first - COLUMNS - 2, 1)


@njit(cache=True)
def fit(m, free, rows, law, best):
    """The simplest law and, if the samples refuse the told ones, touch point and, if ``free``,
    delay.

    rows: (n, 4) scratch; on return the columns. law: (4,) coefficients, out. best: (SOLUTION,),
    out. Returns the number of columns.
    """
    laws = LAWS.shape[0]
    found = np.full((laws, 2, 2, SOLUTION), np.inf)  # law, loose touch point, free delay
    dof = degrees(m)
    enough = dof + REFUSED / 3.0 * math.sqrt(2.0 * dof)
    for unknowns in range(laws + 2):
        for j in range(laws):
            for loose in range(2):
                e = unknowns - j - loose
                if e == 0:
                    _at(m, LAWS[j], loose == 1, m.told, rows, law, found[j, loose, 0])
                elif e == 1 and free:
                    _searched(m, LAWS[j], loose == 1, rows, law, found[j, loose, 1])
        if found[:, :, :, CHI].min() <= enough:
            break
    scale = max(1.0, found[:, :, :, CHI].min() / dof)
    misfit = (1.0 - EXPLAINED) * (found[0, 0, 0, CHI] - dof)
    least, law_of, loosened, freed = found[0, 0, 0, CHI] / scale, 0, 0, 0
    for j in range(laws):
        for loose in range(2):
            for e in range(2):
                chi = found[j, loose, e, CHI]
                cost = chi / scale + REFUSED * (j + loose + e)
                if cost < least and (chi <= enough or chi - dof <= misfit):
                    least, law_of, loosened, freed = cost, j, loose, e
    best[:] = found[law_of, loosened, freed]
    if freed == 1:
        _centre(m, LAWS[law_of], loosened == 1, rows, law, best)
    chi_square(m, LAWS[law_of], best, rows, law)
    return LAWS[law_of]
