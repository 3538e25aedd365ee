"""The bodies of many runs, accelerated by Pinocchio.

One Pinocchio model holds the bodies of up to :data:`RUNS_PER_MODEL` runs, so that one call of the
articulated-body algorithm (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, table 9.6)
accelerates them all. The linear velocity is kept in the inertial frame, so that the semi-implicit
step adds ``h f`` to the momentum of one body and subtracts it from the other; in the body frame,
that of Pinocchio's free-flyer joint, the same step would lose momentum with every rotation of the
frame. A body's acceleration does not depend on its linear velocity, so Pinocchio is given each body
in a frame that moves along with it (zero linear velocity).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array, rotate, rotate_back

RUNS_PER_MODEL = (
    # Pinocchio's Data holds several (nv, nv, nv) tensors: at 6 runs, nv = 72, 12 MB and 2 ms to
    # make; at 16, 230 MB and 0.2 s
    6
)


class FreeFlyers:
    """The Pinocchio models of bodies of ``mass`` ``(n, 2)`` [kg] and ``inertia`` ``(n, 2, 3, 3)``
    [kg m^2].

    Attributes:
        seen: poses (n, 2, 7), velocities and forces (n, 2, 6) as :func:`as_seen` writes them.
            acceleration: (n, 2, 6) in body axes.
    """

    def __init__(self, mass: Array, inertia: Array) -> None:
        n = len(mass)
        self._q, self._v, self._tau = np.zeros((n, 2, 7)), np.zeros((n, 2, 6)), np.zeros((n, 2, 6))
        self.seen, self.acceleration = (self._q, self._v, self._tau), np.zeros((n, 2, 6))
        self._models = []
        for start in range(0, n, RUNS_PER_MODEL):
            runs = slice(start, start + RUNS_PER_MODEL)
            model = _model(mass[runs], inertia[runs])
            views = [array[runs].reshape(-1) for array in (*self.seen, self.acceleration)]
            self._models.append((model, model.createData(), *views))

    def accelerate(self, q: Array, v: Array, tau: Array, tick: float) -> None:
        """Add to ``v`` the change of a tick under ``tau``, force inertial, torque in body axes."""
        as_seen(q, v, tau, *self.seen)
        self.solve()
        gain_speed(q, self.acceleration, tick, v)

    def solve(self) -> None:
        """Compute the ``acceleration`` of the bodies from ``seen``."""
        for model, data, q_, v_, tau_, out in self._models:
            out[:] = pin.aba(model, data, q_, v_, tau_)


def _model(mass: Array, inertia: Array) -> pin.Model:
    """Free-flyers of ``mass`` (r, 2), ``inertia`` (r, 2, 3, 3) about their centres; no gravity."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    for i in range(len(mass)):
        for b in range(2):
            joint = model.addJoint(
                0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body_{i}_{b}"
            )
            model.appendBodyToJoint(
                joint, pin.Inertia(mass[i, b], np.zeros(3), inertia[i, b]), pin.SE3.Identity()
            )
    return model


@njit(cache=True)
def as_seen(q, v, tau, q_seen, v_seen, tau_seen):
    """Pinocchio's inputs, in body axes and a frame that moves along with each body."""
    for i in range(q.shape[0]):
        for b in range(2):
            for j in range(3, 7):
                q_seen[i, b, j] = q[i, b, j]
            rotate_back(q[i, b, 3:7], tau[i, b, 0:3], tau_seen[i, b, 0:3])
            for j in range(3, 6):
                v_seen[i, b, j] = v[i, b, j]
                tau_seen[i, b, j] = tau[i, b, j]


@njit(cache=True)
def gain_speed(q, acceleration, tick, v):
    """Add the ``acceleration`` (n, 2, 6), in body axes, times a tick [s] to ``v`` (n, 2, 6)."""
    linear = np.empty(3)
    for i in range(q.shape[0]):
        for b in range(2):
            rotate(q[i, b, 3:7], acceleration[i, b, 0:3], linear)
            for j in range(3):
                v[i, b, j] += tick * linear[j]
                v[i, b, 3 + j] += tick * acceleration[i, b, 3 + j]
