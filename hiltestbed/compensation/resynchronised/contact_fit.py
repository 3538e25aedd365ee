"""What the samples of a contact say of the measurement and of the law of the contact, together.

During a contact c absorbs an error of the delay: the force of k x + c v, taken for one that acted
a little earlier or later, is that of c +- k times the error. The touch is not absorbed: with it the
force sets in, with c v at depth zero. All samples from before the touch until now are therefore one
least-squares problem for

    y(t) = low-pass[F(x, v)](t - d(t)) + noise,   d(t) = d0 + r (t - t_felt)
    F = k x + c v + e x v + s (x - a)             in contact, x from the touch point

with e: damping that grows with the depth (K. Hunt, F. Crossley, J. Appl. Mech. 42, 1975), s: a stop
beyond the depth a. No coefficient is negative, and no contact pulls. The low-pass is of first
order, analogue or digital. Instants that scatter make a sample say less where the force changes.

F is linear in k, c, e and s, which are solved for (variable projection: G. Golub, V. Pereyra, SIAM
J. Numer. Anal. 10, 1973); the others are found by Levenberg-Marquardt steps. The force is computed
at steps of the physics, so the step at which it sets in is a whole number, searched beside the
touch point.

Which unknowns there are is a choice between nested models. The simplest, k and c with all else as
told, is compared with those that have one unknown more, the best of these with those that have two,
and so on; the one with the largest evidence wins, in Laplace's approximation (D. MacKay, Neural
Comput. 4, 1992)::

    -2 ln Z = chi^2/f + n ln f + prior + ln det(1 + S J' J S/(f sigma^2))

with the Jacobian J of the n samples, the priors' standard deviations S, and f >= 1, the factor by
which the best fit says that the variance is larger than the noise's. An unknown that the samples do
not show does not pay for its determinant, and stays as told. All models of as many unknowns are as
likely beforehand.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import Array
from hiltestbed.numerical_model.kernels import solve
from hiltestbed.sensor.chain import FILTERED, filtered

# Columns of a solution: the unknowns, LINEAR of them in the law; [N/m, N s/m, ...], positions [m],
# times [ticks]. ONSET: the step of the physics at which the force sets in.
STIFFNESS, DAMPING, DEEPENING, STOP, POINT, DELAY, RATE, LAG, KNOT, UNKNOWNS = range(10)
ONSET, DIGITAL, SCATTER, CHI, COST, SPREAD, SOLUTION = range(UNKNOWNS, UNKNOWNS + 7)
LINEAR = POINT
GROWS = (DELAY, POINT, LAG, DEEPENING, STOP, RATE)  # unknowns beyond k and c
CERTAIN = 3.84  # rise of chi-square at the ends of a 95 % interval of one parameter
ENOUGH = 3.0  # standard deviations of a right model's chi-square: nothing is left to be explained
TOUCH_SD = 5e-5  # [m] of the touch point of a known or flat surface: that of a good alignment
# of the told delay: what facilities report for an amplifier or a bus not measured; also for its
# change over the contact
DELAY_SD = 0.3
# [ticks] time constant of a low-pass with a tenth of the rate as its corner: the lowest that a
# sampled loop is built with
LAG_SD = 10.0 / (2.0 * math.pi)
NARROW, WIDE = 0.4, 2.5  # times the told delay: searched
KNOTS, LAGS = 7, 8  # points searched; of the low-pass from a quarter of a tick by factors of 2
SHALLOW, DEEP = 0.3, 0.95  # of the depth so far, between which a stop is searched
BEFORE = 6  # [ticks] before the first force that any delay could have, still in the window
LEAST_SCATTER, SCATTERS = 1.0 / 32.0, 10  # [ticks] of the instants; searched by factors of 2
LATE = 4  # [ticks] before the first force that exceeds the noise, in which the onset is searched
GROWTH = 1.25  # samples of a contact at the next fit, over those at the last
RESOLUTION = 0.01  # [ticks] of the delay
STEPS = 12  # of Levenberg and Marquardt
DAMP = 1e-3  # first damping of a step, over the diagonal of the normal equations


class ContactWindow(NamedTuple):
    """A contact so far, at steps of the physics, ``(n,)``, and its readings at ticks, ``(r,)``.

    s, u: position [m] and rate [m/s] along the gradient. y: force as read [N]. first: the tick of
    the first reading, from the first step on. variance: of the noise [N^2]. weight: of each
    reading, 1 with that noise. wide: (1,) sum of -ln of the weights. felt: the first tick whose
    force exceeds the noise. substeps: in a tick. lag, digital: [ticks] time constant and kind of
    the told low-pass. leak: (2,) of the sensor's high-pass. told: [ticks]. expected: [m] touch
    point.
    """

    s: Array
    u: Array
    y: Array
    first: int
    variance: float
    weight: Array
    wide: Array
    felt: int
    substeps: int
    lag: float
    digital: float
    leak: Array
    told: float
    expected: float


@njit(cache=True)
def low_pass_of(lag, digital, weights):
    """Weights (2,) of a low-pass of ``lag`` [ticks]: digital, y += (u - y)/(1 + lag), or not."""
    weights[0], weights[1] = 1.0, 0.0
    if digital > 0.0:
        weights[0] = 1.0 / (1.0 + lag)
    elif lag > 0.0:
        a = math.exp(-1.0 / lag)
        b = (1.0 - a) * lag
        weights[0], weights[1] = 1.0 - b, b - a


class Solution(NamedTuple):
    """A solution, in registers; felt, substeps: as in the window; last: step but one."""

    stiffness: float
    damping: float
    deepening: float
    stop: float
    point: float
    delay: float
    rate: float
    knot: float
    onset: float
    felt: int
    substeps: int
    last: int


@njit(cache=True, inline="always")
def _acts(c, step, x, v):
    """1 where a contact pushes, with the coefficients of the last solution, else 0."""
    force = c.stiffness * x + c.damping * v + c.deepening * x * v + c.stop * max(x - c.knot, 0.0)
    return 1.0 if step >= c.onset and force >= 0.0 and (x > 0.0 or v > 0.0) else 0.0


@njit(cache=True, inline="always")
def _at(c, s, u, read):
    """The columns of a reading at the instant ``read`` [ticks]."""
    at = max((read - c.delay - c.rate * (read - c.felt)) * c.substeps, 0.0)
    j = min(int(at), c.last)
    x, v, y, w = s[j] - c.point, u[j], s[j + 1] - c.point, u[j + 1]
    a = (1.0 - (at - j)) * _acts(c, j, x, v)
    b = (at - j) * _acts(c, j + 1, y, w)
    over = a * max(x - c.knot, 0.0) + b * max(y - c.knot, 0.0)
    return a * x + b * y, a * v + b * w, a * x * v + b * y * w, over


@njit(cache=True)
def columns(m, p, used, rows):
    """The law's columns as the sensor shows them with the solution ``p``, into ``rows`` (r, 4)."""
    s, u = m.s, m.u
    law = p[STIFFNESS], p[DAMPING], p[DEEPENING], p[STOP], p[POINT], p[DELAY], p[RATE], p[KNOT]
    c = Solution(*law, p[ONSET], m.felt, m.substeps, s.shape[0] - 2)
    if p[LAG] <= 0.0 and m.leak[0] >= 1.0:
        for r in range(m.y.shape[0]):
            x, v, deep, over = _at(c, s, u, float(m.first + r))
            rows[r, 0], rows[r, 1], rows[r, 2], rows[r, 3] = x, v, deep, over
        return
    # an analogue filter acts between the ticks, too
    times = m.substeps if p[LAG] > 0.0 and p[DIGITAL] == 0.0 else 1
    smooth, leak = np.empty(2), np.empty(2)
    low_pass_of(p[LAG] * times, p[DIGITAL], smooth)
    leak[0] = m.leak[0] ** (1.0 / times)
    leak[1] = m.leak[1] ** (1.0 / times)
    more, memory = used[DEEPENING] or used[STOP], np.zeros((LINEAR, FILTERED))
    for r in range(m.y.shape[0]):
        x, v, deep, over = 0.0, 0.0, 0.0, 0.0
        for back in range(times - 1, -1, -1):
            x, v, deep, over = _at(c, s, u, m.first + r - back / times)
            x = filtered(x, smooth, leak, memory[0])
            v = filtered(v, smooth, leak, memory[1])
            if more:
                deep = filtered(deep, smooth, leak, memory[2])
                over = filtered(over, smooth, leak, memory[3])
        rows[r, 0], rows[r, 1], rows[r, 2], rows[r, 3] = x, v, deep, over


