"""A force in addition to the measured one: a virtual contact, a designed damper, or what keeps the
contact passive.

The first two are ``F = F_meas + k_v x + b_v v`` while pz > 0.

:class:`VirtualContact` is the hybrid contact model of the EPOS rig (M. Zebenay, T. Boge, R. Krenn,
D. Choukroun, "Analytical and experimental stability investigation of a hardware-in-the-loop
satellite docking simulator", Proc. IMechE G 229, 2015; arXiv 1309.3512): a virtual force is
superposed on the measured one and tuned until the contact behaves as desired. To first order a
delay acts as a damping -k tau, which ``b_v = k tau`` cancels.

:class:`CorDesigned` is a damper that is designed for a desired coefficient of restitution (e) of
the bounce (S. Abiko, Y. Satake, X. Jiang, T. Tsujita, M. Uchiyama, "Delay time compensation based
on coefficient of restitution for collision hybrid motion simulator", Advanced Robotics 28, 2014,
after K. Osaki, A. Konno, M. Uchiyama, "Delay time compensation for a hybrid simulator", Advanced
Robotics 24, 2010: during the delay the motion is uniform, then the contact acts late; the
compensation is found by iteration on that model). Here the contact with the design stiffness,
damping and reduced mass is simulated with the delay, and the damper is found that gives the desired
e, by default the e of the contact without delay.

:class:`PassivityControl` is the time-domain observer and controller (B. Hannaford, J.-H. Ryu,
"Time-domain passivity control of haptic interfaces", IEEE T-RA 18, 2002; for contact on such rigs
M. De Stefano, J. Artigas, C. Secchi et al., EPOS and OOS-SIM, T-RO 2020): ``E_k = sum of h F_used .
v``, the energy that the simulated contact has taken from the relative motion, must not be negative;
when it is, ``alpha = -E/(h v^2)`` makes it zero.

:class:`NormalisedPassivity` acts before that (C. Insam, L. D. H. Peiris, D. J. Rixen,
"Normalized passivity control for hardware-in- the-loop with contact", Int. J. Dynamics and Control
9, 2021): the power that the transfer system generates, divided by the magnitude of its signals and
smoothed, sets a damping force. The transfer system here is the sensor's delay, whose power to first
order is ``(F(t) - F_meas) v ~ tau F_meas' v``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from hiltestbed.compensation.interfaces import ForceBlock, ForcePath, KernelBlock
from hiltestbed.compensation.settings import BlockMethod, Input
from hiltestbed.compiled.jit import njit
from hiltestbed.config.validation import NotNegative, Positive
from hiltestbed.plugins import register

STATE: tuple[Input, ...] = ("wrench", "pose", "twist")
DAMPING_LIMIT = 0.5  # times the damping that would reverse the velocity within one tick
STEPS = 400  # time steps of the design model per radian of the contact's oscillation: CoR to 2e-3


@register
class VirtualContact(BlockMethod):
    """A virtual spring and damper along the insertion, added to the measured force."""

    kind: Literal["virtual_contact"] = "virtual_contact"
    adds_force: ClassVar[bool] = True
    stiffness: NotNegative = Field(default=0.0, description="Stiffness of the virtual spring [N/m]")
    damping: NotNegative = Field(
        description="Damping of the virtual damper [N s/m]; contact stiffness times delay cancels "
        "the delay to first order"
    )
    reads: ClassVar[frozenset[Input]] = frozenset(STATE)

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        stiffness, damping = (
            np.array([getattr(f, name) for f in own]) for name in ("stiffness", "damping")
        )
        return KernelBlock(add_virtual, STATE, stiffness, damping)

    def removed(self, delay: float, stiffness: float) -> float:
        return self.damping / stiffness  # a damper b is equivalent to a lead of b/k


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


@register
class CorDesigned(BlockMethod):
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
    reads: ClassVar[frozenset[Input]] = frozenset(STATE)
    removes_delay: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        contacts = zip(own, path.mass, path.delay, strict=True)
        damping = np.array([force.designed(mass, delay) for force, mass, delay in contacts])
        return KernelBlock(add_virtual, STATE, np.zeros(len(own)), damping)

    def designed(self, mass: float, delay: float) -> float:
        """The damper [N s/m] for the desired e at a reduced ``mass`` [kg] and ``delay`` [s]."""
        w = math.sqrt(self.stiffness / mass)
        z = self.damping / (2.0 * math.sqrt(self.stiffness * mass))
        turn = w * delay
        desired = self.cor if self.cor is not None else bounce(z, 0.0, 0.0)
        low, high = 0.0, 1.0 + turn  # bounds, in units of 2 sqrt(k mu)
        for _ in range(40):  # to a part in 1e12
            middle = 0.5 * (low + high)
            if bounce(z, turn, middle) > desired:
                low = middle
            else:
                high = middle
        return (low + high) * math.sqrt(self.stiffness * mass)


@njit(cache=True)
def bounce(z, turn, extra):
    """e of ``x'' = -F(t - tau) - 2 extra x'`` in units of 1/w, F = x + 2 z x' >= 0 while x > 0."""
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


@register
class PassivityControl(BlockMethod):
    """Time-domain passivity observer and controller: damping is injected once the contact has
    returned more energy than it took.
    """

    kind: Literal["passivity_control"] = "passivity_control"
    adds_force: ClassVar[bool] = True
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "model"})

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        model = path.model
        limit = DAMPING_LIMIT / (model.tick * (1.0 / model.mass).sum(axis=1))
        energy = np.zeros(len(own))  # [J] taken from the relative motion, damping included
        given = (model.twist, model.tick, limit, energy)
        return KernelBlock(_observe_and_control, ("wrench",), *given)


@register
class NormalisedPassivity(BlockMethod):
    """Normalised passivity control: a damping force proportional to the normalised power that the
    delay generates.
    """

    kind: Literal["normalised_passivity"] = "normalised_passivity"
    adds_force: ClassVar[bool] = True
    gain: NotNegative = Field(
        default=1.0,
        description="Gain of the damping force [-]; 1 balances the delay to first order",
    )
    smoothing: Positive = Field(
        default=0.005, description="Time constant of the low-pass on the power [s]"
    )
    reads: ClassVar[frozenset[Input]] = frozenset({"wrench", "pose", "model"})
    removes_delay: ClassVar[bool] = True

    @classmethod
    def block(cls, own: Sequence[Self], path: ForcePath) -> ForceBlock:
        h = path.model.tick
        gain = np.array([f.gain for f in own])
        smooth = np.array([1.0 - math.exp(-h / f.smoothing) for f in own])
        # last force, its smoothed derivative times the delay, smoothed power, smoothed |F v|
        given = (path.model.twist, gain, smooth, path.delay / h, np.zeros((len(own), 4)))
        return KernelBlock(_normalise, ("wrench", "pose"), *given)


@njit(cache=True)
def _observe_and_control(wrench, twist, h, limit, energy, out):
    for i in range(wrench.shape[0]):
        speed = twist[i, 0] ** 2 + twist[i, 1] ** 2 + twist[i, 2] ** 2
        for j in range(6):
            out[i, j] = wrench[i, j]
            energy[i] += h * wrench[i, j] * twist[i, j]
        if energy[i] < 0.0 and speed > 0.0:
            alpha = min(-energy[i] / (h * speed), limit[i])
            for j in range(3):
                out[i, j] += alpha * twist[i, j]
            energy[i] += h * alpha * speed


@njit(cache=True)
def _normalise(wrench, pose, twist, gain, smooth, delay, memory, out):
    for i in range(wrench.shape[0]):
        m = memory[i]
        force, v = wrench[i, 2], twist[i, 2]
        m[1] += smooth[i] * (delay[i] * (force - m[0]) - m[1])
        m[0] = force
        m[2] += smooth[i] * (m[1] * v - m[2])
        m[3] += smooth[i] * (abs(force * v) - m[3])
        ratio = min(max(m[2] / m[3], 0.0), 1.0) if m[3] > 0.0 else 0.0
        extra = gain[i] * ratio * abs(force) * (1.0 if v > 0.0 else -1.0)
        for j in range(6):
            out[i, j] = wrench[i, j]
        out[i, 2] += extra
        out[i, 3] += pose[i, 1] * extra
        out[i, 4] -= pose[i, 0] * extra
