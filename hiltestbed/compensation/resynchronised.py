"""Resynchronised prediction: drive the numerical model with the measured wrench as what it is, the wrench at t - tau, and predict on.

The delay is of the measurement, so the past is known exactly, only late. Three copies of the numerical model:

- *behind* is at t - tau and is driven by the measured wrench, which was felt just then. Where the rig was not exactly where this copy
  is (the platform lags, an early prediction was wrong), the contact law makes up the difference: the wrench that would have been felt
  is ``F_meas + M(x_behind, v_behind) - M(x_act, v_act)``.
- *ahead* starts from *behind* and is carried over the last tau with the contact law as identified so far. Only the size of the force
  along the line of action is stepped; the bodies take its impulse and its second integral at once.
- *commanded* is the numerical model that the rig follows. It is driven with the predicted wrench, and drawn to *ahead* like a
  critically damped spring would, so that a correction of the prediction does not kick the platform.

While the latches hold, all six axes act at once and :mod:`hiltestbed.compensation.captured` takes over.

No force is differentiated, and no impulse is lost or paid back. When a first contact becomes known, *behind* is run again from the
touch on with the law: the uniform motion of the first tau, when nothing had been felt yet, leaves no trace. Worked out for this
project; the idea that a late measurement corrects a past state, from which one predicts, is that of filters with delayed measurements
(H. Alexander, "State estimation for distributed systems with sensing delay", SPIE 1470, 1991).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hiltestbed.compensation import contact_line as cl
from hiltestbed.compensation.captured import CapturedContact
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.sections import force_section
from hiltestbed.compensation.twin import SCRATCH, carry, mobility, solve, step, wrench_at_A, wrench_at_P
from hiltestbed.frames import Array, quat_conj_mul, rotate, rotation_vector
from hiltestbed.scenario import Scenario
from hiltestbed.spacecraft import Spacecraft, relative_motion

HISTORY = 512  # ticks of a contact that can be run again
SYNC_LIMIT = 0.5  # of a tick: the fastest blending that the semi-implicit step carries well
# Columns of ``tick``: ticks done, index of *behind*, index of the touch, samples at the next run-again.
DONE, BEHIND, ANCHOR, AGAIN, TICK = range(5)


Integers = NDArray[np.int64]


class Bodies(NamedTuple):
    """What *behind* and *ahead* believe of both vehicles: ``(n, 2, ...)``."""

    port: Array
    mass: Array
    inertia: Array
    inverse: Array


class Setup(NamedTuple):
    """Numbers of each run, ``(n, ...)``."""

    late: Integers  # whole ticks after which a force is known
    part: Array  # of a tick that it is younger than those
    weight: Array  # of the younger velocity at the time the force was felt
    smooth: Array  # gain a tick of the sensor's low-pass; 1: none
    leak: Array  # of its high-pass; 1: none
    skip: Integers  # samples after the touch that the low-pass's memory spoils
    sigma: Array  # (n, 2) noise of forces and torques
    blend: Array  # [rad/s]
    estimate: Array  # whether the instant of touch corrects the delay


class State(NamedTuple):
    """What changes from tick to tick, ``(n, ...)``."""

    tick: Integers
    q: Array  # (n, 2, 2, 7): behind, and behind at the touch
    v: Array
    wrench: Array  # (n, L, 6) as measured, tick j at slot j modulo L
    x: Array  # (n, L, 6) pose of A in P that the rig reached: position, rotation vector
    rate: Array  # (n, L, 6) its twist
    fit: Array
    law: Array
    count: Integers
    line: Array  # (n, 3, 6)
    regressor: Array  # (n, 3, 2) x, v, 1 in the sensor's filters
    pending: Array  # (n, 4) the last sample
    filtered: Array  # (n, 2, 2) law's force at the rig in the sensor's filters: now, and at the touch
    delay: Array  # (n,) [s] believed
    used: Array  # (n, 6) wrench of behind's last step
    creep: Array  # (n, 1) [N s/m] friction below sliding


class Resynchronised:
    """The drive for ``n`` runs: ``pose``, ``twist`` and ``wrench`` of the commanded numerical model.

    Attributes:
        stiffness, damping, touch: ``(n,)`` of the contact law identified so far; 0 while nothing is known.
        delay: ``(n,)`` [s] of the force as believed, estimated from the instant of touch where the scenario asks for it.
    """

    def __init__(self, spacecraft: Spacecraft, scenarios: Sequence[Scenario]) -> None:
        n, h = spacecraft.n, spacecraft.tick
        self.spacecraft = spacecraft
        self.pose, self.twist = spacecraft.pose, spacecraft.twist
        self.wrench = np.zeros((n, 6))
        self.ahead_pose, self.ahead_twist = np.zeros((n, 7)), np.zeros((n, 6))
        self._predicted = np.zeros((n, 6))
        self._captured = CapturedContact(scenarios)
        self._setup = _setup(scenarios, h)
        self._fixed = int(scenarios[0].mechanism.kind == "bumper")
        self._ideal = int(scenarios[0].rig.platform.tracking == "ideal")
        self._substeps = float(scenarios[0].substeps)
        self._bodies = Bodies(spacecraft.port, spacecraft.mass, spacecraft.inertia, np.linalg.inv(spacecraft.inertia).astype(np.float64))
        self.state = _state(scenarios, spacecraft, int(self._setup.late.max()))
        law = self.state.law
        self.stiffness, self.damping, self.touch = law[:, cl.STIFFNESS], law[:, cl.DAMPING], law[:, cl.TOUCH]
        self.delay = self.state.delay

    def advance(self, measurement: Measurement) -> None:
        """Move on by one tick."""
        craft = self.spacecraft
        _advance(
            craft.tick, (self._fixed, self._ideal, self._substeps), self._bodies, self._setup, self.state,
            measurement.wrench, measurement.pose, measurement.twist, self.ahead_pose, self.ahead_twist, self._predicted,
        )  # fmt: skip
        _follow(
            craft.tick, self._bodies, self._setup.blend, craft.q, craft.pose, craft.twist,
            self.ahead_pose, self.ahead_twist, self._predicted, self.wrench,
        )  # fmt: skip
        self._captured.take_over(measurement, self.wrench)
        craft.advance(self.wrench)

    def buffers(self) -> dict[str, Array]:
        return (
            {"wrench": self.wrench}
            | self.spacecraft.buffers()
            | self._captured.buffers()
            | {f"resync_{k}": v for k, v in self.state._asdict().items()}
        )


def _setup(scenarios: Sequence[Scenario], h: float) -> Setup:
    n = len(scenarios)
    lowpass = np.array([0.0 if s.sensor.lowpass is None else 1.0 / (2.0 * math.pi * s.sensor.lowpass) for s in scenarios])
    leak = np.array([math.inf if s.sensor.time_constant is None else s.sensor.time_constant for s in scenarios])
    force = [force_section(s) for s in scenarios]
    setup = Setup(
        late=np.zeros(n, dtype=np.int64),
        part=np.zeros(n),
        weight=np.zeros(n),
        smooth=np.array([1.0 if T == 0.0 else 1.0 - math.exp(-h / T) for T in lowpass]),
        leak=np.exp(-h / leak),
        skip=np.ceil(cl.FILTER_MEMORY * lowpass / h).astype(np.int64),
        sigma=np.array([[s.sensor.noise, s.sensor.torque_noise] for s in scenarios]),
        blend=np.array([min(1.0 / f.blending, SYNC_LIMIT / h) for f in force]),
        estimate=np.array([int(f.delay == "estimate") for f in force]),
    )
    ideal = scenarios[0].rig.platform.tracking == "ideal"
    for i, s in enumerate(scenarios):
        _set_delay(i, s.sensor.delay, h, ideal, float(s.substeps), setup)
    return setup


def _state(scenarios: Sequence[Scenario], spacecraft: Spacecraft, late: int) -> State:
    n = spacecraft.n
    known = [force_section(s).contact for s in scenarios]
    rows = [cl.unknown() if c is None else cl.prior(c.stiffness, c.damping, c.touch) for c in known]
    spare = late + 64  # an estimated delay may be longer than the nominal one
    length = HISTORY + 2 * spare
    line = np.zeros((n, 3, 6))
    line[:, 0, 2] = 1.0
    tick = np.zeros((n, TICK), dtype=np.int64)
    tick[:, ANCHOR] = -1
    return State(
        tick=tick,
        q=np.stack([spacecraft.q, spacecraft.q], axis=1),
        v=np.stack([spacecraft.v, spacecraft.v], axis=1),
        wrench=np.zeros((n, length, 6)),
        x=np.zeros((n, length, 6)),
        rate=np.zeros((n, length, 6)),
        fit=np.array([fit for fit, _ in rows]),
        law=np.array([law for _, law in rows]),
        count=np.zeros((n, cl.COUNT), dtype=np.int64),
        line=line,
        regressor=np.zeros((n, 3, 2)),
        pending=np.zeros((n, 4)),
        filtered=np.zeros((n, 2, 2)),
        delay=np.array([s.sensor.delay for s in scenarios]),
        used=np.zeros((n, 6)),
        creep=np.zeros((n, 1)),
    )


@njit(cache=True)
def _set_delay(i, delay, h, ideal, substeps, setup):
    """Ticks and parts of a tick of a delay [s]. Between two substeps the sensor's reading is interpolated, the rate with it."""
    ticks = delay / h
    late = math.ceil(ticks - 1e-9)
    part = min(max(late - ticks, 0.0), 1.0)
    setup.late[i] = late
    setup.part[i] = part
    setup.weight[i] = min(1.0, part * substeps) if ideal else part