@njit(cache=True)
def misfit(m, p, used, rows):
    """The law's best coefficients for the unknowns in ``p``, and CHI; -2 ln(likelihood prior)."""
    columns(m, p, used, rows)
    a, b = np.zeros((LINEAR, LINEAR)), np.zeros(LINEAR)
    total, last = 0.0, LINEAR if used[DEEPENING] or used[STOP] else DEEPENING
    for i in range(m.y.shape[0]):
        y, w = m.y[i], m.weight[i]
        total += w * y * y
        for c in range(last):
            part = w * rows[i, c]
            b[c] += part * y
            for d in range(c + 1):
                a[c, d] += part * rows[i, d]
    for c in range(LINEAR):
        if not used[c]:
            a[c, :], b[c] = 0.0, 0.0
    p[CHI] = max(total - _explained(a, b, p[:LINEAR]), 0.0) / m.variance
    out = m.wide[0] + _deviance(p[CHI], m.y.shape[0])
    for c in range(LINEAR, UNKNOWNS):
        if used[c] and c != KNOT:
            off = (p[c] - _told(m, c)) / prior_sd(m, c)
            out += off * off
    return out


@njit(cache=True, inline="always")
def _deviance(chi, n):
    """-2 ln of the likelihood of ``n`` samples whose variance is at least the noise's."""
    return chi if chi <= n else n + n * math.log(chi / n)


