"""The contact as a force that is applied: surfaces in closed form, any law, friction, a latch that pulls as well as pushes.

MuJoCo's own contact serves the plain bumper (:mod:`hiltestbed.rig.contact`); it can neither pull nor follow a cone. Here the wrench
of the state at the start of a step is written to ``xfrc_applied`` of both bodies, so that the sensor feels it as it feels any other.

Normal force k x + c v, never negative, or the law's; friction mu |F| v/sqrt(v^2 + v_0^2) with v_0 = 1e-4 m/s, in a servo no less than
what one physics step can follow. A latch holds A at a place in S by a spring and a damper on each of six axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hiltestbed.frames import Array, pose_between, quat_mul, rotate, rotate_back, rotation_vector
from hiltestbed.rig.contact import ContactLaw
from hiltestbed.rig.surfaces import BUMPER, PROBE_CONE, TIP, Surfaces, meet

if TYPE_CHECKING:
    from hiltestbed.scenario import Scenario

CREEP = 1e-4  # [m/s] speed below which friction is viscous
LATCH_RADIUS = 0.15  # [m] of the ring of latches: stiffness against turning is k LATCH_RADIUS^2
SURFACES: dict[str, Surfaces] = {"bumper": BUMPER, "latched": BUMPER, "probe_cone": PROBE_CONE}


class Touch:
    """The contacts of `n` runs.

    Attributes:
        wrench: (n, 6) what the active side exerts on the passive one, in W at W's origin.
        depth, point, normal: (n, 2), (n, 2, 3), (n, 2, 3) of the contacts of tip and rod, in S (:mod:`hiltestbed.rig.surfaces`).
        touching: (n,) bool. law: in place of k x + c v for the tip, or None.
        latched: (n,) bool; hold: (n, 7) the pose of A in S that the latch holds.
    """

    def __init__(self, scenarios: Sequence[Scenario], least_creep: float) -> None:
        """``least_creep`` [m/s per N] bounds the slope of friction from above by that of a step: v_0 >= least_creep mu |F|."""
        n = len(scenarios)
        kind = scenarios[0].mechanism.kind
        self.surfaces = SURFACES[kind]
        self.law: ContactLaw | None = None
        contacts = [s.mechanism.contact for s in scenarios]
        self.stiffness = np.array([c.stiffness for c in contacts])
        self.damping = np.array([c.damping for c in contacts])
        self.friction = np.array([c.friction for c in contacts])
        self._least_creep = least_creep
        self._always = kind == "latched"
        self.latched = np.full(n, self._always)
        self.hold = np.zeros((n, 7))
        self.wrench = np.zeros((n, 6))
        self.touching = np.zeros(n, dtype=bool)
        self._pose, self._twist = np.zeros((n, 7)), np.zeros((n, 6))
        self.depth, self._rate, self._force = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2))
        self._x, self._v = np.zeros(n), np.zeros(n)
        self.point, self.normal, self._slip = np.zeros((n, 2, 3)), np.zeros((n, 2, 3)), np.zeros((n, 2, 3))

    def reset(self) -> None:
        """Unlatched, or latched with A at P where the mechanism always is."""
        self.latched[:] = self._always
        self.hold[:] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def update(self, pose: Array, twist: Array, place: Array, motion: Array) -> None:
        """Set ``wrench`` from the pose (n, 7) and twist (n, 6) of A in W, and those of S, ``place`` and ``motion``; once an instant."""
        relate(pose, twist, place, motion, self._pose, self._twist)
        _geometry(
            self.surfaces.kind, self.surfaces.sizes, self._pose, self._twist, self.latched, self.hold,
            self.depth, self._rate, self.point, self.normal, self._slip,
        )  # fmt: skip
        linear = self.law is None
        if self.law is not None:
            self._x[:], self._v[:] = self.depth[:, TIP], self._rate[:, TIP]
            self._force[:, TIP] = self.law.force(self._x, self._v)
        _wrenches(
            linear, self.stiffness, self.damping, self.friction, self._least_creep, self._pose, self._twist, self.latched, self.hold,
            self.depth, self._rate, self.point, self.normal, self._slip, self._force, place, self.wrench, self.touching,
        )  # fmt: skip

    def close(self, which: NDArray[np.bool_]) -> None:
        """Latch the runs ``which`` (n,) where they are, under the force that they bear."""
        _hold(which & ~self.latched, self._pose, self.wrench, self.stiffness, self.hold)
        self.latched |= which

    def relative(self) -> tuple[Array, Array]:
        """Pose (n, 7) and twist (n, 6) of A in S at the last update."""
        return self._pose, self._twist

    def buffers(self) -> dict[str, NDArray[Any]]:
        """The state between two ticks."""
        return {"touch_wrench": self.wrench, "touching": self.touching, "latched": self.latched, "hold": self.hold}


@njit(cache=True)
def relate(pose, twist, place, motion, pose_out, twist_out):
    """Pose and twist of A in S: positions, and velocities relative to S as it moves and turns, in S."""
    v = np.empty(3)
    for i in range(pose.shape[0]):
        pose_between(place[i], pose[i], pose_out[i])
        ax, ay, az = pose[i, 0] - place[i, 0], pose[i, 1] - place[i, 1], pose[i, 2] - place[i, 2]
        wx, wy, wz = motion[i, 3], motion[i, 4], motion[i, 5]
        v[0] = twist[i, 0] - motion[i, 0] - (wy * az - wz * ay)
        v[1] = twist[i, 1] - motion[i, 1] - (wz * ax - wx * az)
        v[2] = twist[i, 2] - motion[i, 2] - (wx * ay - wy * ax)
        rotate_back(place[i, 3:7], v, twist_out[i, 0:3])
        for j in range(3):
            v[j] = twist[i, 3 + j] - motion[i, 3 + j]
        rotate_back(place[i, 3:7], v, twist_out[i, 3:6])


@njit(cache=True)
def _geometry(kind, sizes, pose, twist, latched, hold, depth, rate, point, normal, slip):
    for i in range(pose.shape[0]):
        if latched[i]:
            depth[i, 0], depth[i, 1] = pose[i, 2] - hold[i, 2], -1.0
            rate[i, 0], rate[i, 1] = twist[i, 2], 0.0
        else:
            meet(kind, sizes, pose[i], twist[i], depth[i], rate[i], point[i], normal[i], slip[i])


@njit(cache=True)
def _wrenches(
    linear, stiffness, damping, friction, least_creep, pose, twist, latched, hold,
    depth, rate, point, normal, slip, force, place, wrench, touching,
):  # fmt: skip
    """The wrench of each run in W at W's origin: contacts or latch, first in S, then turned and moved by S's ``place`` (n, 7)."""
    local = np.empty(6)
    f = np.empty(3)
    for i in range(pose.shape[0]):
        local[:] = 0.0
        touching[i] = latched[i]
        if latched[i]:
            _latch(linear, stiffness[i], damping[i], pose[i], twist[i], hold[i], force[i, 0], local)
        else:
            for c in range(2):
                x = depth[i, c]
                if linear or c == 1:
                    force[i, c] = max(stiffness[i] * x + damping[i] * rate[i, c], 0.0) if x > 0.0 else 0.0
                push = force[i, c]
                touching[i] |= x > 0.0 or push != 0.0
                if push == 0.0:
                    continue
                limit = friction[i] * abs(push)
                v2 = slip[i, c, 0] ** 2 + slip[i, c, 1] ** 2 + slip[i, c, 2] ** 2
                creep = max(CREEP, least_creep * limit)
                drag = limit / math.sqrt(v2 + creep * creep)
                for j in range(3):
                    f[j] = push * normal[i, c, j] + drag * slip[i, c, j]
                _add_at(point[i, c], f, local)
        rotate(place[i, 3:7], local[0:3], wrench[i, 0:3])
        rotate(place[i, 3:7], local[3:6], wrench[i, 3:6])
        f[:] = wrench[i, 0:3]
        wrench[i, 3] += place[i, 1] * f[2] - place[i, 2] * f[1]
        wrench[i, 4] += place[i, 2] * f[0] - place[i, 0] * f[2]
        wrench[i, 5] += place[i, 0] * f[1] - place[i, 1] * f[0]


@njit(cache=True)
def _add_at(point, f, wrench):
    for j in range(3):
        wrench[j] += f[j]
    wrench[3] += point[1] * f[2] - point[2] * f[1]
    wrench[4] += point[2] * f[0] - point[0] * f[2]
    wrench[5] += point[0] * f[1] - point[1] * f[0]


@njit(cache=True)
def _latch(linear, k, c, pose, twist, hold, law_force, local):
    """Springs and dampers between A and where it is held in S, at A's origin; along z the law's force where there is one."""
    f, turn, q = np.empty(3), np.empty(3), np.empty(4)
    inverse = np.empty(4)
    for j in range(3):
        inverse[j] = -hold[3 + j]
        f[j] = k * (pose[j] - hold[j]) + c * twist[j]
    inverse[3] = hold[6]
    if not linear:
        f[2] = law_force
    quat_mul(pose[3:7], inverse, q)
    rotation_vector(q, turn)
    for j in range(3):
        local[3 + j] = LATCH_RADIUS**2 * (k * turn[j] + c * twist[3 + j])
    _add_at(pose[0:3], f, local)


@njit(cache=True)
def _hold(which, pose, wrench, stiffness, hold):
    """Where the latches hold A so that at the instant of closing their springs bear the force that the contact bore."""
    for i in range(pose.shape[0]):
        if which[i]:
            hold[i] = pose[i]
            for j in range(3):
                hold[i, j] -= wrench[i, j] / stiffness[i]


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
