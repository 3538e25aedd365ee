"""The delayed model: the numerical model at t - tau, the wrench that drives it, and the
identification of the contact at that time.

Kernels of :mod:`hiltestbed.compensation.resynchronised` for run ``i`` of the copy ``m``.
"""

from __future__ import annotations

import math

import numpy as np

from hiltestbed.compensation.resynchronised import contact_estimate as ce
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import rotation_vector
from hiltestbed.numerical_model.kernels import (
    carry,
    relative_motion,
    step,
    wrench_at_A,
    wrench_at_P,
)
from hiltestbed.sensor.chain import filtered

HISTORY = 512  # ticks of a contact that can be re-run
# Columns of ``tick``: ticks done, tick of the delayed model, tick of the touch, number of samples
# at which the next re-run is due.
DONE, DELAYED, ANCHOR, NEXT_RERUN, TICK = range(5)


@njit(cache=True, inline="always")
def remember(i, state, wrench, pose, twist):
    slot = state.tick[i, DONE] % state.x.shape[1]
    for j in range(3):
        state.x[i, slot, j] = pose[j]
    rotation_vector(pose[3:7], state.x[i, slot, 3:6])
    for j in range(6):
        state.wrench[i, slot, j] = wrench[j]
        state.rate[i, slot, j] = twist[j]


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
def identify(i, m, work, rows):
    """Identify the contact from this tick's reading and the pose at the time the force acted."""
    h, fixed, setup, state = m.tick, m.fixed, m.setup, m.state
    k, late, part = state.tick[i, DONE], setup.late[i], setup.part[i]
    j = k - late
    if j < 0:
        return
    length = state.x.shape[1]
    line, fit, law, count = state.line[i], state.fit[i], state.law[i], state.count[i]
    early, now = state.x[i, j % length], state.x[i, min(j + 1, k) % length]
    position, rate, at_A = rows[0], rows[1], rows[2]
    w = setup.weight[i]
    for c in range(6):
        position[c] = (1.0 - part) * early[c] + part * now[c]
        rate[c] = (1.0 - w) * state.rate[i, j % length, c] + w * state.rate[
            i, min(j + 1, k) % length, c
        ]
    wrench_at_A(state.wrench[i, k % length], position, at_A)
    y = at_A[2] if fixed else math.sqrt(at_A[0] ** 2 + at_A[1] ** 2 + at_A[2] ** 2)
    fit[ce.PEAK] = max(fit[ce.PEAK], y)
    slow = setup.smooth[i, 0] < 1.0
    gate = (
        ce.GATE_PEAK_FILTERED
        if slow and count[ce.ABOVE] > 0 and count[ce.SAMPLES] > 0
        else ce.GATE_PEAK
    )
    if y <= ce.GATE_SIGMA * setup.sigma[i, 0] or y <= gate * fit[ce.PEAK]:
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
    s, u = along(fixed, line, position), along(fixed, line, rate)
    count[ce.ABOVE] += 1
    if count[ce.ABOVE] == 1:
        _touched(i, m, s, u, work)
        if setup.late[i] != late or setup.part[i] != part:
            s = fit[ce.REFERENCE] + 0.5 * h * u
    # the last sample of a contact is left out: it may be clipped
    if count[ce.ABOVE] > 2 + setup.skip[i]:
        ce.learn(fit, law, count, state.pending[i], setup.sigma[i, 0])
    _felt(s, u, setup.smooth[i], setup.leak[i], state.regressor[i], state.pending[i])
    state.pending[i, 3] = y


@njit(cache=True)
def _touched(i, m, s, u, work):
    """Start a contact: correct the delay if requested, save the state for a re-run."""
    h, setup, state = m.tick, m.setup, m.state
    fit, law, count, tick = state.fit[i], state.law[i], state.count[i], state.tick[i]
    if setup.estimate[i] == 1 and count[ce.CONTACTS] == 0 and u > 0.0:
        late = setup.late[i]
        expected = law[ce.TOUCH] if law[ce.ARMED] == 1.0 else 0.0
        correction = (s - expected) / u - 0.5 * h  # on average the force began half a tick ago
        spare = (state.x.shape[1] - HISTORY) // 2
        delay = min(max(state.delay[i] + correction, 0.0), (spare - 2) * h)
        state.delay[i] = delay
        set_delay(i, delay, h, m.ideal, m.substeps, setup)
        back = setup.late[i] - late
        if tick[DELAYED] - back < 0:
            back = tick[DELAYED]
        _move_back(i, m, back, work)
        s = expected + 0.5 * h * u
    ce.touch(fit, law, count, s, u, h)
    _rewind(i, m, s, u, work)
    state.q[i, 1] = state.q[i, 0]
    state.v[i, 1] = state.v[i, 0]
    state.filtered[i, 1] = state.filtered[i, 0]
    tick[ANCHOR] = tick[DELAYED]
    tick[NEXT_RERUN] = ce.MINIMUM_SAMPLES