@njit(cache=True)
def _scatter(m, p, used, rows):
    """Weigh the samples by the scatter of the instants at which they acted, SCATTER."""
    n = m.y.shape[0]
    columns(m, p, used, rows)
    size, rest, slope = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        for c in range(LINEAR):
            if used[c]:
                size[i] += p[c] * rows[i, c]
        rest[i] = (m.y[i] - size[i]) ** 2 / m.variance
    for i in range(n):
        before = size[i] - (size[i - 1] if i > 0 else 0.0)
        after = size[i + 1] - size[i] if i + 1 < n else before
        slope[i] = 0.5 * (before * before + after * after) / m.variance
    best = np.inf
    for q in range(SCATTERS):
        sd = 0.0 if q == 0 else LEAST_SCATTER * 2.0 ** (q - 1)
        chi, out = 0.0, math.log(2.0 * m.y.shape[0]) if q > 0 else 0.0
        for i in range(n):
            wide = 1.0 + sd * sd * slope[i]
            chi += rest[i] / wide
            out += math.log(wide)
        out += _deviance(chi, m.y.shape[0])
        if out < best:
            best = out
            p[SCATTER] = sd
    m.wide[0] = 0.0
    for i in range(n):
        wide = 1.0 + p[SCATTER] ** 2 * slope[i]
        m.weight[i] = 1.0 / wide
        m.wide[0] += math.log(wide)


@njit(cache=True, inline="always")
def _told(m, c):
    """What an unknown is without samples."""
    if c == DELAY:
        return m.told
    if c == LAG:
        return m.lag
    return m.expected if c == POINT else 0.0


@njit(cache=True, inline="always")
def prior_sd(m, c):
    """Standard deviation of an unknown before any sample."""
    if c == POINT:
        return TOUCH_SD
    if c == RATE:
        return DELAY_SD * m.told / (m.first + m.y.shape[0] - m.felt)
    return LAG_SD if c == LAG else DELAY_SD * m.told


@njit(cache=True)
def _explained(a, b, x):
    """``b.x`` of x >= 0 with ``a x = b``, without columns that would be negative or dependent."""
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
def _deepest(m, p):
    last = int(max((m.first + m.y.shape[0] - 1 - p[DELAY]) * m.substeps, 0.0))
    return np.max(m.s[: last + 1]) - p[POINT]


