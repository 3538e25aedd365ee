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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.resynchronised import contact_estimate as ce
from hiltestbed.compensation.resynchronised.captured import CapturedContact
from hiltestbed.compensation.resynchronised.delayed_model import ANCHOR, DONE, HISTORY, TICK, catch_up, identify, remember, set_delay
from hiltestbed.compensation.resynchronised.predictor import predict
from hiltestbed.compensation.resynchronised.settings import Resynchronised
from hiltestbed.compensation.settings import force_of
from hiltestbed.frames import Array, quat_conj_mul, rotate, rotation_vector
from hiltestbed.jit import njit
from hiltestbed.numerical_model.kernels import SCRATCH, mobility, solve, wrench_at_A, wrench_at_P
from hiltestbed.numerical_model.model import NumericalModel

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

SYNC_LIMIT = 0.5  # of a tick: the fastest blending that the semi-implicit step carries well
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


class ResynchronisedDrive:
    """The drive for ``n`` runs: ``pose``, ``twist`` and ``wrench`` of the commanded numerical model.

    Attributes:
        stiffness, damping, touch: ``(n,)`` of the contact law identified so far; 0 while nothing is known.
        delay: ``(n,)`` [s] of the force as believed, estimated from the instant of touch where the scenario asks for it.
    """

    def __init__(self, model: NumericalModel, scenarios: Sequence[Scenario]) -> None:
        n, h = model.n, model.tick
        self.model = model
        self.pose, self.twist = model.pose, model.twist
        self.wrench = np.zeros((n, 6))
        self.ahead_pose, self.ahead_twist = np.zeros((n, 7)), np.zeros((n, 6))
        self._predicted = np.zeros((n, 6))
        self._setup = _setup(scenarios, h)
        self._fixed = int(scenarios[0].mechanism.flat)
        self._captured = None if self._fixed else CapturedContact(scenarios)  # a bumper has no latches
        self._ideal = int(scenarios[0].rig.platform.prescribed)
        self._substeps = float(scenarios[0].substeps)
        self._bodies = Bodies(model.port, model.mass, model.inertia, np.linalg.inv(model.inertia).astype(np.float64))
        self.state = _state(scenarios, model, int(self._setup.late.max()))
        law = self.state.law
        self.stiffness, self.damping, self.touch = law[:, ce.STIFFNESS], law[:, ce.DAMPING], law[:, ce.TOUCH]
        self.delay = self.state.delay

    def advance(self, measurement: Measurement) -> None:
        """Move on by one tick."""
        model = self.model
        _advance(
            model.tick, (self._fixed, self._ideal, self._substeps), self._bodies, self._setup, self.state,
            measurement.wrench, measurement.pose, measurement.twist, self.ahead_pose, self.ahead_twist, self._predicted,
        )  # fmt: skip
        _follow(
            model.tick, self._bodies, self._setup.blend, model.centres(), model.pose, model.twist,
            self.ahead_pose, self.ahead_twist, self._predicted, self.wrench,
        )  # fmt: skip
        if self._captured:
            self._captured.take_over(measurement, self.wrench)
        model.advance(self.wrench)


def _setup(scenarios: Sequence[Scenario], h: float) -> Setup:
    n = len(scenarios)
    lowpass = np.array([0.0 if s.sensor.lowpass is None else 1.0 / (2.0 * math.pi * s.sensor.lowpass) for s in scenarios])
    leak = np.array([math.inf if s.sensor.time_constant is None else s.sensor.time_constant for s in scenarios])
    force = force_of(scenarios, Resynchronised)
    setup = Setup(
        late=np.zeros(n, dtype=np.int64),
        part=np.zeros(n),
        weight=np.zeros(n),
        smooth=np.array([1.0 if T == 0.0 else 1.0 - math.exp(-h / T) for T in lowpass]),
        leak=np.exp(-h / leak),
        skip=np.ceil(ce.FILTER_MEMORY * lowpass / h).astype(np.int64),
        sigma=np.array([[s.sensor.noise, s.sensor.torque_noise] for s in scenarios]),
        blend=np.array([min(1.0 / f.blending, SYNC_LIMIT / h) for f in force]),
        estimate=np.array([int(f.delay == "estimate") for f in force]),
    )
    ideal = scenarios[0].rig.platform.prescribed
    for i, s in enumerate(scenarios):
        set_delay(i, s.sensor.delay, h, ideal, float(s.substeps), setup)
    return setup


def _state(scenarios: Sequence[Scenario], model: NumericalModel, late: int) -> State:
    n = model.n
    known = [force.contact for force in force_of(scenarios, Resynchronised)]
    rows = [ce.unknown() if c is None else ce.prior(c.stiffness, c.damping, c.touch) for c in known]
    spare = late + 64  # an estimated delay may be longer than the nominal one
    length = HISTORY + 2 * spare
    line = np.zeros((n, 3, 6))
    line[:, 0, 2] = 1.0
    q, v = model.believed_start()
    tick = np.zeros((n, TICK), dtype=np.int64)
    tick[:, ANCHOR] = -1
    return State(
        tick=tick,
        q=np.stack([q, q], axis=1),
        v=np.stack([v, v], axis=1),
        wrench=np.zeros((n, length, 6)),
        x=np.zeros((n, length, 6)),
        rate=np.zeros((n, length, 6)),
        fit=np.array([fit for fit, _ in rows]),
        law=np.array([law for _, law in rows]),
        count=np.zeros((n, ce.COUNT), dtype=np.int64),
        line=line,
        regressor=np.zeros((n, 3, 2)),
        pending=np.zeros((n, 4)),
        filtered=np.zeros((n, 2, 2)),
        delay=np.array([s.sensor.delay for s in scenarios]),
        used=np.zeros((n, 6)),
        creep=np.zeros((n, 1)),
    )


@njit(cache=True)
def _advance(h, kind, bodies, setup, state, wrench, pose, twist, ahead_pose, ahead_twist, predicted):
    """One tick of *behind* and *ahead* for every run; ``predicted`` (n, 6) is the wrench at t_k, at P's origin."""
    fixed, ideal, substeps = kind
    work = np.empty((SCRATCH, 7))
    rows = np.empty((8, 7))
    matrix = np.empty((6, 6))
    for i in range(pose.shape[0]):
        remember(i, state, wrench[i], pose[i], twist[i])
        identify(i, h, fixed, ideal, substeps, bodies, setup, state, work, rows)
        catch_up(i, h, fixed, bodies, setup, state, work, rows)
        predict(i, h, fixed, bodies, setup, state, work, rows, matrix, ahead_pose[i], ahead_twist[i], predicted[i])
        state.tick[i, DONE] += 1


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
