"""What an acceleration of the platform takes of its drives.

Joint accelerations a that move the tool and keep the loops closed satisfy J a = (tool, 0). The
drives' forces f, the loads r in locked joints and l in the loops then satisfy M a = S' f + L' r +
C' l (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, equation 8.6), S, L and C the rows of
the Jacobian of driven joints, locked joints and loops.
"""

from __future__ import annotations

import mujoco
import numpy as np

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.kinematics import Kinematics


def force_shares(model: mujoco.MjModel, kinematics: Kinematics) -> Array:
    """``(J, 6)`` share of each drive's force, beyond its load at rest, that a unit acceleration of
    the first tool takes at home, in W [s^2/m, s^2/rad]; 1 is all that the drive has.

    Springs (the deflection of gears) and prescribed joints (a rail) are locked.
    """
    data = mujoco.MjData(model)
    data.qpos = kinematics.home
    jacobian = model.opt.jacobian
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_forward(model, data)
    model.opt.jacobian = jacobian
    tool = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, tool[:3], tool[3:], model.site(kinematics.tools[0]).id)
    closed = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    loops = data.efc_J.reshape(-1, model.nv)[closed]
    held = [model.joint(name).id for name in kinematics.prescribed]
    locked = np.isin(model.dof_jntid, [*held, *np.flatnonzero(model.jnt_stiffness)])
    rows = np.eye(model.nv)
    fixed = np.vstack([rows[locked], loops])
    rates = np.linalg.pinv(np.vstack([tool, fixed]))[:, :6]
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    free = ~locked[kinematics.v]
    driven, most = kinematics.v[free], np.array([axis.force for axis in kinematics.axes])[free]
    forces = np.linalg.pinv(np.vstack([rows[driven], fixed]).T)[: len(driven)]
    weight = forces @ (data.qfrc_bias - data.qfrc_gravcomp)
    # a drive that cannot hold the weight has nothing left
    left = np.maximum(most - np.abs(weight), np.finfo(float).eps * most)
    return forces @ mass @ rates / left[:, None]