@njit(cache=True)
def _bounded(m, p, deepest):
    """Keep the unknowns where the model means something."""
    step = int(p[ONSET])
    p[POINT] = min(max(p[POINT], m.s[step - 1]), m.s[step])
    p[DELAY] = min(max(p[DELAY], max(NARROW * m.told, 1.0)), max(WIDE * m.told, 2.0))
    p[LAG] = max(p[LAG], 0.0)
    p[RATE] = min(max(p[RATE], -0.5), 0.5)
    p[KNOT] = min(max(p[KNOT], 0.05 * deepest), deepest)


@njit(cache=True)
def _normal(m, p, used, work, matrix, gradient):
    """Normal equations without priors, in units of f sigma^2; Jacobian into ``work``."""
    rows, other, jacobian = work
    step, n, near = int(p[ONSET]), m.y.shape[0], np.empty(SOLUTION)
    columns(m, p, used, rows)
    for c in range(UNKNOWNS):
        if used[c] and c < LINEAR:
            copied(rows[:, c], jacobian[:, c])
        elif used[c]:
            copied(p, near)
            d = RESOLUTION
            if c in (POINT, KNOT):
                d *= abs(m.s[step] - m.s[step - 1]) + 1e-12
            elif c == RATE:
                d /= m.first + n - m.felt
            near[c] += d
            columns(m, near, used, other)
            for i in range(n):
                change = 0.0
                for e in range(LINEAR):
                    if used[e]:
                        change += p[e] * (other[i, e] - rows[i, e])
                jacobian[i, c] = change / d
    scale = 1.0 / (m.variance * max(1.0, p[CHI] / n))
    matrix[:], gradient[:] = 0.0, 0.0
    for i in range(n):
        rest, weight = m.y[i], scale * m.weight[i]
        for c in range(LINEAR):
            if used[c]:
                rest -= p[c] * rows[i, c]
        for c in range(UNKNOWNS):
            if used[c]:
                gradient[c] += weight * jacobian[i, c] * rest
                for d in range(c + 1):
                    if used[d]:
                        matrix[c, d] += weight * jacobian[i, c] * jacobian[i, d]
                        matrix[d, c] = matrix[c, d]


@njit(cache=True)
def _add_priors(m, p, used, matrix, gradient):
    """What the priors of the unknowns in use add to normal equations."""
    for c in range(LINEAR, UNKNOWNS):
        if used[c] and c != KNOT:
            precision = 1.0 / prior_sd(m, c) ** 2
            matrix[c, c] += precision
            gradient[c] -= (p[c] - _told(m, c)) * precision


@njit(cache=True)
def _fix(p, used, matrix, right):
    """Take out of normal equations what is not in use, or stands at its bound of 0."""
    for c in range(UNKNOWNS):
        if not used[c] or matrix[c, c] <= 0.0 or (c < LINEAR and p[c] <= 0.0):
            matrix[c, :] = 0.0
            matrix[:, c] = 0.0
            matrix[c, c] = 1.0
            right[c] = 0.0


@njit(cache=True)
def _descend(m, p, used, work):
    """Levenberg-Marquardt from ``p``; returns -2 ln of likelihood times prior."""
    rows = work[0]
    matrix, gradient = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    a, d = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    trial = np.empty(SOLUTION)
    deepest = _deepest(m, p) if used[STOP] else 0.0
    _bounded(m, p, deepest)
    best = misfit(m, p, used, rows)
    if not np.any(used[LINEAR:]):
        return best
    damp = DAMP
    fresh = True
    for _ in range(STEPS):
        if fresh:
            _normal(m, p, used, work, matrix, gradient)
            _add_priors(m, p, used, matrix, gradient)
        copied(matrix, a)
        copied(gradient, d)
        for c in range(UNKNOWNS):
            a[c, c] *= 1.0 + damp
        _fix(p, used, a, d)
        solve(a, d, a)
        if not np.all(np.isfinite(d)):  # not positive definite
            damp *= 10.0
            fresh = False
            continue
        copied(p, trial)
        for c in range(LINEAR, UNKNOWNS):
            if used[c]:
                trial[c] += d[c]
        _bounded(m, trial, deepest)
        found = misfit(m, trial, used, rows)
        if found < best:
            fresh = True
            gained = best - found
            best = found
            copied(trial, p)
            damp = max(0.1 * damp, 1e-9)
            if gained < 1e-3:
                break
        else:
            fresh = False
            damp *= 10.0
            if damp > 1e6:
                break
    misfit(m, p, used, rows)
    return best


