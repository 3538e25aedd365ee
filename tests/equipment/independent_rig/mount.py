"""The passive side on its compliant mount: one rigid body on six springs and dampers at P's origin,
by Newton-Euler equations.

The state y (13,) is that of the frame S on the body: position of its origin in P, quaternion,
velocity and angular velocity, all in P. The weight is balanced. Torques of the springs are
proportional to the rotation vector. The sensor above measures the wrench of springs and
dampers: the contact less the body's inertial wrench.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hiltestbed.compiled.jit import njit
from tests.equipment.independent_rig.rotation import (
    add_moment,
    apply,
    apply_back,
    matrix,
    product,
    turn,
    turn_of,
)

RIGID = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
# of the body on it, as in models/probe_cone/passive.xml and models/bumper/passive.xml
MASS = 120.0  # kg
INERTIA = np.diag([8.0, 8.0, 10.0])  # kg m^2 about the centre of mass
CENTRE = np.array([0.0, 0.0, 0.30])  # m, of mass, from P

ARM2 = 0.02  # m^2, square of the lever arm of a contact force about the centre of mass
MOST_PHASE, MOST_LOSS = 0.5, 1.0  # largest phase of the swing, and largest decay, in one step


class Mount(NamedTuple):
    """Springs and dampers x, y, z, rx, ry, rz of the mount and the body on it; there: whether there
    is a mount.
    """

    stiffness: np.ndarray  # (6,)
    damping: np.ndarray  # (6,)
    mass: float
    inertia: np.ndarray  # (3, 3), about the centre of mass
    answer: np.ndarray  # (3, 3), the inverse of the inertia
    centre: np.ndarray  # (3,) of mass, from S
    there: bool


def no_mount() -> Mount:
    """A rigid passive side, without a mount."""
    return mount_of(np.ones(6), np.zeros(6))._replace(there=False)


def mount_of(stiffness, damping) -> Mount:
    """The mount of a scenario, stiffness and damping (6,)."""
    springs, dampers = (np.array(v, dtype=float) for v in (stiffness, damping))
    return Mount(springs, dampers, MASS, INERTIA, np.linalg.inv(INERTIA), CENTRE, True)


@njit(cache=True)
def carried(mount, y, out):
    """Wrench (6,) transmitted by springs and dampers, in P at P's origin."""
    away = turn_of(y[3:7])
    for i in range(3):
        out[i] = mount.stiffness[i] * y[i] + mount.damping[i] * y[7 + i]
        out[3 + i] = mount.stiffness[3 + i] * away[i] + mount.damping[3 + i] * y[10 + i]
    add_moment(y[0], y[1], y[2], out, 1.0, out)


@njit(cache=True)
def derivative(mount, y, wrench, out):
    """`out` (6,): accelerations of S under a contact wrench (6,), in P at P's origin."""
    net, inside, turning, arm = np.empty(6), np.empty(3), np.empty(3), np.empty(3)
    carried(mount, y, net)
    for i in range(6):
        net[i] = wrench[i] - net[i]
    into = matrix(y[3:7])
    apply(into, mount.centre[0], mount.centre[1], mount.centre[2], arm)
    # now about the centre of mass
    add_moment(y[0] + arm[0], y[1] + arm[1], y[2] + arm[2], net, -1.0, net)
    apply_back(into, y[10], y[11], y[12], inside)
    apply(mount.inertia, inside[0], inside[1], inside[2], turning)
    stir_x = inside[1] * turning[2] - inside[2] * turning[1]
    stir_y = inside[2] * turning[0] - inside[0] * turning[2]
    stir_z = inside[0] * turning[1] - inside[1] * turning[0]
    apply_back(into, net[3], net[4], net[5], turning)
    apply(mount.answer, turning[0] - stir_x, turning[1] - stir_y, turning[2] - stir_z, inside)
    apply(into, inside[0], inside[1], inside[2], out[3:])
    spin_arm = y[10] * arm[0] + y[11] * arm[1] + y[12] * arm[2]
    spin2 = y[10] ** 2 + y[11] ** 2 + y[12] ** 2
    for i in range(3):  # omega x (omega x arm) = omega (omega . arm) - arm omega^2
        out[i] = net[i] / mount.mass - (y[10 + i] * spin_arm - arm[i] * spin2)
    out[0] -= out[4] * arm[2] - out[5] * arm[1]
    out[1] -= out[5] * arm[0] - out[3] * arm[2]
    out[2] -= out[3] * arm[1] - out[4] * arm[0]


@njit(cache=True)
def moved(y, v, a, dt, out):
    """`out` (13,): the state y after dt at velocities `v` (6,) and accelerations `a` (6,)."""
    w = np.empty(3)
    for i in range(3):
        out[i] = y[i] + dt * v[i]
        w[i] = dt * v[3 + i]
    q = product(turn(w), y[3:7])
    size = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        out[3 + i] = q[i] / size
    for i in range(6):
        out[7 + i] = y[7 + i] + dt * a[i]


@njit(cache=True)
def inner_steps(mount, contact_stiffness, contact_damping, rub, dt):
    """Number of steps in dt for which the midpoint rule resolves the mounted body's oscillation and
    is stable with its damping.

    rub: [N s/m] slope of the friction. The contact is off the centre of mass: the effective mass
        there is less than the body's mass.
    """
    answer = max(mount.answer[0, 0], mount.answer[1, 1], mount.answer[2, 2])
    there = 1.0 / mount.mass + ARM2 * answer
    push = max(mount.stiffness[0], mount.stiffness[1], mount.stiffness[2]) + contact_stiffness
    twist = max(mount.stiffness[3], mount.stiffness[4], mount.stiffness[5])
    swing = math.sqrt(push * there + twist * answer)
    dampers = max(mount.damping[0], mount.damping[1], mount.damping[2])
    loss = (dampers + contact_damping + rub) * there
    return max(1, int(math.ceil(dt * max(swing / MOST_PHASE, loss / MOST_LOSS))))
