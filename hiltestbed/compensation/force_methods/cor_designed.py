"""A virtual damper designed for a desired coefficient of restitution (e) of the bounce.

S. Abiko, Y. Satake, X. Jiang, T. Tsujita, M. Uchiyama, "Delay time compensation based on
coefficient of restitution for collision hybrid motion simulator", Advanced Robotics 28, 2014, after
K. Osaki, A. Konno, M. Uchiyama, "Delay time compensation for a hybrid simulator", Advanced Robotics
24, 2010: during the delay the motion is uniform, then the contact acts late; the compensation is
found by iteration on that model. Here the compensation is a damper: the contact with the design
stiffness, damping and reduced mass is simulated with the delay, and the damper is found that gives
the desired e, by default the e of the contact without delay.

The design covers one mode and one contact, without friction, lever arms or a second contact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.force_methods.virtual_contact import add_virtual
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario

STEPS = 400  # time steps of the design model per radian of the contact's oscillation
BISECTIONS = 40


@register
class CorDesigned(ForceMethod):
    """A virtual damper along the insertion, designed for a desired coefficient of restitution."""

    kind: Literal["cor_designed"] = "cor_designed"
    adds_force: ClassVar[bool] = True
    stiffness: Positive = Field(
        description="Contact stiffness that the damper is designed for [N/m]"
    )
    damping: NotNegative = Field(
        default=0.0, description="Contact damping that the damper is designed for [N s/m]"
    )
    cor: Positive | None = Field(
        default=None,
        description="Desired coefficient of restitution [-]; null: that of the design contact "
        "without delay",
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> CorDesignedBlock:
        return CorDesignedBlock(scenarios)

    def removes(self, scenario: Scenario) -> Mapping[str, float]:
        return {self.kind: scenario.sensor.delay}


class CorDesignedBlock:
    """The designed damper along the insertion, for ``n`` runs.

    Attributes:
        damping: ``(n,)`` [N s/m] as designed.
    """

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        self.damping = np.array([designed_damping(s) for s in scenarios])
        self._stiffness = np.zeros(len(scenarios))
        self.output = np.zeros((len(scenarios), 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` measured wrench plus the force of the designed damper."""
        add_virtual(
            measurement.wrench,
            measurement.pose,
            measurement.twist,
            self._stiffness,
            self.damping,
            self.output,
        )
        return self.output


def designed_damping(scenario: Scenario) -> float:
    """The damper [N s/m] with which the design contact has the desired e despite the sensor's
    delay.
    """
    (force,), mass = force_of([scenario], CorDesigned), effective_mass(scenario)
    w = math.sqrt(force.stiffness / mass)
    z = force.damping / (2.0 * math.sqrt(force.stiffness * mass))
    turn = w * scenario.sensor.delay
    desired = force.cor if force.cor is not None else bounce(z, 0.0, 0.0)
    low, high = 0.0, 1.0 + turn  # bounds, in units of 2 sqrt(k mu)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if bounce(z, turn, middle) > desired:
            low = middle
        else:
            high = middle
    return (low + high) * math.sqrt(force.stiffness * mass)


@njit(cache=True)
def bounce(z, turn, extra):
    """e of ``x'' = -F(t - tau) - 2 extra x'`` (the last while x > 0) in units of 1/w; F = x + 2 z
    x' while x > 0, never negative.
    """
    dt = 1.0 / STEPS
    late = int(round(turn * STEPS))
    forces = np.zeros(late + 1)
    x, v = 0.5 * dt, 1.0
    for k in range(40 * STEPS):
        forces[k % (late + 1)] = max(0.0, x + 2.0 * z * v) if x > 0.0 else 0.0
        v -= dt * forces[(k - late) % (late + 1)]
        if x > 0.0:
            v -= dt * 2.0 * extra * v
        x += dt * v
        if x <= 0.0 and k > late and forces.max() == 0.0:
            break
    return -v
