"""The contact at an instant: where the surfaces meet, what the law makes of it, and the wrench that comes of it.

Normal force by the law (:mod:`hiltestbed.contact.law`); friction mu |F| v/sqrt(v^2 + v_0^2) with v_0 = 1e-4 m/s, in a servo no less than
what one physics step can follow. A latch holds A at a place in S by a spring and a damper on each of six axes, along z by the law.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hiltestbed.contact.cone import BUMPER, PROBE_CONE, Surfaces, meet
from hiltestbed.contact.law import STATES, contact_force
from hiltestbed.contact.parameters import BLUNT, DAMPING, FRICTION, LEVER, STIFFNESS, TILT_X, TILT_Y, ContactParameters
from hiltestbed.frames import Array, pose_between, quat_mul, rotate, rotate_back, rotation_vector

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

CREEP = 1e-4  # [m/s] speed below which friction is viscous
LATCH_RADIUS = 0.15  # [m] of the ring of latches: stiffness against turning is k LATCH_RADIUS^2
SURFACES: dict[str, Surfaces] = {"bumper": BUMPER, "latched": BUMPER, "probe_cone": PROBE_CONE}


class Touch:
    """The contacts of `n` runs.

    Attributes:
        parameters: (n, PARAMETERS). wrench: (n, 6) what the active side exerts on the passive one, in W at W's origin.
        depth, point, normal: (n, 2), (n, 2, 3), (n, 2, 3) of the contacts of tip and rod, in S (:mod:`hiltestbed.contact.cone`).
        touching: (n,) bool. latched: (n,) bool; hold: (n, 7) the pose of A in S that the latch holds.
    """

    def __init__(self, surfaces: Surfaces, parameters: Array, dt: float, least_creep: float, captured: bool) -> None:
        """``dt`` [s] between two instants; ``least_creep`` [m/s per N] bounds the slope of friction from above by that of a step,
        v_0 >= least_creep mu |F|; ``captured``: the latch holds from the start."""
        n = len(parameters)
        self.surfaces, self.parameters = surfaces, parameters
        self._dt, self._least_creep, self._always = dt, least_creep, captured
        self.state = np.zeros((n, 2, STATES))
        self.latched = np.full(n, captured)
        self.hold = np.zeros((n, 7))
        self.wrench = np.zeros((n, 6))
        self.touching = np.zeros(n, dtype=bool)
        self._pose, self._twist = np.zeros((n, 7)), np.zeros((n, 6))
        self.depth, self.rate = np.zeros((n, 2)), np.zeros((n, 2))
        self.point, self.normal, self.slip = np.zeros((n, 2, 3)), np.zeros((n, 2, 3)), np.zeros((n, 2, 3))
        self.reset()

    @classmethod
    def of(cls, scenarios: Sequence[Scenario], least_creep: float) -> Touch:
        """The contacts of scenarios of one mechanism, their effects included."""
        first = scenarios[0]
        rows = np.array([ContactParameters.believed(s.mechanism).with_effects(s.effects).row() for s in scenarios])
        return cls(SURFACES[first.mechanism.kind], rows, 1.0 / first.physics_rate, least_creep, first.mechanism.captured)

    def reset(self) -> None:
        """Unlatched, or latched with A at P where the mechanism always is."""
        self.latched[:] = self._always
        self.hold[:] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self.state[:] = 0.0

    def update(self, pose: Array, twist: Array, place: Array, motion: Array) -> None:
        """Set ``wrench`` from the pose (n, 7) and twist (n, 6) of A in W, and those of S, ``place`` and ``motion``; once an instant."""
        relate(pose, twist, place, motion, self._pose, self._twist)
        _press(
            self.surfaces.kind, self.surfaces.sizes, self._dt, self._least_creep, self.parameters, self._pose, self._twist, place,
            self.latched, self.hold, self.state, self.depth, self.rate, self.point, self.normal, self.slip, self.wrench, self.touching,
        )  # fmt: skip

    def close(self, which: NDArray[np.bool_]) -> None:
        """Latch the runs ``which`` (n,) where they are, under the force that they bear."""
        _hold(which & ~self.latched, self._pose, self.wrench, self.parameters, self.hold)
        self.latched |= which

    def relative(self) -> tuple[Array, Array]:
        """Pose (n, 7) and twist (n, 6) of A in S at the last update."""
        return self._pose, self._twist


def tilts(parameters: Array) -> Array:
    """``(n, 7)`` pose of the passive port in its nominal place, for contacts of the ``parameters`` (n, PARAMETERS): R_y R_x."""
    x, y = 0.5 * parameters[:, TILT_X], 0.5 * parameters[:, TILT_Y]
    out = np.zeros((len(parameters), 7))
    out[:, 3], out[:, 4] = np.sin(x) * np.cos(y), np.cos(x) * np.sin(y)
    out[:, 5], out[:, 6] = -np.sin(x) * np.sin(y), np.cos(x) * np.cos(y)
    return out


@njit(cache=True)
def relate_one(pose, twist, place, motion, pose_out, twist_out, work):
    """One run: pose and twist of A in S; positions, and velocities relative to S as it moves and turns, in S. ``work`` (1, 3): scratch."""
    v = work[0]
    pose_between(place, pose, pose_out)
    ax, ay, az = pose[0] - place[0], pose[1] - place[1], pose[2] - place[2]
    wx, wy, wz = motion[3], motion[4], motion[5]
    v[0] = twist[0] - motion[0] - (wy * az - wz * ay)
    v[1] = twist[1] - motion[1] - (wz * ax - wx * az)
    v[2] = twist[2] - motion[2] - (wx * ay - wy * ax)
    rotate_back(place[3:7], v, twist_out[0:3])
    for j in range(3):
        v[j] = twist[3 + j] - motion[3 + j]
    rotate_back(place[3:7], v, twist_out[3:6])


@njit(cache=True)
def relate(pose, twist, place, motion, pose_out, twist_out):
    """All runs: pose (n, 7) and twist (n, 6) of A in S."""
    work = np.empty((1, 3))
    for i in range(pose.shape[0]):
        relate_one(pose[i], twist[i], place[i], motion[i], pose_out[i], twist_out[i], work)


@njit(cache=True)
def _press(
    kind, sizes, dt, least_creep, parameters, pose, twist, place, latched, hold, state, depth, rate, point, normal, slip, wrench, touching
):
    """The wrench of each run in W at W's origin: first in S, then turned and moved by S's ``place`` (n, 7)."""
    local, work = np.empty(6), np.empty((6, 3))
    for i in range(pose.shape[0]):
        touching[i] = contact_wrench(
            kind, sizes, dt, least_creep, parameters[i], pose[i], twist[i], latched[i], hold[i], state[i],
            depth[i], rate[i], point[i], normal[i], slip[i], work, local,
        )  # fmt: skip
        to_frame(place[i], local, wrench[i])


@njit(cache=True)
def contact_wrench(
    kind, sizes, dt, least_creep, p, pose, twist, latched, hold, state, depth, rate, point, normal, slip, work, wrench
):  # fmt: skip
    """One contact at an instant: ``wrench`` (6,) in S at S's origin. Returns whether the surfaces touch.

    Args:
        kind, sizes: of the surfaces. dt: time since the last instant [s]. p: (PARAMETERS,). pose (7,), twist (6,): of A in S.
        state: (2, STATES) of the law at tip and rod, moved on. depth ... slip: (2, ...) geometry, see :func:`hiltestbed.contact.cone.meet`.
        work: (6, 3) scratch.
    """
    wrench[:] = 0.0
    f = work[5]
    if latched:
        depth[0], depth[1] = pose[2] - hold[2], -1.0
        rate[0], rate[1] = twist[2], 0.0
        _latch(p, dt, pose, twist, hold, state[0], f, wrench)
        return True
    meet(kind, sizes, pose, twist, p[LEVER], p[BLUNT], work, depth, rate, point, normal, slip)
    return surface_wrench(dt, least_creep, p, state, depth, rate, point, normal, slip, f, wrench)


@njit(cache=True)
def surface_wrench(dt, least_creep, p, state, depth, rate, point, normal, slip, f, wrench):
    """Add to ``wrench`` (6,) what the law makes of a geometry; returns whether the surfaces touch. ``f`` (3,) is scratch."""
    touching = False
    for c in range(2):
        push = contact_force(depth[c], rate[c], dt, p, state[c], False) if depth[c] > -1.0 else 0.0
        touching |= depth[c] > 0.0 or push != 0.0
        if push == 0.0:
            continue
        limit = p[FRICTION] * abs(push)
        v2 = slip[c, 0] ** 2 + slip[c, 1] ** 2 + slip[c, 2] ** 2
        creep = max(CREEP, least_creep * limit)
        drag = limit / math.sqrt(v2 + creep * creep)
        for j in range(3):
            f[j] = push * normal[c, j] + drag * slip[c, j]
        _add_at(point[c], f, wrench)
    return touching


@njit(cache=True)
def to_frame(place, local, wrench):
    """``wrench`` (6,) in W at W's origin of a wrench ``local`` (6,) in S at S's origin, S at ``place`` (7,) in W."""
    rotate(place[3:7], local[0:3], wrench[0:3])
    rotate(place[3:7], local[3:6], wrench[3:6])
    fx, fy, fz = wrench[0], wrench[1], wrench[2]
    wrench[3] += place[1] * fz - place[2] * fy
    wrench[4] += place[2] * fx - place[0] * fz
    wrench[5] += place[0] * fy - place[1] * fx


@njit(cache=True)
def _add_at(point, f, wrench):
    for j in range(3):
        wrench[j] += f[j]
    wrench[3] += point[1] * f[2] - point[2] * f[1]
    wrench[4] += point[2] * f[0] - point[0] * f[2]
    wrench[5] += point[0] * f[1] - point[1] * f[0]


@njit(cache=True)
def _latch(p, dt, pose, twist, hold, state, f, local):
    """Springs and dampers between A and where it is held in S, at A's origin; along z the law."""
    turn, q, inverse = np.empty(3), np.empty(4), np.empty(4)
    k, c = p[STIFFNESS], p[DAMPING]
    for j in range(3):
        inverse[j] = -hold[3 + j]
        f[j] = k * (pose[j] - hold[j]) + c * twist[j]
    inverse[3] = hold[6]
    f[2] = contact_force(pose[2] - hold[2], twist[2], dt, p, state, True)
    quat_mul(pose[3:7], inverse, q)
    rotation_vector(q, turn)
    for j in range(3):
        local[3 + j] = LATCH_RADIUS**2 * (k * turn[j] + c * twist[3 + j])
    _add_at(pose[0:3], f, local)


@njit(cache=True)
def _hold(which, pose, wrench, parameters, hold):
    """Where the latches hold A so that at the instant of closing their springs bear the force that the contact bore."""
    for i in range(pose.shape[0]):
        if which[i]:
            hold[i] = pose[i]
            for j in range(3):
                hold[i, j] -= wrench[i, j] / parameters[i, STIFFNESS]


@njit(cache=True)
def load_body(sign, wrench, body, centre, xfrc):
    """Write ``sign`` times the wrench (n, 6), in W at W's origin, to ``xfrc`` (n, nbody, 6) of a body.

    MuJoCo's ``xfrc_applied`` is force and torque at the body's centre of mass, ``centre`` (n, 3) in W.
    """
    for i in range(wrench.shape[0]):
        c, f, out = centre[i], wrench[i], xfrc[i, body]
        for j in range(3):
            out[j] = sign * f[j]
        out[3] = sign * (f[3] - (c[1] * f[2] - c[2] * f[1]))
        out[4] = sign * (f[4] - (c[2] * f[0] - c[0] * f[2]))
        out[5] = sign * (f[5] - (c[0] * f[1] - c[1] * f[0]))
