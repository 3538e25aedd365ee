"""The delayed model: the numerical model at t - tau, the wrench that drives it, and the
identification of the contact at that time.

Kernels of :mod:`hiltestbed.compensation.resynchronised` for run ``i`` of the copy ``m``.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compensation.resynchronised import contact_estimate as ce
from hiltestbed.compensation.resynchronised import contact_fit as cf
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.frames import rotation_vector
from hiltestbed.identification.samples import GATE_PEAK, GATE_SIGMA
from hiltestbed.numerical_model.kernels import (
    carry,
    relative_motion,
    step,
    wrench_at_A,
    wrench_at_P,
)
from hiltestbed.sensor.chain import filtered

HISTORY = 512  # ticks of a contact that can be re-run
FIRST_FIT = 2 * cf.LINEAR  # samples of contact: twice the unknowns of the richest law
# Columns of ``tick``: ticks done, tick of the delayed model, tick of the touch, number of samples
# at which the next re-run and the next fit are due, tick of the first reading of this contact.
DONE, DELAYED, ANCHOR, NEXT_RERUN, NEXT_FIT, FELT, TICK = range(7)
# Columns of ``told``: what was believed when this contact began: delay [s], half the width of its
# interval [s], touch point [m], time constant [ticks] of the low-pass and whether it is digital.
BELIEVED, HALF_WIDTH, EXPECTED, SMOOTHED, DIGITAL, TOLD = range(6)
# Columns of ``drift``: of the delay a tick, and the tick at which it is the one in ``delay``.
SLOPE, SINCE, DRIFT = range(3)


@njit(cache=True, inline="always")
def along(fixed, line, x):
    """``G.x``"""
    if fixed:
        return x[2]
    return (
        line[0, 0] * x[0]
        + line[0, 1] * x[1]
        + line[0, 2] * x[2]
        + line[0, 3] * x[3]
        + line[0, 4] * x[4]
        + line[0, 5] * x[5]
    )


@njit(cache=True, inline="always")
def _delay(i, m, k):
    """Delay [ticks] of the reading at tick ``k``."""
    delay, drift, told = m.state.delay[i] / m.tick, m.state.drift[i], m.state.told[i, BELIEVED]
    if drift[SLOPE] == 0.0:
        return delay
    delay += drift[SLOPE] * (k - drift[SINCE])
    return min(max(delay, cf.NARROW * told / m.tick), cf.WIDE * told / m.tick)


@njit(cache=True, inline="always")
def _whole(ticks):
    """A delay [ticks] as whole ticks, rounded up, and the fraction by which it is shorter."""
    late = int(math.ceil(ticks - 1e-9))
    return late, min(max(late - ticks, 0.0), 1.0)


@njit(cache=True)
def _acted(i, m, k, rows):
    """The force [N] of tick ``k``; position, rate and wrench at A when it acted in rows 0 to 2."""
    state = m.state
    late, part = _whole(_delay(i, m, k))
    # the sensor interpolates its reading between substeps; so is the rate weighted
    w, length = min(1.0, part * m.substeps) if m.ideal else part, state.x.shape[1]
    j = k - late
    now = min(j + 1, k) % length
    for c in range(6):
        early, late = state.x[i, j % length, c], state.x[i, now, c]
        rows[0, c] = (1.0 - part) * early + part * late
        rows[1, c] = (1.0 - w) * state.rate[i, j % length, c] + w * state.rate[i, now, c]
    at_A = rows[2]
    wrench_at_A(state.wrench[i, k % length], rows[0], at_A)
    return at_A[2] if m.fixed else math.sqrt(at_A[0] ** 2 + at_A[1] ** 2 + at_A[2] ** 2)


@njit(cache=True, inline="always")
def identify(i, m, work, rows):
    """Identify the contact from this tick's reading and the pose at the time the force acted."""
    h, fixed, setup, state = m.tick, m.fixed, m.setup, m.state
    k = state.tick[i, DONE]
    if k < _whole(_delay(i, m, k))[0]:
        return
    line, fit, law, count = state.line[i], state.fit[i], state.law[i], state.count[i]
    y = _acted(i, m, k, rows)
    rate, at_A = rows[1], rows[2]
    fit[ce.PEAK] = max(fit[ce.PEAK], y)
    slow = setup.smooth[i, 0] < 1.0 and law[ce.FITTED] == 0.0
    gate = (
        ce.GATE_PEAK_FILTERED
        if slow and count[ce.ABOVE] > 0 and count[ce.SAMPLES] > 0
        else GATE_PEAK
    )
    if y <= GATE_SIGMA * setup.sigma[i, 0] or y <= gate * fit[ce.PEAK]:
        if fixed and count[ce.ABOVE] >= FIRST_FIT and state.told[i, BELIEVED] > 0.0:
            _refit(i, m, work, rows)  # the contact is over, and all is seen of it
        elif count[ce.ABOVE] == 0:
            _hold(i, m, k)
        if count[ce.ABOVE] > 0 and not fixed:
            law[ce.ARMED] = 0.0  # the next contact may be elsewhere on the surface
        count[ce.ABOVE] = 0
        state.regressor[i] = 0.0
        return
    fade = math.exp(-h / ce.DIRECTION_MEMORY)
    sigma = setup.sigma[i]
    ce.direct(line, at_A, y, fixed, fade, (sigma[0] * sigma[0], sigma[1] * sigma[1]))
    if fixed:
        ce.rub(fit, law, line, at_A, rate, y, setup.sigma[i, 0])
    if count[ce.ABOVE] == 0:
        _touched(i, m, along(fixed, line, rows[0]), along(fixed, line, rate), work)
    _take(i, m, rows, y)
    if count[ce.ABOVE] >= state.tick[i, NEXT_FIT] and fixed and state.told[i, BELIEVED] > 0.0:
        state.tick[i, NEXT_FIT] = int(cf.GROWTH * count[ce.ABOVE]) + 1
        _refit(i, m, work, rows)


