"""Resynchronised prediction: the measured wrench drives a delayed model at t - tau, from which a
predictor computes the present state.

Only the measurement is delayed, so the past is known exactly. Three copies of the numerical model
are used:

- The *delayed model* is at t - tau and is driven by the measured wrench, which acted at that time.
  Where the rig's pose differed from that of the delayed model (the platform lags, or an early
  prediction was wrong), the contact law corrects the wrench to ``F_meas + M(x_delayed, v_delayed) -
  M(x_act, v_act)``.
- The *predictor* starts from the delayed model and propagates it over tau with the contact law
  identified so far. Only the magnitude of the force along the line of action is stepped; its
  impulse and its second integral are applied to the bodies at once.
- The *commanded model* is the numerical model that the rig follows. It is driven with the predicted
  wrench, and drawn to the predicted state like a critically damped spring would, so that a
  correction of the prediction does not jerk the platform. The spring is softer where the drives
  could not follow it.

After capture all six axes act at once, and
:mod:`hiltestbed.compensation.force_methods.reconstruction` provides the wrench.

The delay that the scenario states need not be right: delay and contact are fitted together
(:mod:`~hiltestbed.compensation.resynchronised.contact_fit`), and a delay that the samples refuse is
replaced.

Once a first contact is identified, the delayed model is re-run from the touch with the contact law,
which removes the effect of the first tau, in which no force had been measured yet. The method was
developed for this project; the idea of correcting a past state by a late measurement and predicting
from it is that of filters with delayed measurements (H. Alexander, "State estimation for
distributed systems with sensing delay", SPIE 1470, 1991).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compensation.force_methods.reconstruction import CapturedContact
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.resynchronised import contact_estimate as ce
from hiltestbed.compensation.resynchronised.delayed_model import (
    ANCHOR,
    DONE,
    DRIFT,
    HISTORY,
    TICK,
    TOLD,
    catch_up,
    identify,
)
from hiltestbed.compensation.resynchronised.predictor import predict
from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, quat_conj_mul, rotate, rotation_vector
from hiltestbed.identification.samples import FILTER_MEMORY
from hiltestbed.numerical_model.kernels import SCRATCH, mobility, solve, wrench_at_A, wrench_at_P
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.sensor.chain import FILTERED, filters_of, high_pass, low_pass
from hiltestbed.sensor.settings import Sensor

# Part of a drive's force that a correction may take; the rest is for the contact and the position
# loop, whose answer to a step of force may reach as much again. At 0.73 of it the shipped arm with
# drives of 6 Hz reached its limit.
SHARE = 0.5
SYNC_LIMIT = 0.5  # largest blending rate per tick at which the semi-implicit step is accurate
Integers = NDArray[np.int64]


class NominalBodies(NamedTuple):
    """Nominal parameters of both vehicles, ``(n, 2, ...)``."""

    port: Array
    mass: Array
    inertia: Array
    inverse: Array


class Setup(NamedTuple):
    """Numbers of each run, ``(n, ...)``."""

    smooth: Array  # (n, 2) weights per tick of the sensor's low-pass
    leak: Array  # (n, 2) factors per tick of its high-pass
    skip: Integers  # samples skipped after the touch because of the low-pass's memory
    sigma: Array  # (n, 2) noise of forces and torques
    blend: Array  # [rad/s]
    shares: Array  # (n, J, 6) of the drives' forces that an acceleration takes
    estimate: Array  # whether the delay is fitted


class State(NamedTuple):
    """The state, updated at every tick, ``(n, ...)``."""

    tick: Integers
    q: Array  # (n, 2, 2, 7): of the delayed model, now and at the touch
    v: Array
    wrench: Array  # (n, L, 6) as measured, tick j at slot j modulo L
    x: Array  # (n, L, 6) pose of A in P that the rig reached: position, rotation vector
    rate: Array  # (n, L, 6) its twist
    fit: Array
    law: Array
    count: Integers
    line: Array  # (n, 3, 6)
    regressor: Array  # (n, 3, FILTERED) of x, v, 1 in the model of the sensor's filters
    pending: Array  # (n, 4) the last sample, not yet in the fit
    filtered: Array  # (n, 2, FILTERED) of the law's force at the rig, now and at the touch
    delay: Array  # (n,) [s] nominal or estimated
    drift: Array  # (n, DRIFT) of the delay
    # (n, 2) [ticks] time constant of the low-pass, nominal or estimated; whether it is digital
    lag: Array
    delay_half_width: Array  # (n,) [s] of an estimated delay; 0: nominal
    told: Array  # (n, TOLD) what was believed when this contact began
    used: Array  # (n, 6) wrench in the delayed model's last step
    creep: Array  # (n, 1) [N s/m] viscous friction at low slip


class Copy(NamedTuple):
    """A copy of the numerical model, of n runs.

    Attributes:
        tick: [s]. fixed: whether the direction of the force is known. ideal: whether the platform
            is prescribed. substeps: of the physics in a tick.
    """

    tick: float
    fixed: bool
    ideal: bool
    substeps: float
    bodies: NominalBodies
    setup: Setup
    state: State


class PredictionParameters(NamedTuple):
    """What the prediction of one run is given.

    Attributes:
        blending: [s] time constant of corrections. estimate: whether the delay is corrected.
        known: stiffness [N/m], damping [N s/m] and touch [m] of a contact identified beforehand.
        shares: (J, 6) of the drives' forces that an acceleration takes [s^2/m, s^2/rad].
        sensor: the nominal one.
    """

    blending: float
    estimate: bool
    known: tuple[float, float, float] | None
    shares: Array
    sensor: Sensor


class ResynchronisedDrive:
    """The drive for ``n`` runs: ``pose``, ``twist`` and ``wrench`` of the commanded numerical
    model.

    Attributes:
        stiffness, damping, touch: ``(n,)`` of the contact law identified so far; 0 before the first
            estimate.
        delay: ``(n,)`` [s] of the force, nominal, or estimated where a contact refused that.
        delay_half_width: ``(n,)`` [s] of the 95 % interval of an estimated delay, 0 of a nominal
            one.
    """

    def __init__(
        self,
        model: NumericalModel,
        given: Sequence[PredictionParameters],
        substeps: int,
        prescribed: bool,
        captured: CapturedContact | None,
    ) -> None:
        """``substeps``: of the physics in a tick. prescribed: whether the platform is. captured:
        takes over once captured; None: the contact is with a plane, and nothing captures.
        """
        n, h = model.n, model.tick
        self.model = model
        self.pose, self.twist = model.pose, model.twist
        self.wrench = np.zeros((n, 6))
        self.predicted_pose, self.predicted_twist = np.zeros((n, 7)), np.zeros((n, 6))
        self._predicted = np.zeros((n, 6))
        lowpass, leak = filters_of([f.sensor for f in given])
        setup = Setup(
            smooth=low_pass(lowpass, h),
            leak=high_pass(leak, h),
            skip=np.ceil(FILTER_MEMORY * lowpass / h).astype(np.int64),
            sigma=np.array([[f.sensor.noise, f.sensor.torque_noise] for f in given]),
            blend=np.array([min(1.0 / f.blending, SYNC_LIMIT / h) for f in given]),
            shares=np.array([f.shares for f in given]),
            estimate=np.array([int(f.estimate) for f in given]),
        )
        bodies = NominalBodies(
            model.port, model.mass, model.inertia, np.linalg.inv(model.inertia).astype(np.float64)
        )
        self.state = _state(given, model)
        flat, self._captured = captured is None, captured
        copy = Copy(h, flat, prescribed, float(substeps), bodies, setup, self.state)
        predicted = (self.predicted_pose, self.predicted_twist, self._predicted)
        self._advanced = Call(_advance, copy, GIVEN, GIVEN, GIVEN, *predicted)
        self._followed = Call(_follow, copy, GIVEN, self.pose, self.twist, *predicted, self.wrench)
        law = self.state.law
        self.stiffness = law[:, ce.STIFFNESS]
        self.damping = law[:, ce.DAMPING]
        self.touch = law[:, ce.TOUCH]
        self.delay, self.delay_half_width = self.state.delay, self.state.delay_half_width

    def advance(self, measurement: Measurement) -> None:
        """Advance by one tick."""
        self._advanced.on(measurement.wrench, measurement.pose, measurement.twist)()
        self._followed.on(self.model.centres())()
        if self._captured:
            self._captured.take_over(measurement, self.wrench)
        self.model.advance(self.wrench)


def _state(given: Sequence[PredictionParameters], model: NumericalModel) -> State:
    n, sensors = model.n, [f.sensor for f in given]
    rows = [ce.unknown() if f.known is None else ce.prior(*f.known) for f in given]
    late = math.ceil(max(s.delay for s in sensors) / model.tick)
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
        regressor=np.zeros((n, 3, FILTERED)),
        pending=np.zeros((n, 4)),
        filtered=np.zeros((n, 2, FILTERED)),
        delay=np.array([s.delay for s in sensors]),
        drift=np.zeros((n, DRIFT)),
        lag=np.stack([filters_of(sensors)[0] / model.tick, np.zeros(n)], axis=1),
        delay_half_width=np.zeros(n),
        told=np.zeros((n, TOLD)),
        used=np.zeros((n, 6)),
        creep=np.zeros((n, 1)),
    )


@njit(cache=True)
def _advance(m, wrench, pose, twist, predicted_pose, predicted_twist, predicted):
    """Delayed model and predictor, a tick; ``predicted`` (n, 6): wrench at t_k, at P's origin."""
    work = np.empty((SCRATCH, 7))
    rows = np.empty((8, 7))
    matrix = np.empty((6, 6))
    for i in range(pose.shape[0]):
        state, slot = m.state, m.state.tick[i, DONE] % m.state.x.shape[1]
        for j in range(3):
            state.x[i, slot, j] = pose[i, j]
        rotation_vector(pose[i, 3:7], state.x[i, slot, 3:6])
        for j in range(6):
            state.wrench[i, slot, j] = wrench[i, j]
            state.rate[i, slot, j] = twist[i, j]
        identify(i, m, work, rows)
        catch_up(i, m, work, rows)
        pose_out, twist_out, wrench_out = predicted_pose[i], predicted_twist[i], predicted[i]
        predict(i, m, work, rows[3], matrix, pose_out, twist_out, wrench_out)
        m.state.tick[i, DONE] += 1