@njit(cache=True)
def _settle(m, p, used, work):
    """As :func:`_descend`, and to the best ONSET, if the touch point is searched."""
    best = _descend(m, p, used, work)
    if not used[POINT]:
        return best
    trial = np.empty(SOLUTION)
    for way in (-1, 1):
        while True:
            copied(p, trial)
            trial[ONSET] += way
            if trial[ONSET] < 2.0 or trial[ONSET] > m.s.shape[0] - 2.0:
                break
            if used[DELAY]:
                trial[DELAY] -= way / m.substeps
            found = _descend(m, trial, used, work)
            if found >= best:
                break
            best = found
            copied(trial, p)
    return best


@njit(cache=True)
def _evidence(m, p, used, found, work):
    """-2 ln Z, into COST."""
    rows, matrix, gradient = work[0], np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    _normal(m, p, used, work, matrix, gradient)
    peak = np.max(np.abs(m.y))
    scale = np.zeros(UNKNOWNS)
    for c in range(UNKNOWNS):
        if not used[c] or (c < LINEAR and p[c] <= 0.0):
            continue
        if c < LINEAR:
            scale[c] = peak / max(np.max(np.abs(rows[:, c])), 1e-300)
        elif c == KNOT:
            scale[c] = _deepest(m, p) / math.sqrt(12.0)
        else:
            scale[c] = prior_sd(m, c)
    # the step at which the force sets in confines the touch point
    step = int(p[ONSET])
    if used[POINT]:
        matrix[POINT, POINT] += 12.0 / (m.s[step] - m.s[step - 1]) ** 2
    for c in range(UNKNOWNS):
        for d in range(UNKNOWNS):
            matrix[c, d] *= scale[c] * scale[d]
        matrix[c, c] += 1.0
    p[COST] = found + (math.log(2.0 * m.y.shape[0]) if p[SCATTER] > 0.0 else 0.0)
    solve(matrix, gradient, matrix)  # NaN unless it is positive definite
    for c in range(UNKNOWNS):
        p[COST] += 2.0 * math.log(matrix[c, c])
    if math.isnan(p[COST]):
        p[COST] = np.inf


