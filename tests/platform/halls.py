"""Facilities for the tests, and small quantities that several of them need."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hiltestbed.frames import Array
from hiltestbed.platform.build import built
from hiltestbed.platform.kinds import PLATFORMS

UPRIGHT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
DIRECT = {"controller_rate": None, "delay_cycles": 0}

TABLE = "xyz_table/xyz_table.xml"  # six position servos


def facility(kind: str, **settings: Any) -> Any:
    return built(PLATFORMS[kind].model_validate({"kind": kind} | settings))


def stewart(kind: str = "hydraulic", **drive: Any) -> Any:
    return facility("stewart", drive={"kind": kind} | drive)


def arm(command: dict[str, Any] = DIRECT, **controller: Any) -> Any:
    return facility("serial_arm", controller=controller, command=command)


def arms(command: dict[str, Any] = DIRECT, share: Any = 0.5, **controller: Any) -> Any:
    return facility("two_arms", passive_share=share, controller=controller, command=command)


def poses(n: int, reach: float, turn_deg: float, seed: int = 3) -> Array:
    """``(n, 7)`` poses over +-reach and +-turn, the corners among them."""
    part = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 6))
    part[: n // 4] = np.sign(part[: n // 4])
    return np.hstack(
        [
            reach * part[:, :3],
            Rotation.from_euler("xyz", turn_deg * part[:, 3:], degrees=True).as_quat(),
        ]
    )


def apart(a: Array, b: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses (7,)."""
    turn = Rotation.from_quat(a[3:]).inv() * Rotation.from_quat(b[3:])
    return float(np.linalg.norm(a[:3] - b[:3])), float(turn.magnitude())


def mujoco_pose(m: mujoco.MjModel, q: Array, site: str) -> Array:
    """``(7,)`` pose of a site by MuJoCo's own kinematics."""
    data = mujoco.MjData(m)
    data.qpos[:] = q
    mujoco.mj_kinematics(m, data)
    return np.concatenate(
        [data.site(site).xpos, Rotation.from_matrix(data.site(site).xmat.reshape(3, 3)).as_quat()]
    )


def mass_and_jacobian(m: mujoco.MjModel, q: Array, site: str) -> tuple[Array, Array, Array]:
    """MuJoCo's own mass matrix (nv, nv), Jacobian of a site (6, nv), and motions (nv, f) that the
    loops allow, at ``q``.
    """
    data = mujoco.MjData(m)
    data.qpos[:] = q
    mujoco.mj_forward(m, data)
    mass, jac = np.empty((m.nv, m.nv)), np.zeros((6, m.nv))
    mujoco.mj_fullM(m, data, mass)
    mujoco.mj_jacSite(m, data, jac[:3], jac[3:], m.site(site).id)
    if not m.neq:
        return mass, jac, np.eye(m.nv)
    loops = np.zeros((data.nefc, m.nv))
    if mujoco.mj_isSparse(m):
        mujoco.mju_sparse2dense(
            loops, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
        )
    else:
        loops[:] = data.efc_J.reshape(data.nefc, m.nv)
    loops = loops[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    _, values, right = np.linalg.svd(loops)
    return mass, jac, right[int(np.sum(values > 1e-9 * values[0])) :].T