@njit(cache=True)
def _rewind(i, m, s, u, work):
    """Of a lagging platform: move the model back, in free flight, to where the rig touched."""
    h, fixed, bodies, state = m.tick, m.fixed, m.bodies, m.state
    tick, pose, at = state.tick[i], np.empty(7), np.empty(6)
    relative_motion(state.q[i, 0], state.v[i, 0], bodies.port[i], work, pose, at)
    at[0:3] = pose[0:3]
    rotation_vector(pose[3:7], at[3:6])
    reached = along(fixed, state.line[i], at)
    ticks = int(min((reached - s) / (u * h), min(HISTORY // 4, tick[DELAYED]))) if u > 0.0 else 0
    if ticks >= 1:
        _move_back(i, m, ticks, work)


@njit(cache=True)
def _move_back(i, m, ticks, work):
    """Move the delayed model back by ``ticks``, in free flight."""
    none, bodies, q, v = m.state.used[i], m.bodies, m.state.q[i, 0], m.state.v[i, 0]
    none[:] = 0.0
    mass, inverse = bodies.mass[i], bodies.inverse[i]
    carry(q, v, bodies.port[i], mass, inverse, -m.tick * ticks, none, none, work)
    m.state.tick[i, DELAYED] -= ticks


@njit(cache=True, inline="always")
def _felt(x, v, smooth, leak, memory, out):
    """Pass x, v and 1 through the model of the sensor's filters, from the touch on."""
    out[0] = filtered(x, smooth, leak, memory[0])
    out[1] = filtered(v, smooth, leak, memory[1])
    out[2] = filtered(1.0, smooth, leak, memory[2])


@njit(cache=True, inline="always")
def catch_up(i, m, work, rows):
    """Advance the delayed model as far as the last reading allows; re-run it from the touch when
    the samples have doubled.
    """
    setup, state = m.setup, m.state
    tick, count = state.tick[i], state.count[i]
    last = tick[DONE] - setup.late[i]
    if (
        tick[ANCHOR] >= 0
        and count[ce.SAMPLES] >= tick[NEXT_RERUN]
        and state.law[i, ce.KNOWN] == 1.0
    ):
        tick[NEXT_RERUN] = 2 * count[ce.SAMPLES]
        if last - tick[ANCHOR] < HISTORY:
            state.q[i, 0] = state.q[i, 1]
            state.v[i, 0] = state.v[i, 1]
            state.filtered[i, 0] = state.filtered[i, 1]
            tick[DELAYED] = tick[ANCHOR]
    while tick[DELAYED] <= last:
        _step_delayed(i, m, tick[DELAYED], work, rows)
        tick[DELAYED] += 1


@njit(cache=True, inline="always")
def _step_delayed(i, m, j, work, rows):
    """Step the delayed model from t_j to t_(j+1) under the wrench measured for t_j, corrected for
    the model's offset from the rig.
    """
    fixed, bodies, setup, state = m.fixed, m.bodies, m.setup, m.state
    length = state.x.shape[1]
    pose, twist, used, line, law = rows[0], rows[1], rows[2], state.line[i], state.law[i]
    known, part = j + setup.late[i], setup.part[i]
    late, early = state.wrench[i, known % length], state.wrench[i, (known - 1) % length]
    for c in range(6):
        used[c] = late[c] if part == 0.0 or known == 0 else (1.0 - part) * late[c] + part * early[c]
    x, v = state.x[i, j % length], state.rate[i, j % length]
    relative_motion(state.q[i, 0], state.v[i, 0], bodies.port[i], work, pose, twist)
    wrench_at_A(used, x, used)
    rig = ce.size(law, along(fixed, line, x), along(fixed, line, v))
    if law[ce.KNOWN] == 1.0:
        rig = filtered(rig, setup.smooth[i], setup.leak[i], state.filtered[i, 0])
    if rig == 0.0 and _silent(used, setup.sigma[i]):
        for c in range(6):
            used[c] = 0.0
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
    if law[ce.FRICTION] > 0.0:
        _add_friction(line, law, v, twist, rig, size, state.creep[i, 0], used)
    wrench_at_P(used, pose, used)
    for c in range(6):
        state.used[i, c] = used[c]
    mass, inertia, inverse = bodies.mass[i], bodies.inertia[i], bodies.inverse[i]
    q, v, load = state.q[i, 0], state.v[i, 0], state.used[i]
    step(q, v, bodies.port[i], mass, inertia, inverse, load, m.tick, work)


@njit(cache=True, inline="always")
def _add_friction(line, law, rate, twist, rig, size, creep, used):
    """Add the friction force at the delayed model's state less that at the rig's."""
    sx, sy = ce.slip(line, twist)
    fx, fy = ce.friction(law, size, sx, sy, creep)
    sx, sy = ce.slip(line, rate)
    gx, gy = ce.friction(law, max(rig, 0.0), sx, sy, creep)
    fx -= gx
    fy -= gy
    used[0] += fx
    used[1] += fy
    used[5] -= line[0, 4] * fy + line[0, 3] * fx


@njit(cache=True, inline="always")
def _silent(wrench, sigma):
    """Whether a wrench is noise only, and taken as zero so that the model does not drift."""
    for c in range(6 if sigma[0] == 0.0 else 3):
        if abs(wrench[c]) > ce.GATE_SIGMA * sigma[0]:
            return False
    return True


@njit(cache=True)
def set_delay(i, delay, h, ideal, substeps, setup):
    """Set a delay [s] as whole ticks and a fraction. The sensor interpolates its reading between
    substeps; so is the rate weighted.
    """
    ticks = delay / h
    late = math.ceil(ticks - 1e-9)
    part = min(max(late - ticks, 0.0), 1.0)
    setup.late[i] = late
    setup.part[i] = part
    setup.weight[i] = min(1.0, part * substeps) if ideal else part