@njit(cache=True)
def _grown(m, parent, used, new, work, out):
    """The model that has the unknown ``new`` more than ``parent``, into ``out``."""
    out[COST] = np.inf
    start, trial = np.empty(SOLUTION), np.empty(SOLUTION)
    latest = m.felt - (parent[ONSET] - 1.0) / m.substeps
    deepest = _deepest(m, parent) if new == STOP else 0.0
    ways = 2 if used[DELAY] else 1
    count = 4 * LATE + 1 if new == DELAY else LAGS * ways if new == LAG else KNOTS
    for digital in range(2 if new == LAG else 1):
        _scatter(m, parent, used, work[0])
        copied(parent, start)
        if new == LAG:
            start[DIGITAL] = digital
        # the best of some values of the new unknown
        begin, best = start.copy(), np.inf
        for q in range(count if new in (DELAY, LAG, STOP) else 0):
            copied(begin, trial)
            if new == DELAY:
                trial[DELAY] = latest - 0.25 * q
            elif new == LAG:
                trial[LAG] = 0.25 * 2.0 ** (q // ways)
                if q % ways == 1:
                    trial[DELAY] -= trial[LAG] - parent[LAG]
            else:
                trial[KNOT] = (SHALLOW + (DEEP - SHALLOW) * q / (KNOTS - 1)) * deepest
            found = misfit(m, trial, used, work[0]) if trial[DELAY] >= 1.0 else np.inf
            if found < best:
                best = found
                copied(trial, start)
        _settled(m, start, used, work)
        if start[COST] < out[COST]:
            copied(start, out)


@njit(cache=True)
def _settled(m, p, used, work):
    """From ``p`` to the best solution and its -2 ln Z."""
    before, best = p[SCATTER], _settle(m, p, used, work)
    _scatter(m, p, used, work[0])
    if before > 0.0 or p[SCATTER] > 0.0:  # the weights are others
        best = _descend(m, p, used, work)
    _evidence(m, p, used, best, work)


@njit(cache=True)
def _centre(m, used, rows, best):
    """Move the delay to the middle of its 95 % interval: chi-square is flat between readings."""
    trial = best.copy()
    limit = misfit(m, trial, used, rows) + CERTAIN
    ends = np.empty(2)
    for e in range(2):
        inside = best[DELAY]
        outside = max(inside - 2.0, 1.0) if e == 0 else inside + 2.0
        while abs(outside - inside) > RESOLUTION:
            trial[DELAY] = 0.5 * (inside + outside)
            if misfit(m, trial, used, rows) < limit:
                inside = trial[DELAY]
            else:
                outside = trial[DELAY]
        ends[e] = inside
    trial[DELAY] = 0.5 * (ends[0] + ends[1])
    if misfit(m, trial, used, rows) < limit:
        copied(trial[:UNKNOWNS], best[:UNKNOWNS])
    best[SPREAD] = 0.5 * (ends[1] - ends[0])


@njit(cache=True)
def _widen(m, p, used, work):
    """Let the interval of the delay, at the last reading, hold a drift not worth an unknown."""
    matrix, step = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    joint = used.copy()
    joint[RATE] = True
    _normal(m, p, joint, work, matrix, step)
    _add_priors(m, p, joint, matrix, step)
    _fix(p, joint, matrix, step)
    # the derivatives do not show the instant at which the force sets in, but the interval does
    matrix[DELAY, DELAY] += CERTAIN / max(p[SPREAD], RESOLUTION) ** 2
    now, factor = np.zeros(UNKNOWNS), np.empty((UNKNOWNS, UNKNOWNS))
    age = m.first + m.y.shape[0] - 1.0 - m.felt
    now[DELAY], now[RATE] = 1.0, age
    solve(matrix, step, factor)
    solve(matrix, now, factor)
    off, variance = step[DELAY] + age * step[RATE], now[DELAY] + age * now[RATE]
    if math.isfinite(off) and variance > 0.0:
        p[SPREAD] = max(p[SPREAD], abs(off) + math.sqrt(CERTAIN * variance))


@njit(cache=True)
def _promised(m, p, used, new, work):
    """The fall of -2 ln Z to first order if the unknown ``new`` joins the best fit: the score test
    (C. R. Rao, Proc. Camb. Phil. Soc. 44, 1948) less what the unknown costs.
    """
    rows, matrix, gradient = work[0], np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    joint, near = used.copy(), p.copy()
    joint[new] = True
    knots = KNOTS if new == STOP else 1
    peak, best = np.max(np.abs(m.y)), -np.inf
    deepest = _deepest(m, p) if new == STOP else 0.0
    for q in range(knots):
        if new == STOP:
            near[KNOT] = (SHALLOW + (DEEP - SHALLOW) * q / (KNOTS - 1)) * deepest
        _normal(m, near, joint, work, matrix, gradient)
        across = np.zeros(UNKNOWNS)
        for c in range(UNKNOWNS):
            if c >= LINEAR and used[c] and c != KNOT:
                matrix[c, c] += 1.0 / prior_sd(m, c) ** 2
            if used[c]:
                across[c] = matrix[c, new]
        own, slope = matrix[new, new], gradient[new]
        for c in range(UNKNOWNS):
            if not used[c] or matrix[c, c] <= 0.0:
                matrix[c, :] = 0.0
                matrix[:, c] = 0.0
                matrix[c, c] = 1.0
                across[c] = gradient[c] = 0.0
        both = across.copy()
        solve(matrix, both, matrix)
        own -= across @ both
        slope -= gradient @ both
        if math.isnan(own):
            return np.inf
        sd = peak / max(np.max(np.abs(rows[:, new])), 1e-300) if new < LINEAR else prior_sd(m, new)
        if own > 0.0:
            gain = slope**2 / (own + 1.0 / sd**2)
            best = max(best, gain - math.log(1.0 + own * sd**2))
    return best


@njit(cache=True)
def fit(m, free, best, used):
    """The model with the largest evidence; delay, its rate and the low-pass only if ``free``.

    best: (SOLUTION,), out. used: (UNKNOWNS,) whether an unknown of it was searched, out.
    """
    n = m.y.shape[0]
    work = (np.zeros((n, LINEAR)), np.zeros((n, LINEAR)), np.zeros((n, UNKNOWNS)))
    told, now, mine = np.zeros(SOLUTION), np.zeros(SOLUTION), np.zeros(UNKNOWNS, dtype=np.bool_)
    told[POINT], told[DELAY], told[LAG] = m.expected, m.told, m.lag
    # the step that first is beyond the touch point, in the latest passage before the force was felt
    step = m.felt * m.substeps
    while step > 1 and m.s[step] <= m.expected:
        step -= 1
    while step > 1 and m.s[step - 1] > m.expected:
        step -= 1
    told[ONSET], told[DIGITAL] = step, m.digital
    mine[STIFFNESS], mine[DAMPING] = True, True
    misfit(m, told, mine, work[0])
    _scatter(m, told, mine, work[0])
    _evidence(m, told, mine, misfit(m, told, mine, work[0]), work)
    copied(told, best)
    copied(mine, used)
    copied(told, now)
    child, better = np.empty(SOLUTION), np.empty(SOLUTION)
    enough = m.y.shape[0] + ENOUGH * math.sqrt(2.0 * m.y.shape[0])
    choice, idle = np.zeros(len(GROWS) + 1), 0
    for level in range(len(GROWS)):
        better[COST] = np.inf
        add, tried = -1, 0
        for new in GROWS:
            if mine[new] or (new == RATE and not mine[DELAY]):
                continue
            if not free and new in (DELAY, RATE, LAG):
                continue
            tried += 1
            # of a fit that is nearly right the first order tells, but of the delay, at whose ends
            # the force sets in at another step
            near = new != DELAY and now[CHI] <= enough
            if near and _promised(m, now, mine, new, work) <= 0.0:
                continue
            mine[new] = True
            mine[KNOT] = mine[STOP]
            _grown(m, now, mine, new, work, child)
            mine[new] = False
            mine[KNOT] = mine[STOP]
            if child[COST] < better[COST]:
                copied(child, better)
                add = new
        if add < 0:
            break
        mine[add] = True
        mine[KNOT] = mine[STOP]
        copied(better, now)
        # every model of so many unknowns is as likely beforehand
        choice[level + 1] = choice[level] + 2.0 * math.log(tried)
        now[COST] += choice[level + 1]
        idle += 1
        if now[COST] < best[COST]:
            copied(now, best)
            copied(mine, used)
            idle = 0
        if idle == 2 or (idle == 1 and best[CHI] <= enough):
            break
    _pruned(m, told, choice, work, best, used)
    best[SPREAD] = 0.0
    _scatter(m, best, used, work[0])
    if used[DELAY]:
        _centre(m, used, work[0], best)
        _widen(m, best, used, work)


@njit(cache=True)
def _pruned(m, told, choice, work, best, used):
    """Leave out what a later unknown has made superfluous."""
    child, less = np.empty(SOLUTION), np.empty(UNKNOWNS, dtype=np.bool_)
    for out in GROWS:
        level = 0
        for new in GROWS:
            level += used[new]
        if not used[out] or level < 2 or (out == DELAY and used[RATE]):
            continue
        copied(used, less)
        less[out] = False
        less[KNOT] = less[STOP]
        copied(best, child)
        child[out] = told[out]
        if out == POINT:
            child[ONSET] = told[ONSET]
            if used[DELAY]:
                child[DELAY] += (best[ONSET] - told[ONSET]) / m.substeps
        _scatter(m, best, used, work[0])
        _settled(m, child, less, work)
        child[COST] += choice[level - 1]
        if child[COST] < best[COST]:
            copied(child, best)
            copied(less, used)
