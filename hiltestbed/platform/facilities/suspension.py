"""Two articles on cables: each hangs in a gimbal at its centre of mass, from a pivot in the roof,
and a winch supports its weight.

Disturbances compared with free flight: a cable pulls back (a pendulum) and has mass, its winch
follows the article with friction, inertia and an imperfect tension servo, and the gimbal is not
exactly at the centre of mass. With m the suspended mass, m_c the cable's, L from the pivot to the
gimbal, the small swing has

    w^2 = (g/L) (1 + m_c/(2 m))/(1 + m_c/(3 m))

since the article does not rotate with the cable. The tension follows T' = w_t (T_0 - T) with T_0
the weight; the winch applies T along the cable and adds its own inertia and friction.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hiltestbed.compiled.bound import GIVEN, Call
from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import SIDES, Bodies, PhysicalFacility
from hiltestbed.platform.facilities.facility import MOUNT, per_run
from hiltestbed.platform.friction import drag
from hiltestbed.platform.payload import GRAVITY
from hiltestbed.platform.shipped.suspension import SuspensionSettings

PRESLIDING = 2.0e5  # [N/m] stiffness of a winch before break-away
STRIBECK_SPEED = 0.002  # [m/s]
BREAKAWAY = 1.3  # ratio of break-away to sliding friction
HOOK = 2.0  # [kg] gimbal and hook, in models/suspension
THIN = 0.012  # [m] radius of the cable


@njit(cache=True)
def _push(numbers, rub, dt, hung, dofs, swings, tension, bristles, qvel, applied):
    """numbers: (n, 3) swing damping, low-pass coefficient per step of the tension servo, tension
    error. rub: (n, 7) friction.

    dofs (2,): of the winches. swings (2, 2): of the cables' pivots.
    """
    for i in range(qvel.shape[0]):
        for b in range(dofs.shape[0]):
            goal = hung[b] * GRAVITY * (1.0 + numbers[i, 2])
            tension[i, b] += numbers[i, 1] * (goal - tension[i, b])
            applied[i, dofs[b]] = -tension[i, b] - drag(
                qvel[i, dofs[b]], dt, rub[i], bristles[i, b], 0
            )
            for c in range(2):
                applied[i, swings[b, c]] = -numbers[i, 0] * qvel[i, swings[b, c]]


class Hung(Bodies):
    """Articles of `n` runs on their cables.

    Attributes:
        tension: (n, b) of each cable [N]. bristles: (n, b, 1) deflection of its winch's bristle
            [m].
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        facility: Suspension,
        settings: Sequence[Any],
        step: float,
        tool: str,
    ) -> None:
        super().__init__(model, facility.kinematics(model, tool), len(settings), step)
        moving = [side for side in SIDES if facility.hangs(side)]
        self._dofs = np.array([int(model.joint(f"{side}_winch").dofadr[0]) for side in moving])
        self._swings = np.array(
            [[int(model.joint(f"{side}_swing_{c}").dofadr[0]) for c in "xz"] for side in moving]
        )
        self._hung = np.array([float(model.body(f"{side}_hook").subtreemass[0]) for side in moving])
        share = 1.0 - np.exp(-2.0 * math.pi * per_run(settings, "tension_bandwidth") * step)
        self._numbers = np.column_stack(
            [per_run(settings, "swing_damping"), share, per_run(settings, "tension_error")]
        )
        slides, n = per_run(settings, "winch_friction"), len(settings)
        bristle = min(PRESLIDING, 0.25 * HOOK / step**2)
        self._rub = np.column_stack(
            [
                slides,
                BREAKAWAY * slides,
                np.full(n, STRIBECK_SPEED),
                np.zeros(n),
                np.zeros(n),
                np.full(n, bristle),
                np.full(n, 2.0 * math.sqrt(bristle * HOOK)),
            ]
        )
        self.tension, self.bristles = np.zeros((n, len(moving))), np.zeros((n, len(moving), 1))
        self._pushed = Call(
            _push,
            self._numbers,
            self._rub,
            step,
            self._hung,
            self._dofs,
            self._swings,
            self.tension,
            self.bristles,
            GIVEN,
            GIVEN,
        )

    def rest(self, qpos: Array, qvel: Array) -> None:
        self.tension[:] = self._hung * GRAVITY * (1.0 + self._numbers[:, 2:3])
        self.bristles[:] = 0.0

    def push(self, qpos: Array, qvel: Array, applied: Array) -> None:
        self._pushed.on(qvel, applied)()

    def state(self) -> dict[str, NDArray[Any]]:
        return {"tension": self.tension, "bristles": self.bristles}


class Suspension(PhysicalFacility):
    """The cables of ``models/suspension``."""

    settings: SuspensionSettings

    def hangs(self, side: str) -> bool:
        """Whether an article can move."""
        return side == "chaser" or self.settings.target == "free"

    def spec(self) -> mujoco.MjSpec:
        spec, s = load("suspension/suspension"), self.settings
        half = 0.5 * s.length
        for side in SIDES:
            place = self.place_of(side)
            # from the centre of mass to the gimbal, in W, at home
            up = np.array([0.0, s.gimbal_offset, 0.0])
            spec.body(f"{side}_pivot").pos = place[:3] + up + [0.0, s.length, 0.0]
            cable = spec.body(f"{side}_cable")
            thick = max(s.cable_mass, 1e-6)
            across = thick * s.length**2 / 12.0
            cable.mass, cable.ipos = thick, [0.0, -half, 0.0]
            cable.inertia = [across, thick * THIN**2, across]
            rope = spec.geom(f"{side}_rope")
            rope.pos, rope.size = [0.0, -half, 0.0], [THIN, half, 0.0]
            spec.body(f"{side}_hook").pos = [0.0, -s.length, 0.0]
            spec.joint(f"{side}_winch").armature = s.winch_mass
            body = spec.body(side)
            body.pos, body.quat = -up, [place[6], *place[3:6]]
            inside = _in_body(up, place)
            spec.joint(f"{side}_gimbal").pos = inside
            if not self.hangs(side):
                for name in ("swing_x", "swing_z", "winch", "gimbal"):
                    spec.delete(spec.joint(f"{side}_{name}"))
            self.fit(spec, side, 0.0, np.zeros((3, 3)))
        self.add_ports(spec)
        return spec

    def bodies(
        self, model: mujoco.MjModel, settings: Sequence[Any], step: float, tool: str = MOUNT
    ) -> Hung:
        return Hung(model, self, settings, step, tool)

    def alike(self) -> Hashable:
        s = self.settings
        return (self.kind, s.target, s.length, s.cable_mass, s.winch_mass, s.gimbal_offset)


def _in_body(vector: Array, place: Array) -> Array:
    """A vector of W in the axes of a body at ``place`` (7,)."""
    from hiltestbed.frames import rotate_back

    out = np.empty(3)
    rotate_back(place[3:7], vector, out)
    return out


def swing_frequency(settings: SuspensionSettings, mass: float) -> float:
    """Small-swing frequency [rad/s] of a suspended mass [kg], gimbal and hook included: the closed
    form of the module docstring.
    """
    ratio = settings.cable_mass / mass
    return math.sqrt(GRAVITY / settings.length * (1.0 + 0.5 * ratio) / (1.0 + ratio / 3.0))