@njit(cache=True)
def _advance(h, kind, bodies, setup, state, wrench, pose, twist, ahead_pose, ahead_twist, predicted):
    """One tick of *behind* and *ahead* for every run; ``predicted`` (n, 6) is the wrench at t_k, at P's origin."""
    fixed, ideal, substeps = kind
    work = np.empty((SCRATCH, 7))
    rows = np.empty((8, 7))
    matrix = np.empty((6, 6))
    for i in range(pose.shape[0]):
        _remember(i, state, wrench[i], pose[i], twist[i])
        _identify(i, h, fixed, ideal, substeps, bodies, setup, state, work, rows)
        _catch_up(i, h, fixed, bodies, setup, state, work, rows)
        _predict(i, h, fixed, bodies, setup, state, work, rows, matrix, ahead_pose[i], ahead_twist[i], predicted[i])
        state.tick[i, DONE] += 1


@njit(cache=True, inline="always")
def _remember(i, state, wrench, pose, twist):
    slot = state.tick[i, DONE] % state.x.shape[1]
    for j in range(3):
        state.x[i, slot, j] = pose[j]
    rotation_vector(pose[3:7], state.x[i, slot, 3:6])
    for j in range(6):
        state.wrench[i, slot, j] = wrench[j]
        state.rate[i, slot, j] = twist[j]


