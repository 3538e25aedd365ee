"""What an acceleration of the platform and a load on it take of its drives.

Joint accelerations a that move the tools and keep the loops closed satisfy J a = (tools, 0). The
drives' forces f, the loads r in locked joints and l in the loops then satisfy M a + weight = S' f +
L' r + C' l + T' w (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, equation 8.6), S, L, C
and T the rows of the Jacobian of driven joints, locked joints, loops and tools, w the wrenches on
the tools.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import MECHANISMS, Axis, Kinematics


class Demand(NamedTuple):
    """The force of J drives at home [N, N m], linear in what nt tools do, in W.

    Attributes:
        axes: the drives, with their limits. weight: (J,) at rest. inertia: (J, 6 nt) for a unit
            acceleration of each tool [m/s^2, rad/s^2]. load: (J, 6 nt) against a unit wrench on
            each, at its origin [N, N m].
    """

    axes: tuple[Axis, ...]
    weight: Array
    inertia: Array
    load: Array

    @property
    def most(self) -> Array:
        """``(J,)`` the drives' limits [N, N m]."""
        return np.array([axis.force for axis in self.axes])

    @property
    def shares(self) -> Array:
        """``(J, 6)`` share of each drive's force, beyond its weight, that a unit acceleration of
        the first tool takes [s^2/m, s^2/rad]; 1 is all that the drive has left.
        """
        # a drive that cannot hold the weight has nothing left
        left = np.maximum(self.most - np.abs(self.weight), np.finfo(float).eps * self.most)
        return self.inertia[:, :6] / left[:, None]


def demand(model: mujoco.MjModel, kinematics: Kinematics) -> Demand:
    """Of the drives of a composed model.

    Springs (the deflection of gears), prescribed joints (a rail) and the joints of the mechanisms
    are locked.
    """
    data = mujoco.MjData(model)
    data.qpos = kinematics.home
    jacobian = model.opt.jacobian
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_forward(model, data)
    model.opt.jacobian = jacobian
    tools = np.zeros((len(kinematics.tools), 6, model.nv))
    for tool, name in zip(tools, kinematics.tools, strict=True):
        mujoco.mj_jacSite(model, data, tool[:3], tool[3:], model.site(name).id)
    tools = tools.reshape(-1, model.nv)
    closed = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    loops = data.efc_J.reshape(-1, model.nv)[closed]
    names = [model.joint(j).name for j in model.dof_jntid]
    held = [name in kinematics.prescribed or name.startswith(MECHANISMS) for name in names]
    locked = np.array(held) | (model.jnt_stiffness[model.dof_jntid] != 0.0)
    rows = np.eye(model.nv)
    fixed = np.vstack([rows[locked], loops])
    rates = np.linalg.pinv(np.vstack([tools, fixed]))[:, : len(tools)]
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    driven = [j for j, v in enumerate(kinematics.v) if not locked[v]]
    forces = np.linalg.pinv(np.vstack([rows[kinematics.v[driven]], fixed]).T)[: len(driven)]
    return Demand(
        axes=tuple(kinematics.axes[j] for j in driven),
        weight=forces @ (data.qfrc_bias - data.qfrc_gravcomp),
        inertia=forces @ mass @ rates,
        load=-forces @ tools.T,
    )
