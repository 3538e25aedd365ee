"""Friction of the platform's drives: its effect on a slider that reverses, for a single drive and
for a differential pair that avoids it.

A drive's friction f(v) is Coulomb and Stribeck, with a bristle that holds the drive at rest
(elasto-plastic with one state: Dupont, Hayward, Armstrong, Altpeter, IEEE Trans. Automatic Control
47(5), 2002, here with break-away at full deflection; g(v) after Canudas de Wit, Olsson, Astrom,
Lischinsky, IEEE Trans. Automatic Control 40(3), 1995):

    g(v) = f_c + (f_s - f_c) exp(-(v/v_s)^2)
    z' = v while |sigma_0 z| < g(v), else z stays at g(v)/sigma_0
    f = clip(sigma_0 z + sigma_1 z', -g(v), g(v)) + f_v v

It does not drift below break-away; apart from the viscous part it does not exceed g, its spring
returns no more energy than it has stored, and it needs no smaller time step.

`single`: one drive moves the slider, f acts on it. `dual`: a differential screw adds two drives of
half the speed, s = s_1 + s_2, which
turn against each other at the bias speed b: u_1 = s'/2 + b, u_2 = s'/2 - b. The bias loop keeps b
constant, so that by virtual work the friction on the slider is (f(u_1) + f(u_2))/2: at s' = 0 the
Coulomb terms cancel, and no drive reverses while |s'| < 2 b.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.platform.pss33.settings import Actuator

# [N/m] 300 N at 6 um: machine-tool drives give 1 to 50 um before they break away
PRESLIDING = 5.0e7
STEPS = 0.25  # fraction of m/dt^2: the stiffest bristle that a physics step can resolve
IDEAL, SINGLE, DUAL = 0, 1, 2
KINDS = {"ideal": IDEAL, "single": SINGLE, "dual": DUAL}
COULOMB, STICTION, STRIBECK, VISCOUS, BIAS, BRISTLE, DAMPER = range(7)


@njit(cache=True, inline="always")
def stribeck(v, p):
    """Largest friction [N] without the viscous part, at the speed ``v`` [m/s]; ``p`` (7,) the
    parameters of a drive.
    """
    x = v / p[STRIBECK]
    return p[COULOMB] + (p[STICTION] - p[COULOMB]) * math.exp(-x * x)


@njit(cache=True)
def drag(v, dt, p, z, i):
    """Force [N] against the motion of a drive at ``v`` [m/s]; its bristle ``z[i]`` [m] is advanced
    by ``dt`` [s].
    """
    most = stribeck(v, p)
    reach = most / p[BRISTLE]
    z[i] = min(max(z[i] + v * dt, -reach), reach)
    held = p[BRISTLE] * z[i]
    if abs(z[i]) < reach:
        held = min(max(held + p[DAMPER] * v, -most), most)
    return held + p[VISCOUS] * v


@njit(cache=True)
def _act(kinds, numbers, dt, dofs, qvel, bristles, applied):
    """Write the friction of the drives into the generalised forces ``applied`` (n, nv), at the
    speeds ``qvel`` (n, nv).
    """
    for i in range(qvel.shape[0]):
        p, kind = numbers[i], kinds[i]
        for j in range(dofs.shape[0]):
            v = qvel[i, dofs[j]]
            if kind == SINGLE:
                force = drag(v, dt, p, bristles[i, j], 0)
            elif kind == DUAL:
                force = 0.5 * drag(0.5 * v + p[BIAS], dt, p, bristles[i, j], 0)
                force += 0.5 * drag(0.5 * v - p[BIAS], dt, p, bristles[i, j], 1)
            else:
                force = 0.0
            applied[i, dofs[j]] = -force


@njit(cache=True)
def _settle(kinds, numbers, dofs, qvel, bristles):
    """Set the bristles to their steady state at the speeds ``qvel``; at rest they are unloaded."""
    for i in range(qvel.shape[0]):
        p = numbers[i]
        for j in range(dofs.shape[0]):
            for k in range(2):
                v = qvel[i, dofs[j]]
                if kinds[i] == DUAL:
                    v = 0.5 * v + (p[BIAS] if k == 0 else -p[BIAS])
                bristles[i, j, k] = (
                    0.0 if v == 0.0 else math.copysign(stribeck(v, p) / p[BRISTLE], v)
                )


class DriveFriction:
    """Friction of the six drives of `n` platforms.

    Attributes:
        bristles: (n, 6, 2) deflection of each drive's bristle [m]; a single drive uses the first.
    """

    def __init__(
        self, actuators: Sequence[Actuator], dofs: NDArray[np.intp], moved: float, dt: float
    ) -> None:
        """Args: dofs: (6,) of the sliders. moved: smallest mass that a drive moves, carriage and
        armature [kg]. dt: physics step [s].
        """
        self.kinds = np.array([KINDS[a.kind] for a in actuators])
        self.acts = bool(self.kinds.any())
        bristle = min(PRESLIDING, STEPS * moved / (dt * dt))
        damper = 2.0 * math.sqrt(bristle * moved)  # the bristle alone is critically damped
        self.numbers = np.array(
            [
                [a.coulomb, a.stiction, a.stribeck_speed, a.viscous, a.bias_speed, bristle, damper]
                for a in actuators
            ],
            dtype=float,
        )
        self._dofs, self._dt = np.asarray(dofs), dt
        self.bristles = np.zeros((len(actuators), 6, 2))
        self._act = Call(
            _act, self.kinds, self.numbers, dt, self._dofs, GIVEN, self.bristles, GIVEN
        )

    def settle(self, qvel: Array) -> None:
        """Start in the steady state at the speeds ``qvel`` (n, nv)."""
        _settle(self.kinds, self.numbers, self._dofs, qvel, self.bristles)

    def act(self, qvel: Array, applied: Array) -> None:
        """Set the generalised forces ``applied`` (n, nv) of the sliders for one step from ``qvel``
        (n, nv).
        """
        self._act.on(qvel, applied)()
