"""The rig in a Basilisk simulation: two Basilisk spacecraft meet by way of a simulated facility.

    pip install bsk
    python examples/basilisk/docking.py

In every step the module `Rig` takes the relative pose of both ports from the spacecraft's states,
moves the platform there, and returns what the force sensor reads, delay and all, as external force
and torque on both. Basilisk holds them over its step and integrates exactly, which is worth half a
step of delay more than hiltestbed's own semi-implicit model.

Frames: N inertial, B a spacecraft's body at its centre of mass, A and P the ports; r_PB_B is the
place of P from B's origin in B.
"""

from __future__ import annotations

import numpy as np
from Basilisk.architecture import messaging, sysModel
from Basilisk.simulation import extForceTorque, spacecraft
from Basilisk.utilities import SimulationBaseClass, macros
from scipy.spatial.transform import Rotation

import hiltestbed
from hiltestbed.devices.physical import SimulatedRig
from hiltestbed.numerical_model.bodies import approach_state


class Vehicle:
    """A Basilisk spacecraft with a port, and the wrench on it."""

    def __init__(self, body, r_BN_N, rotation_NB, v_BN_N) -> None:
        self.port_B = np.array(body.port.position, dtype=float)
        self.rotation_BP = Rotation.from_euler("xyz", body.port.attitude_deg, degrees=True)
        self.craft = spacecraft.Spacecraft()
        hub = self.craft.hub
        hub.mHub = body.mass
        hub.IHubPntBc_B = np.diag(body.inertia[:3]).tolist()
        hub.r_CN_NInit, hub.v_CN_NInit = (np.reshape(v, (3, 1)).tolist() for v in (r_BN_N, v_BN_N))
        hub.sigma_BNInit = np.reshape(rotation_NB.as_mrp(), (3, 1)).tolist()
        hub.omega_BN_BInit = [[0.0], [0.0], [0.0]]
        self.effector = extForceTorque.ExtForceTorque()
        self.craft.addDynamicEffector(self.effector)
        self.force, self.torque = messaging.CmdForceBodyMsg(), messaging.CmdTorqueBodyMsg()
        self.effector.cmdForceBodyInMsg.subscribeTo(self.force)
        self.effector.cmdTorqueInMsg.subscribeTo(self.torque)
        self.push(np.zeros(3), np.zeros(3), 0)

    def state(self):
        """Place and rotation of the port in N, and the body's rotation and velocity."""
        read = self.craft.scStateOutMsg.read()
        rotation_NB = Rotation.from_mrp(read.sigma_BN)
        r_PN_N = np.array(read.r_BN_N) + rotation_NB.apply(self.port_B)
        return r_PN_N, rotation_NB * self.rotation_BP, rotation_NB, np.array(read.v_BN_N)

    def push(self, force_B, torque_B, now) -> None:
        self.force.write(messaging.CmdForceBodyMsgPayload(forceRequestBody=list(force_B)), now)
        self.torque.write(messaging.CmdTorqueBodyMsgPayload(torqueRequestBody=list(torque_B)), now)


class Rig(sysModel.SysModel):
    """The facility: relative pose in, wrench on both spacecraft out."""

    def __init__(self, scenario, chaser: Vehicle, target: Vehicle) -> None:
        super().__init__()
        self.rig, self.chaser, self.target = SimulatedRig(scenario, moving=True), chaser, target
        self.ModelTag, self.rows = "rig", []

    def Reset(self, now) -> None:
        """The rig starts in the pose that the scenario gives."""

    def UpdateState(self, now) -> None:
        r_A, rotation_A, rotation_C, v_C = self.chaser.state()
        r_P, rotation_P, rotation_T, v_T = self.target.state()
        pose = np.concatenate(
            [
                rotation_P.inv().apply(r_A - r_P),
                (rotation_P.inv() * rotation_A).as_quat(canonical=True),
            ]
        )
        if now > 0:
            self.rig.step(pose)
        force, torque = rotation_P.apply(self.rig.wrench[:3]), rotation_P.apply(self.rig.wrench[3:])
        # what A exerts on P at P's origin; on the chaser its opposite, at the same point
        for vehicle, rotation, at, sign in (
            (self.target, rotation_T, r_P, 1.0),
            (self.chaser, rotation_C, r_P, -1.0),
        ):
            arm = at - np.array(vehicle.craft.scStateOutMsg.read().r_BN_N)
            moment = torque + np.cross(arm, force)
            vehicle.push(
                rotation.inv().apply(sign * force), rotation.inv().apply(sign * moment), now
            )
        self.rows.append((1e-9 * now, pose[2], rotation_P.inv().apply(v_C - v_T)[2]))


def dock(scenario) -> np.ndarray:
    """(steps, 3) time [s], pz of A in P [m], and the approach velocity of the bodies along z
    [m/s].
    """
    pose, twist = np.split(approach_state(scenario), [7])
    bodies = scenario.spacecraft
    target = Vehicle(bodies.target, np.zeros(3), Rotation.identity(), np.zeros(3))
    rotation_P, r_P = target.rotation_BP, target.port_B
    rotation_A = rotation_P * Rotation.from_quat(pose[3:])
    rotation_C = (
        rotation_A * Rotation.from_euler("xyz", bodies.chaser.port.attitude_deg, degrees=True).inv()
    )
    r_A = r_P + rotation_P.apply(pose[:3])
    r_C = r_A - rotation_C.apply(bodies.chaser.port.position)
    chaser = Vehicle(bodies.chaser, r_C, rotation_C, rotation_P.apply(twist[:3]))
    simulation = SimulationBaseClass.SimBaseClass()
    step = macros.sec2nano(scenario.tick)
    simulation.CreateNewProcess("docking").addTask(simulation.CreateNewTask("step", step))
    rig = Rig(scenario, chaser, target)
    for model, priority in ((chaser.craft, 3), (target.craft, 2), (rig, 1)):
        simulation.AddModelToTask("step", model, priority)
    for vehicle in (chaser, target):
        simulation.AddModelToTask("step", vehicle.effector, 4)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(macros.sec2nano(scenario.duration))
    simulation.ExecuteSimulation()
    return np.array(rig.rows)


if __name__ == "__main__":
    case = hiltestbed.load_scenario("03-bumper-delay-uncompensated", {"duration": 1.0})
    rows = dock(case)
    own = hiltestbed.run(case).summary["cor"]
    print(f"coefficient of restitution: Basilisk {-rows[-1, 2] / rows[0, 2]:.4f}, own {own:.4f}")