@njit(cache=True, inline="always")
def _along(fixed, line, x):
    """``G.x``"""
    if fixed:
        return x[2]
    return line[0, 0] * x[0] + line[0, 1] * x[1] + line[0, 2] * x[2] + line[0, 3] * x[3] + line[0, 4] * x[4] + line[0, 5] * x[5]


@njit(cache=True, inline="always")
def _identify(i, h, fixed, ideal, substeps, bodies, setup, state, work, rows):
    """Take the reading of this tick beside the pose at the time it was felt."""
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
        rate[c] = (1.0 - w) * state.rate[i, j % length, c] + w * state.rate[i, min(j + 1, k) % length, c]
    wrench_at_A(state.wrench[i, k % length], position, at_A)
    y = at_A[2] if fixed else math.sqrt(at_A[0] ** 2 + at_A[1] ** 2 + at_A[2] ** 2)
    fit[cl.PEAK] = max(fit[cl.PEAK], y)
    filtered = setup.smooth[i] < 1.0
    gate = cl.GATE_PEAK_FILTERED if filtered and count[cl.ABOVE] > 0 and count[cl.SAMPLES] > 0 else cl.GATE_PEAK
    if y <= cl.GATE_SIGMA * setup.sigma[i, 0] or y <= gate * fit[cl.PEAK]:
        if count[cl.ABOVE] > 0 and fixed == 0:
            law[cl.ARMED] = 0.0  # the next contact may be elsewhere on the surface
        count[cl.ABOVE] = 0
        state.regressor[i] = 0.0
        return
    fade = math.exp(-h / cl.DIRECTION_MEMORY)
    sigma = setup.sigma[i]
    cl.direct(line, at_A, y, fixed, fade, (sigma[0] * sigma[0], sigma[1] * sigma[1]))
    if fixed:
        cl.rub(fit, law, line, at_A, rate, y, setup.sigma[i, 0])
    s, u = _along(fixed, line, position), _along(fixed, line, rate)
    count[cl.ABOVE] += 1
    if count[cl.ABOVE] == 1:
        _touched(i, h, fixed, ideal, substeps, s, u, bodies, setup, state, work)
        s = s if setup.late[i] == late and setup.part[i] == part else fit[cl.REFERENCE] + 0.5 * h * u
    if count[cl.ABOVE] > 2 + setup.skip[i]:  # the last sample of a contact is left out: it may be clipped
        cl.learn(fit, law, count, state.pending[i], setup.sigma[i, 0])
    _felt(s, u, setup.smooth[i], setup.leak[i], state.regressor[i], state.pending[i])
    state.pending[i, 3] = y


