"""A virtual force in addition to the measured one, tuned or designed until the contact is as
desired: ``F = F_meas + k_v x + b_v v`` while pz > 0.

:class:`VirtualContact` is the hybrid contact model of the EPOS rig (M. Zebenay, T. Boge, R. Krenn,
D. Choukroun, "Analytical and experimental stability investigation of a hardware-in-the-loop
satellite docking simulator", Proc. IMechE G 229, 2015; arXiv 1309.3512): a virtual force is
superposed on the measured one and tuned until the contact behaves as desired. To first order a
delay acts as a damping -k tau, which ``b_v = k tau`` cancels. The simulated contact is then partly
that of the tuning, not of the hardware.

:class:`CorDesigned` is a damper that is designed for a desired coefficient of restitution (e) of
the bounce (S. Abiko, Y. Satake, X. Jiang, T. Tsujita, M. Uchiyama, "Delay time compensation based
on coefficient of restitution for collision hybrid motion simulator", Advanced Robotics 28, 2014,
after K. Osaki, A. Konno, M. Uchiyama, "Delay time compensation for a hybrid simulator", Advanced
Robotics 24, 2010: during the delay the motion is uniform, then the contact acts late; the
compensation is found by iteration on that model). Here the contact with the design stiffness,
damping and reduced mass is simulated with the delay, and the damper is found that gives the desired
e, by default the e of the contact without delay. The design covers one mode and one contact,
without friction, lever arms or a second contact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import ForceMethod, Input, force_of
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import effective_mass
from hiltestbed.plugins import register

if TYPE_CHECKING:
    from hiltestbed.numerical_model.model import NumericalModel
    from hiltestbed.scenario import Scenario


@register
class VirtualContact(ForceMethod):
    """A virtual spring and damper along the insertion, added to the measured force."""

    kind: Literal["virtual_contact"] = "virtual_contact"
    adds_force: ClassVar[bool] = True
    stiffness: NotNegative = Field(default=0.0, description="Stiffness of the virtual spring [N/m]")
    damping: NotNegative = Field(
        description="Damping of the virtual damper [N s/m]; contact stiffness times delay cancels "
        "the delay to first order"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "twist"})

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> VirtualContactBlock:
        return VirtualContactBlock(scenarios)

    def removes(self, scenario: Scenario) -> Mapping[str, float]:
        # a damper b is equivalent to a lead of b/k
        return {self.kind: self.damping / acting_along_z(scenario)[0]}


class VirtualContactBlock:
    """The virtual force along the insertion, for ``n`` runs."""

    def __init__(self, scenarios: Sequence[Scenario]) -> None:
        force = force_of(scenarios, VirtualContact)
        self._stiffness = np.array([f.stiffness for f in force])
        self._damping = np.array([f.damping for f in force])
        self.output = np.zeros((len(scenarios), 6))

    def compensate(self, measurement: Measurement) -> Array:
        """``(n, 6)`` sum of the measured and the virtual wrench."""
        add_virtual(
            measurement.wrench,
            measurement.pose,
            measurement.twist,
            self._stiffness,
            self._damping,
            self.output,
        )
        return self.output


@njit(cache=True)
def add_virtual(wrench, pose, twist, stiffness, damping, out):
    """``out``: wrench plus a spring and damper (n,) at A along z, in P at P's, beyond touch."""
    for i in range(wrench.shape[0]):
        for j in range(6):
            out[i, j] = wrench[i, j]
        x = pose[i, 2]
        if x > 0.0:
            force = stiffness[i] * x + damping[i] * twist[i, 2]
            out[i, 2] += force
            out[i, 3] += pose[i, 1] * force
            out[i, 4] -= pose[i, 0] * force


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
    removes_delay: ClassVar[bool] = True

    @classmethod
    def start(cls, scenarios: Sequence[Scenario], model: NumericalModel) -> CorDesignedBlock:
        return CorDesignedBlock(scenarios)


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
    """The damper [N s/m] that gives the design contact the desired e despite the delay."""
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