@njit(cache=True)
def _follow(m, q, pose, twist, predicted_pose, predicted_twist, predicted, wrench):
    """The predicted wrench plus a critically damped pull to the predicted state."""
    h, bodies, blend = m.tick, m.bodies, m.setup.blend
    work = np.empty((SCRATCH, 7))
    matrix, factor = np.empty((6, 6)), np.empty((6, 6))
    free, offset, slower, at_A = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    between, turn = np.empty(4), np.empty(3)
    for i in range(pose.shape[0]):
        mobility(
            q[i], bodies.port[i], pose[i, 0:3], bodies.mass[i], bodies.inverse[i], work, matrix
        )
        wrench_at_A(predicted[i], pose[i], at_A)
        for a in range(6):
            free[a] = twist[i, a]
            for b in range(6):
                free[a] -= h * matrix[a, b] * at_A[b]
        quat_conj_mul(pose[i, 3:7], predicted_pose[i, 3:7], between)
        rotation_vector(between, turn)
        rotate(pose[i, 3:7], turn, offset[3:6])
        for a in range(3):
            offset[a] = predicted_pose[i, a] - pose[i, a]
        for a in range(6):
            offset[a] -= h * free[a]
            slower[a] = predicted_twist[i, a] - free[a]
        # at that pull, or the one that takes at most SHARE of each drive: gain^2 far + 2 gain fast
        gain, shares, far, fast = blend[i], m.setup.shares[i], 0.0, 0.0
        for j in range(shares.shape[0]):
            x, v = 0.0, 0.0
            for a in range(6):
                x += shares[j, a] * offset[a]
                v += shares[j, a] * slower[a]
            far, fast = max(far, abs(x)), max(fast, abs(v))
        if gain * (gain * far + 2.0 * fast) > SHARE:
            gain = SHARE / (fast + np.sqrt(fast * fast + SHARE * far))
        for a in range(6):
            offset[a] = -gain * (gain * offset[a] + 2.0 * slower[a])
        solve(matrix, offset, factor)
        for a in range(6):
            at_A[a] += offset[a]
        wrench_at_P(at_A, pose[i], wrench[i])