@njit(cache=True)
def _touched(i, h, fixed, ideal, substeps, s, u, bodies, setup, state, work):
    """A contact has begun: correct the delay by the instant of touch if asked to, keep *behind* as it is to run it again."""
    fit, law, count, tick = state.fit[i], state.law[i], state.count[i], state.tick[i]
    if setup.estimate[i] == 1 and count[cl.CONTACTS] == 0 and u > 0.0:
        late = setup.late[i]
        expected = law[cl.TOUCH] if law[cl.ARMED] == 1.0 else 0.0
        correction = (s - expected) / u - 0.5 * h  # the force began within the tick that ended here
        spare = (state.x.shape[1] - HISTORY) // 2
        delay = min(max(state.delay[i] + correction, 0.0), (spare - 2) * h)
        state.delay[i] = delay
        _set_delay(i, delay, h, ideal, substeps, setup)
        back = setup.late[i] - late
        if tick[BEHIND] - back < 0:
            back = tick[BEHIND]
        none = state.used[i]
        none[:] = 0.0
        carry(state.q[i, 0], state.v[i, 0], bodies.port[i], bodies.mass[i], bodies.inverse[i], -h * back, none, none, work)
        tick[BEHIND] -= back
        s = expected + 0.5 * h * u
    cl.touch(fit, law, count, s, u, h)
    _rewind(i, h, fixed, s, u, bodies, state, work)
    state.q[i, 1] = state.q[i, 0]
    state.v[i, 1] = state.v[i, 0]
    state.filtered[i, 1] = state.filtered[i, 0]
    tick[ANCHOR] = tick[BEHIND]
    tick[AGAIN] = cl.MINIMUM_SAMPLES


