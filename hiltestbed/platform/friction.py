"""Friction of drives, subtracted from their force: its effect on a joint that reverses, for a
single motor and for a differential pair that avoids it. Units are N and m for sliders and
cylinders, N m and rad for gears.

The friction f(v) is Coulomb and Stribeck, with a bristle that holds the drive at rest
(elasto-plastic with one state: Dupont, Hayward, Armstrong, Altpeter, IEEE Trans. Automatic Control
47(5), 2002, here with break-away at full deflection; g(v) after Canudas de Wit, Olsson, Astrom,
Lischinsky, IEEE Trans. Automatic Control 40(3), 1995):

    g(v) = f_c + (f_s - f_c) exp(-(v/v_s)^2)
    z' = v while |sigma_0 z| < g(v), else z stays at g(v)/sigma_0
    f = clip(sigma_0 z + sigma_1 z', -g(v), g(v)) + f_v v

It does not drift below break-away; apart from the viscous part it does not exceed g, its spring
returns no more energy than it has stored, and it needs no smaller time step.

Without a bias speed one motor moves the joint, f acts on it. With one, b, a differential screw adds
two motors of half the speed, s = s_1 + s_2, which turn against each other: u_1 = s'/2 + b, u_2 =
s'/2 - b. The bias loop keeps b constant, so that by virtual work the friction on the slider is
(f(u_1) + f(u_2))/2: at s' = 0 the Coulomb terms cancel, and no motor reverses while |s'| < 2 b.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.frames import Array

STEPS = 0.25  # fraction of m/dt^2: the stiffest bristle that a physics step can resolve
# [m/s], [rad/s] smaller speeds at the start are rounding errors of the inverse kinematics, and
# count as rest
AT_REST = 1e-9
COULOMB, STICTION, STRIBECK, VISCOUS, BIAS, BRISTLE, DAMPER = range(7)


@njit(cache=True)
def stribeck(v, p):
    """Largest friction [N] but the viscous, at ``v`` [m/s]; ``p`` (7,): of a drive."""
    x = v / p[STRIBECK]
    return p[COULOMB] + (p[STICTION] - p[COULOMB]) * math.exp(-x * x)


@njit(cache=True)
def drag(v, dt, p, z, i):
    """Force [N] against a drive at ``v`` [m/s]; advances its bristle ``z[i]`` [m] by ``dt``."""
    most = stribeck(v, p)
    reach = most / p[BRISTLE]
    z[i] = min(max(z[i] + v * dt, -reach), reach)
    held = p[BRISTLE] * z[i]
    if abs(z[i]) < reach:
        held = min(max(held + p[DAMPER] * v, -most), most)
    return held + p[VISCOUS] * v


@njit(cache=True)
def _act(numbers, dt, axes, inputs, qvel, bristles, ctrl):
    """Subtract the friction of the drives at ``qvel`` (n, nv) from their inputs (n, nu)."""
    for i in range(qvel.shape[0]):
        for j in range(axes.shape[0]):
            v, p = qvel[i, axes[j]], numbers[i, j]
            if p[BIAS] > 0.0:
                force = 0.5 * drag(0.5 * v + p[BIAS], dt, p, bristles[i, j], 0)
                force += 0.5 * drag(0.5 * v - p[BIAS], dt, p, bristles[i, j], 1)
            else:
                force = drag(v, dt, p, bristles[i, j], 0)
            ctrl[i, inputs[j]] -= force


def _settle(numbers, axes, qvel, bristles):
    """Set the bristles to their steady state at the speeds ``qvel``; at rest they are unloaded."""
    for i in range(qvel.shape[0]):
        for j in range(axes.shape[0]):
            p = numbers[i, j]
            for k in range(2):
                v = qvel[i, axes[j]]
                if p[BIAS] > 0.0:
                    v = 0.5 * v + (p[BIAS] if k == 0 else -p[BIAS])
                bristles[i, j, k] = (
                    0.0 if abs(v) < AT_REST else math.copysign(stribeck(v, p) / p[BRISTLE], v)
                )


class DriveFriction:
    """Friction of J drives of `n` runs.

    Attributes:
        numbers: (n, J, 7) of each drive: COULOMB to DAMPER.
        bristles: (n, J, 2) deflection of each motor's bristle [m, rad]; a single motor uses the
            first.
    """

    def __init__(
        self,
        law: Array,
        presliding: Array | float,
        moved: Array | float,
        axes: NDArray[np.int64],
        inputs: NDArray[np.int64],
        dt: float,
    ) -> None:
        """Args: law: (n, J, 5) Coulomb, stiction, Stribeck speed, viscous, bias speed (0: one
        motor). presliding: stiffness before break-away; moved: smallest mass that a drive moves,
        both (n, J), (J,) or of all. axes, inputs: (J,) degrees of freedom and actuators. dt: [s].
        """
        bristle = np.broadcast_to(np.minimum(presliding, STEPS * moved / (dt * dt)), law.shape[:2])
        damper = 2.0 * np.sqrt(bristle * moved)  # the bristle alone is critically damped
        self.numbers = np.concatenate([law, bristle[..., None], damper[..., None]], axis=2)
        self._axes = np.asarray(axes)
        self.bristles = np.zeros((*law.shape[:2], 2))
        self._acted = Call(
            _act, self.numbers, dt, self._axes, np.asarray(inputs), GIVEN, self.bristles, GIVEN
        )

    def settle(self, qvel: Array) -> None:
        """Start in the steady state at the speeds ``qvel`` (n, nv)."""
        interpreted(_settle)(self.numbers, self._axes, qvel, self.bristles)

    def act(self, qvel: Array, ctrl: Array) -> None:
        """Subtract a step's friction from the inputs ``ctrl`` (n, nu)."""
        self._acted.on(qvel, ctrl)()
