"""hiltestbed and Basilisk, both ways round:

    pip install 'hiltestbed[basilisk]'
    python examples/basilisk/docking.py
    hiltestbed run 03-bumper-delay-uncompensated --plugin examples/basilisk/docking.py \
        --set numerical_model.kind=basilisk

The first puts the rig into a Basilisk simulation: in every step the module `Rig` takes the relative
pose of both ports from the spacecraft's states, moves the platform there, and returns what the
force sensor reads, delay and all, as external force and torque on both. The second makes the two
Basilisk spacecraft the numerical model of a run, with every compensation, check and report.
Basilisk holds force and torque over a step and integrates exactly, which is worth half a step of
delay more than hiltestbed's own semi-implicit model.

Frames: N inertial, B a spacecraft's body at its centre of mass, A and P the ports; r_BN_N is the
place of B from N's origin in N. As in :class:`hiltestbed.numerical_model.model.NumericalModel`, a
vehicle's state is q (7,), its pose in N, and v (6,), v_BN_N and omega_BN_B; its load (6,) is the
force in N and the torque about the centre of mass in B.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from Basilisk.architecture import messaging, sysModel
from Basilisk.simulation import extForceTorque, spacecraft
from Basilisk.utilities import SimulationBaseClass, macros
from scipy.spatial.transform import Rotation

import hiltestbed
from hiltestbed.devices.physical import SimulatedRig
from hiltestbed.numerical_model.kernels import load_wrench, relative_states
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.numerical_model.settings import ModelKind
from hiltestbed.plugins import register


class Vehicle:
    """A Basilisk spacecraft of a mass [kg] and an inertia (3, 3) [kg m^2] in a state q, v."""

    def __init__(self, mass, inertia, q, v) -> None:
        self.craft = spacecraft.Spacecraft()
        hub = self.craft.hub
        hub.mHub, hub.IHubPntBc_B = float(mass), inertia.tolist()
        hub.r_CN_NInit, hub.v_CN_NInit = q[:3, None].tolist(), v[:3, None].tolist()
        hub.sigma_BNInit = Rotation.from_quat(q[3:]).as_mrp()[:, None].tolist()
        hub.omega_BN_BInit = v[3:, None].tolist()
        self.effector = extForceTorque.ExtForceTorque()
        self.craft.addDynamicEffector(self.effector)
        self._force, self._torque = messaging.CmdForceInertialMsg(), messaging.CmdTorqueBodyMsg()
        self.effector.cmdForceInertialInMsg.subscribeTo(self._force)
        self.effector.cmdTorqueInMsg.subscribeTo(self._torque)

    def read(self, q, v) -> None:
        state = self.craft.scStateOutMsg.read()
        q[:3], q[3:] = state.r_BN_N, Rotation.from_mrp(state.sigma_BN).as_quat()
        v[:3], v[3:] = state.v_BN_N, state.omega_BN_B

    def push(self, load, now) -> None:
        """Hold the ``load`` from the time ``now`` [ns] on."""
        force = messaging.CmdForceInertialMsgPayload(forceRequestInertial=load[:3].tolist())
        torque = messaging.CmdTorqueBodyMsgPayload(torqueRequestBody=load[3:].tolist())
        self._force.write(force, now)
        self._torque.write(torque, now)


class Pair:
    """A Basilisk simulation of chaser and target with masses (2,), inertias (2, 3, 3) and states
    q (2, 7), v (2, 6), stepped every ``tick`` [s]; ``module`` is called after them.
    """

    def __init__(self, masses, inertias, q, v, tick, module=None) -> None:
        self.vehicles = [Vehicle(*parts) for parts in zip(masses, inertias, q, v, strict=True)]
        self.simulation = SimulationBaseClass.SimBaseClass()
        self._step, self.now = macros.sec2nano(tick), 0
        task = self.simulation.CreateNewTask("step", self._step)
        self.simulation.CreateNewProcess("docking").addTask(task)
        for vehicle in self.vehicles:
            self.simulation.AddModelToTask("step", vehicle.effector, 3)
            self.simulation.AddModelToTask("step", vehicle.craft, 2)
        if module is not None:
            self.simulation.AddModelToTask("step", module, 1)

    def step(self, ticks=1) -> None:
        """Advance; the first call also initialises, with a module's call at t = 0."""
        if not self.now:
            self.simulation.InitializeSimulation()
        self.now += ticks * self._step
        self.simulation.ConfigureStopTime(self.now)
        self.simulation.ExecuteSimulation()

    def push(self, loads, now) -> None:
        for vehicle, load in zip(self.vehicles, loads, strict=True):
            vehicle.push(load, now)

    def read(self, q, v) -> None:
        for vehicle, pose, twist in zip(self.vehicles, q, v, strict=True):
            vehicle.read(pose, twist)


class Rig(sysModel.SysModel):
    """The facility as a Basilisk module: relative pose in, wrench on both spacecraft out.

    Attributes:
        bodies: masses, ports and states of both spacecraft.
        rows: time [s], pose of A in P (7,), twist of A relative to P in P (6,), at every step.
    """

    def __init__(self, scenario) -> None:
        super().__init__()
        self.rig, self.bodies = SimulatedRig(scenario, moving=True), NumericalModel([scenario])
        self.ModelTag, self.rows, self._load = "rig", [], np.empty((1, 2, 6))
        of = self.bodies
        self.pair = Pair(of.mass[0], of.inertia[0], of.q[0], of.v[0], scenario.tick, self)

    def UpdateState(self, now) -> None:
        of = self.bodies
        self.pair.read(of.q[0], of.v[0])
        relative_states(of.q, of.v, of.port, of.pose, of.twist)
        if now > 0:
            self.rig.step(of.pose[0])
        load_wrench(of.q, of.port, self.rig.wrench[None], self._load)
        self.pair.push(self._load[0], now)
        self.rows.append((macros.NANO2SEC * now, *of.pose[0], *of.twist[0]))


def dock(scenario) -> Rig:
    """The rig of a ``scenario`` between two Basilisk spacecraft, after its duration."""
    rig = Rig(scenario)
    rig.pair.step(round(scenario.duration * scenario.rate))
    return rig


class BasiliskModel(NumericalModel):
    """A numerical model whose motion is that of Basilisk's spacecraft."""

    def __init__(self, scenarios) -> None:
        super().__init__(scenarios)
        parts = zip(self.mass, self.inertia, self.q, self.v, strict=True)
        self.pairs = [Pair(*bodies, self.tick) for bodies in parts]
        self._loads = np.empty((self.n, 2, 6))

    def advance(self, wrench) -> None:
        """One tick under ``wrench`` (n, 6), active on passive, in P at P's origin."""
        load_wrench(self.q, self.port, wrench, self._loads)
        for pair, loads, q, v in zip(self.pairs, self._loads, self.q, self.v, strict=True):
            pair.push(loads, pair.now)
            pair.step()
            pair.read(q, v)
        relative_states(self.q, self.v, self.port, self.pose, self.twist)


@register
class Basilisk(ModelKind):
    """Chaser and target as two Basilisk spacecraft, rigid and without gravity."""

    kind: Literal["basilisk"] = "basilisk"
    ticks_late = 0.5

    @classmethod
    def start(cls, scenarios):
        return BasiliskModel(scenarios)


if __name__ == "__main__":
    case = hiltestbed.load_scenario("03-bumper-delay-uncompensated", {"duration": 1.0})
    rows = dock(case).rows
    own = hiltestbed.run(case).summary["cor"]
    print(f"coefficient of restitution: Basilisk {-rows[-1][10] / rows[0][10]:.4f}, own {own:.4f}")