@njit(cache=True)
def _rewind(i, h, fixed, s, u, bodies, state, work):
    """A platform that lags touches later than *behind* does: take that back, in free flight, to where the rig touched."""
    tick, pose, at = state.tick[i], np.empty(7), np.empty(6)
    relative_motion(state.q[i, 0], state.v[i, 0], bodies.port[i], work, pose, at)
    at[0:3] = pose[0:3]
    rotation_vector(pose[3:7], at[3:6])
    reached = _along(fixed, state.line[i], at)
    ticks = int(min((reached - s) / (u * h), min(HISTORY // 4, tick[BEHIND]))) if u > 0.0 else 0
    if ticks < 1:
        return
    none = state.used[i]
    none[:] = 0.0
    carry(state.q[i, 0], state.v[i, 0], bodies.port[i], bodies.mass[i], bodies.inverse[i], -h * ticks, none, none, work)
    tick[BEHIND] -= ticks


@njit(cache=True, inline="always")
def _felt(x, v, smooth, leak, memory, out):
    """x, v and 1 as they pass the sensor's filters, from the touch on."""
    for c in range(3):
        u = x if c == 0 else v if c == 1 else 1.0
        before = memory[c, 0]
        memory[c, 0] += (u - before) * smooth
        if leak < 1.0:
            memory[c, 1] = leak * (memory[c, 1] + memory[c, 0] - before)
            out[c] = memory[c, 1]
        else:
            out[c] = memory[c, 0]


@njit(cache=True, inline="always")
def _catch_up(i, h, fixed, bodies, setup, state, work, rows):
    """Bring *behind* to where the last reading allows; from the touch on again when the law has become much better."""
    tick, count = state.tick[i], state.count[i]
    last = tick[DONE] - setup.late[i]
    if tick[ANCHOR] >= 0 and count[cl.SAMPLES] >= tick[AGAIN] and state.law[i, cl.KNOWN] == 1.0:
        tick[AGAIN] = 2 * count[cl.SAMPLES]
        if last - tick[ANCHOR] < HISTORY:
            state.q[i, 0] = state.q[i, 1]
            state.v[i, 0] = state.v[i, 1]
            state.filtered[i, 0] = state.filtered[i, 1]
            tick[BEHIND] = tick[ANCHOR]
    while tick[BEHIND] <= last:
        _step_behind(i, tick[BEHIND], h, fixed, bodies, setup, state, work, rows)
        tick[BEHIND] += 1


@njit(cache=True, inline="always")
def _step_behind(i, j, h, fixed, bodies, setup, state, work, rows):
    """*Behind* from t_j to t_(j+1), under the wrench that was felt at t_j, less what the rig was elsewhere than *behind* is."""
    length = state.x.shape[1]
    pose, twist, used, line, law = rows[0], rows[1], rows[2], state.line[i], state.law[i]
    known, part = j + setup.late[i], setup.part[i]
    late, early = state.wrench[i, known % length], state.wrench[i, (known - 1) % length]
    for c in range(6):
        used[c] = late[c] if part == 0.0 or known == 0 else (1.0 - part) * late[c] + part * early[c]
    x, v = state.x[i, j % length], state.rate[i, j % length]
    relative_motion(state.q[i, 0], state.v[i, 0], bodies.port[i], work, pose, twist)
    wrench_at_A(used, x, used)
    rig = cl.size(law, _along(fixed, line, x), _along(fixed, line, v))
    if law[cl.KNOWN] == 1.0:
        felt = state.filtered[i, 0]
        before = felt[0]
        felt[0] += (rig - before) * setup.smooth[i]
        felt[1] = setup.leak[i] * (felt[1] + felt[0] - before)
        rig = felt[0] if setup.leak[i] == 1.0 else felt[1]
    if rig == 0.0 and _silent(used, setup.sigma[i]):
        for c in range(6):
            used[c] = 0.0
    at = rows[3]
    for c in range(3):
        at[c] = pose[c]
    if not fixed:
        rotation_vector(pose[3:7], at[3:6])
    size = cl.size(law, _along(fixed, line, at), _along(fixed, line, twist))
    for c in range(6):
        used[c] += line[0, c] * (size - rig) if (c != 0 and c != 1) or law[cl.FRICTION] == 0.0 else 0.0
    if law[cl.FRICTION] > 0.0:
        _rub_behind(line, law, v, twist, rig, size, state.creep[i, 0], used)
    wrench_at_P(used, pose, used)
    for c in range(6):
        state.used[i, c] = used[c]
    step(
        state.q[i, 0], state.v[i, 0], bodies.port[i], bodies.mass[i], bodies.inertia[i], bodies.inverse[i], state.used[i], h, work,
    )  # fmt: skip


@njit(cache=True, inline="always")
def _rub_behind(line, law, rate, twist, rig, size, creep, used):
    """Add what friction does at *behind* more than it did at the rig."""
    sx, sy = cl.slip(line, twist)
    fx, fy = cl.friction(law, size, sx, sy, creep)
    sx, sy = cl.slip(line, rate)
    gx, gy = cl.friction(law, max(rig, 0.0), sx, sy, creep)
    fx -= gx
    fy -= gy
    used[0] += fx
    used[1] += fy
    used[5] -= line[0, 4] * fy + line[0, 3] * fx


@njit(cache=True, inline="always")
def _silent(wrench, sigma):
    """Whether a wrench is its noise alone: away from the contact it is left out, so that the model does not wander."""
    for c in range(6 if sigma[0] == 0.0 else 3):
        if abs(wrench[c]) > cl.GATE_SIGMA * sigma[0]:
            return False
    return True


@njit(cache=True, inline="always")
def _predict(i, h, fixed, bodies, setup, state, work, rows, matrix, pose, twist, predicted):
    """*Ahead*: from *behind* to t_(k+1), and the wrench at t_k."""
    line, law = state.line[i], state.law[i]
    ticks = state.tick[i, DONE] + 1 - state.tick[i, BEHIND]
    q, v, at = np.empty((2, 7)), np.empty((2, 6)), rows[3]
    sums = np.zeros((3, 6))  # force now, impulse, shift
    q[:] = state.q[i, 0]
    v[:] = state.v[i, 0]
    relative_motion(q, v, bodies.port[i], work, pose, twist)
    if ticks == 0:
        for c in range(6):
            predicted[c] = state.used[i, c]
        return
    for c in range(3):
        at[c] = pose[c]
    if not fixed:
        rotation_vector(pose[3:7], at[3:6])
    if law[cl.KNOWN] == 1.0:
        mobility(q, bodies.port[i], pose[0:3], bodies.mass[i], bodies.inverse[i], work, matrix)
        if law[cl.FRICTION] > 0.0:
            _slide(ticks, h, line, law, at[2], twist, matrix, state.creep[i], sums)
        else:
            _press(ticks, h, fixed, line, law, _along(fixed, line, at), _along(fixed, line, twist), matrix, sums)
    elif state.count[i, cl.ABOVE] > 0:  # until a handful of contact samples are in, hold the last force
        wrench_at_A(state.used[i], pose, sums[0])
        for c in range(6):
            sums[1, c] = h * ticks * sums[0, c]
            sums[2, c] = h * h * ticks * (ticks + 1) / 2 * sums[0, c]
    for c in range(3):
        wrench_at_P(sums[c], pose, sums[c])
    carry(q, v, bodies.port[i], bodies.mass[i], bodies.inverse[i], h * ticks, sums[1], sums[2], work)
    for c in range(6):
        predicted[c] = sums[0, c]
    relative_motion(q, v, bodies.port[i], work, pose, twist)


@njit(cache=True)
def _press(ticks, h, fixed, line, law, s, u, matrix, sums):
    """Step the size of the force alone; its direction stays."""
    gain, force, impulse, shift = 0.0, 0.0, 0.0, 0.0
    for a in range(6):
        for b in range(6):
            slope = (1.0 if a == 2 else 0.0) if fixed else line[0, a]
            gain += slope * matrix[a, b] * line[0, b]
    stiffness, damping, touch = law[cl.STIFFNESS], law[cl.DAMPING], law[cl.TOUCH]
    if law[cl.ARMED] == 0.0:
        touch = np.inf
    for _ in range(ticks):
        x = s - touch
        force = max(0.0, stiffness * x + damping * u) if x > 0.0 else 0.0
        u -= h * gain * force
        s += h * u
        impulse += h * force
        shift += h * impulse
    for c in range(6):
        sums[0, c] = force * line[0, c]
        sums[1, c] = impulse * line[0, c]
        sums[2, c] = shift * line[0, c]


@njit(cache=True)
def _slide(ticks, h, line, law, s, twist, matrix, creep, sums):
    """Step the normal force and the friction at the touching point; r = (-D4, D3, 0) is its place beside A's origin."""
    rx, ry = -line[0, 4], line[0, 3]
    gain = np.empty((3, 3))  # velocity of the touching point for an impulse there
    push = np.zeros(6)
    for b in range(3):
        push[:] = 0.0
        push[b] = 1.0
        push[3], push[4], push[5] = (ry, -rx, 0.0) if b == 2 else (0.0, 0.0, -ry if b == 0 else rx)
        for a in range(3):
            across = 0.0
            for c in range(6):
                row = matrix[a, c]
                if a == 2:
                    row += ry * matrix[3, c] - rx * matrix[4, c]
                else:
                    row += (-ry if a == 0 else rx) * matrix[5, c]
                across += row * push[c]
            gain[a, b] = across
    creep[0] = min(cl.CREEP, cl.CREEP_LIMIT / (h * max(gain[0, 0], gain[1, 1])))
    u = twist[2] + ry * twist[3] - rx * twist[4]
    sx, sy = cl.slip(line, twist)
    fx, fy, normal = 0.0, 0.0, 0.0
    ix, iy, iz, jx, jy, jz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(ticks):
        normal = cl.size(law, s, u)
        fx, fy = cl.friction(law, normal, sx, sy, creep[0])
        sx -= h * (gain[0, 0] * fx + gain[0, 1] * fy + gain[0, 2] * normal)
        sy -= h * (gain[1, 0] * fx + gain[1, 1] * fy + gain[1, 2] * normal)
        u -= h * (gain[2, 0] * fx + gain[2, 1] * fy + gain[2, 2] * normal)
        s += h * u
        ix, iy, iz = ix + h * fx, iy + h * fy, iz + h * normal
        jx, jy, jz = jx + h * ix, jy + h * iy, jz + h * iz
    _at_point(fx, fy, normal, rx, ry, sums[0])
    _at_point(ix, iy, iz, rx, ry, sums[1])
    _at_point(jx, jy, jz, rx, ry, sums[2])


@njit(cache=True, inline="always")
def _at_point(fx, fy, fz, rx, ry, out):
    """A force at (rx, ry, 0) beside A's origin as a wrench there."""
    out[0], out[1], out[2] = fx, fy, fz
    out[3], out[4], out[5] = ry * fz, -rx * fz, rx * fy - ry * fx


@njit(cache=True)
def _follow(h, bodies, blend, q, pose, twist, ahead_pose, ahead_twist, predicted, wrench):
    """The wrench that drives the commanded model: the predicted one, and what draws it to *ahead* in a critically damped way."""
    work = np.empty((SCRATCH, 7))
    matrix, factor = np.empty((6, 6)), np.empty((6, 6))
    free, offset, at_A = np.empty(6), np.empty(6), np.empty(6)
    between, turn = np.empty(4), np.empty(3)
    for i in range(pose.shape[0]):
        mobility(q[i], bodies.port[i], pose[i, 0:3], bodies.mass[i], bodies.inverse[i], work, matrix)
        wrench_at_A(predicted[i], pose[i], at_A)
        for a in range(6):
            free[a] = twist[i, a]
            for b in range(6):
                free[a] -= h * matrix[a, b] * at_A[b]
        quat_conj_mul(pose[i, 3:7], ahead_pose[i, 3:7], between)
        rotation_vector(between, turn)
        rotate(pose[i, 3:7], turn, offset[3:6])
        gain = blend[i]
        for a in range(3):
            offset[a] = ahead_pose[i, a] - pose[i, a]
        for a in range(6):
            offset[a] -= h * free[a]
            offset[a] = -gain * (gain * offset[a] + 2.0 * (ahead_twist[i, a] - free[a]))
        solve(matrix, offset, factor)
        for a in range(6):
            at_A[a] += offset[a]
        wrench_at_P(at_A, pose[i], wrench[i])