@njit(cache=True, inline="always")
def _take(i, m, rows, y):
    """Take the sample in ``rows`` into the fit of k x + c v."""
    setup, state, count = m.setup, m.state, m.state.count[i]
    count[ce.ABOVE] += 1
    # the last sample of a contact is left out: it may be clipped
    if count[ce.ABOVE] > 2 + setup.skip[i]:
        ce.learn(state.fit[i], state.law[i], count, state.pending[i], setup.sigma[i, 0])
    s, u = along(m.fixed, state.line[i], rows[0]), along(m.fixed, state.line[i], rows[1])
    # x, v and 1 through the model of the sensor's filters, from the touch on
    smooth, leak = setup.smooth[i], setup.leak[i]
    memory, sample = state.regressor[i], state.pending[i]
    sample[0] = filtered(s, smooth, leak, memory[0])
    sample[1] = filtered(u, smooth, leak, memory[1])
    sample[2] = filtered(1.0, smooth, leak, memory[2])
    sample[3] = y


@njit(cache=True)
def _touched(i, m, s, u, work):
    """Start a contact: the model of a lagging platform moves back to where the rig touched."""
    state, tick, law = m.state, m.state.tick[i], m.state.law[i]
    told = state.told[i]
    _hold(i, m, tick[DONE])
    told[BELIEVED], told[HALF_WIDTH] = state.delay[i], state.delay_half_width[i]
    told[SMOOTHED], told[DIGITAL] = state.lag[i, 0], state.lag[i, 1]
    told[EXPECTED] = law[ce.TOUCH] if law[ce.ARMED] == 1.0 else 0.0
    ce.touch(state.fit[i], law, state.count[i], s, u, m.tick)
    pose, at = np.empty(7), np.empty(6)
    relative_motion(state.q[i, 0], state.v[i, 0], m.bodies.port[i], work, pose, at)
    copied(pose[0:3], at[0:3])
    rotation_vector(pose[3:7], at[3:6])
    reached = along(m.fixed, state.line[i], at)
    most = min(HISTORY // 4, tick[DELAYED])
    _move_back(i, m, int(min((reached - s) / (u * m.tick), most)) if u > 0.0 else 0, work)
    _anchor(i, state)
    tick[NEXT_RERUN] = ce.MINIMUM_SAMPLES
    tick[NEXT_FIT], tick[FELT] = FIRST_FIT, tick[DONE]


@njit(cache=True, inline="always")
def _anchor(i, state):
    """Re-runs start from where the delayed model is."""
    copied(state.q[i, 0], state.q[i, 1])
    copied(state.v[i, 0], state.v[i, 1])
    copied(state.filtered[i, 0], state.filtered[i, 1])
    state.tick[i, ANCHOR] = state.tick[i, DELAYED]


@njit(cache=True, inline="always")
def _hold(i, m, k):
    """No sample shows how the delay goes on after a contact: it stays as it is at tick ``k``."""
    state = m.state
    if state.drift[i, SLOPE] != 0.0:
        state.delay[i] = m.tick * _delay(i, m, k)
        state.drift[i, SLOPE] = 0.0


@njit(cache=True)
def _refit(i, m, work, rows):
    """Fit delay and law to this contact so far, and run the model again from before the touch."""
    h, setup, state = m.tick, m.setup, m.state
    fit, law, count, tick = state.fit[i], state.law[i], state.count[i], state.tick[i]
    samples = _samples(i, m)
    if samples.first + samples.y.shape[0] > state.x.shape[1]:
        return
    best, used = np.zeros(cf.SOLUTION), np.zeros(cf.UNKNOWNS, dtype=np.bool_)
    cf.fit(samples, setup.estimate[i] == 1, best, used)
    if best[cf.STIFFNESS] <= 0.0:
        return
    stands = not np.any(used[cf.LINEAR :]) and not used[cf.DEEPENING]
    if stands and law[ce.FITTED] == 0.0:
        return
    state.delay_half_width[i] = best[cf.SPREAD] * h if used[cf.DELAY] else state.told[i, HALF_WIDTH]
    state.delay[i] = best[cf.DELAY] * h
    state.lag[i, 0], state.lag[i, 1] = best[cf.LAG], best[cf.DIGITAL]
    state.drift[i, SLOPE], state.drift[i, SINCE] = best[cf.RATE], tick[FELT]
    cf.low_pass_of(best[cf.LAG], best[cf.DIGITAL], setup.smooth[i])
    law[ce.STIFFNESS], law[ce.DAMPING] = best[cf.STIFFNESS], best[cf.DAMPING]
    law[ce.TOUCH], law[ce.DEEPENING] = best[cf.POINT], best[cf.DEEPENING]
    law[ce.STOP], law[ce.KNOT] = best[cf.STOP], best[cf.KNOT]
    law[ce.KNOWN], law[ce.ARMED], law[ce.FITTED] = 1.0, 1.0, 0.0 if stands else 1.0
    ce.restart(fit, count, best[cf.POINT] if fit[ce.SD_X] == 0.0 else fit[ce.REFERENCE])
    state.regressor[i] = 0.0
    count[ce.ABOVE] = 0
    for k in range(tick[FELT], tick[DONE] + 1):
        _take(i, m, rows, _acted(i, m, k, rows))
    _restore(i, state)
    late = _whole(_delay(i, m, tick[FELT]))[0]
    _move_back(i, m, tick[ANCHOR] - max(tick[FELT] - late - cf.LATE, 0), work)
    _anchor(i, state)


@njit(cache=True)
def _samples(i, m):
    """This contact so far, from before the touch on."""
    setup, state = m.setup, m.state
    tick, told, sigma = state.tick[i], state.told[i, BELIEVED] / m.tick, setup.sigma[i, 0]
    length = state.x.shape[1]
    begin = max(tick[FELT] - int((1.0 - cf.NARROW) * told) - cf.BEFORE, 0)
    start = max(begin - int(cf.WIDE * told) - cf.BEFORE, 0)
    n = tick[DONE] + 1 - start
    steps = int(m.substeps)
    size = (n - 1) * steps + 1
    s, u, y = np.empty(size), np.empty(size), np.empty(n)
    peak = 0.0
    for j in range(n):
        now, before = (start + j) % length, (start + j - 1) % length
        y[j] = state.wrench[i, now, 2]
        peak = max(peak, y[j])
        x, v = state.x[i, now, 2], state.rate[i, now, 2]
        for back in range(min(steps, j * steps + 1)):
            # the rate of a prescribed platform is constant within a tick
            share = back / steps
            s[j * steps - back] = x + share * (state.x[i, before, 2] - x)
            u[j * steps - back] = v if m.ideal else v + share * (state.rate[i, before, 2] - v)
    first = felt = tick[FELT] - start
    while first > begin - start and y[first - 1] <= GATE_SIGMA * sigma:
        first -= 1  # not into an earlier contact
    return cf.ContactWindow(
        s,
        u,
        y[first:],
        first,
        max(sigma * sigma, (ce.MODEL_ERROR * peak) ** 2),
        np.ones(n - first),
        np.zeros(1),
        felt,
        steps,
        state.told[i, SMOOTHED],
        state.told[i, DIGITAL],
        setup.leak[i],
        told,
        state.told[i, EXPECTED],
    )


@njit(cache=True, inline="always")
def _restore(i, state):
    """The delayed model as it was before the touch."""
    copied(state.q[i, 1], state.q[i, 0])
    copied(state.v[i, 1], state.v[i, 0])
    copied(state.filtered[i, 1], state.filtered[i, 0])
    state.tick[i, DELAYED] = state.tick[i, ANCHOR]


@njit(cache=True)
def _move_back(i, m, ticks, work):
    """Move the delayed model back by ``ticks``, in free flight."""
    if ticks < 1:
        return
    none, bodies, q, v = m.state.used[i], m.bodies, m.state.q[i, 0], m.state.v[i, 0]
    none[:] = 0.0
    mass, inverse = bodies.mass[i], bodies.inverse[i]
    carry(q, v, bodies.port[i], mass, inverse, -m.tick * ticks, none, none, work)
    m.state.tick[i, DELAYED] -= ticks


@njit(cache=True, inline="always")
def catch_up(i, m, work, rows):
    """Advance to the last reading; run again from the touch when the samples have doubled."""
    state = m.state
    tick, count = state.tick[i], state.count[i]
    last = tick[DONE] - _whole(_delay(i, m, tick[DONE]))[0]
    if (
        tick[ANCHOR] >= 0
        and count[ce.SAMPLES] >= tick[NEXT_RERUN]
        and state.law[i, ce.KNOWN] == 1.0
    ):
        tick[NEXT_RERUN] = 2 * count[ce.SAMPLES]
        if last - tick[ANCHOR] < HISTORY:
            _restore(i, state)
    while tick[DELAYED] <= last:
        _step_delayed(i, m, tick[DELAYED], work, rows)
        tick[DELAYED] += 1


@njit(cache=True, inline="always")
def _step_delayed(i, m, j, work, rows):
    """A step from t_j under the wrench measured for it, corrected for the offset from the rig."""
    fixed, bodies, setup, state = m.fixed, m.bodies, m.setup, m.state
    length = state.x.shape[1]
    pose, twist, used, line, law = rows[0], rows[1], rows[2], state.line[i], state.law[i]
    # the reading at tick k acted at j = k - delay(k)
    late, part = _whole(_delay(i, m, j) / (1.0 - state.drift[i, SLOPE]))
    known = j + late
    read, before = state.wrench[i, known % length], state.wrench[i, (known - 1) % length]
    for c in range(6):
        used[c] = (
            read[c] if part == 0.0 or known == 0 else (1.0 - part) * read[c] + part * before[c]
        )
    x, v = state.x[i, j % length], state.rate[i, j % length]
    relative_motion(state.q[i, 0], state.v[i, 0], bodies.port[i], work, pose, twist)
    wrench_at_A(used, x, used)
    rig = ce.size(law, along(fixed, line, x), along(fixed, line, v))
    if law[ce.KNOWN] == 1.0:
        rig = filtered(rig, setup.smooth[i], setup.leak[i], state.filtered[i, 0])
    noise, silent = setup.sigma[i, 0], rig == 0.0
    for c in range(6 if noise == 0.0 else 3):
        silent &= abs(used[c]) <= GATE_SIGMA * noise
    if silent:  # noise only, which would make the model drift
        used[:6] = 0.0
    at = rows[3]
    for c in range(3):
        at[c] = pose[c]
    if not fixed:
        rotation_vector(pose[3:7], at[3:6])
    size = ce.size(law, along(fixed, line, at), along(fixed, line, twist))
    for c in range(6):
        used[c] += (
            line[0, c] * (size - rig) if (c != 0 and c != 1) or law[ce.FRICTION] == 0.0 else 0.0
        )
    if law[ce.FRICTION] > 0.0:  # the friction at the delayed model's state less that at the rig's
        sx, sy = ce.slip(line, twist)
        fx, fy = ce.friction(law, size, sx, sy, state.creep[i, 0])
        sx, sy = ce.slip(line, v)
        gx, gy = ce.friction(law, max(rig, 0.0), sx, sy, state.creep[i, 0])
        fx -= gx
        fy -= gy
        used[0] += fx
        used[1] += fy
        used[5] -= line[0, 4] * fy + line[0, 3] * fx
    wrench_at_P(used, pose, used)
    for c in range(6):
        state.used[i, c] = used[c]
    mass, inertia, inverse = bodies.mass[i], bodies.inertia[i], bodies.inverse[i]
    q, v, load = state.q[i, 0], state.v[i, 0], state.used[i]
    step(q, v, bodies.port[i], mass, inertia, inverse, load, m.tick, work)
