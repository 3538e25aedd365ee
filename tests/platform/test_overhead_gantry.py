"""The overhead gantry: its kinematics, and its drives against the linear equations of MuJoCo's own
matrices.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from hiltestbed.frames import Array
from hiltestbed.platform.facilities.facility import MOUNT, MOUNT_HOME, Facility, compiled
from hiltestbed.platform.facilities.measure import frequency_response, static_compliance
from hiltestbed.platform.facilities.stand import TOOL, Stand
from hiltestbed.platform.kinds import PLATFORMS
from tests.platform.halls import apart, mass_and_jacobian, mujoco_pose, poses

DIRECT = {"controller_rate": None}
NEAR = 1e-6  # [m], [rad]


@pytest.fixture(scope="module")
def gantry() -> Facility:
    return (
        PLATFORMS["overhead_gantry"]
        .model_validate({"kind": "overhead_gantry", "command": DIRECT})
        .facility()
    )


def matrices(gantry: Facility) -> tuple[Array, Array, Array, Array]:
    """Mass (6, 6), Jacobian of A (6, 6), kp and kv (6,) of the driven joints."""
    stand = Stand(gantry)
    m = stand.model
    mass, jac, _ = mass_and_jacobian(m, stand.drives.kinematics.home, TOOL)
    gains = [
        (int(m.actuator_trnid[a, 0]), m.actuator_gainprm[a, 0], -m.actuator_biasprm[a, 2])
        for a in range(m.nu)
    ]
    dofs = [int(m.jnt_dofadr[j]) for j, _, _ in gains]
    return (
        mass[np.ix_(dofs, dofs)],
        jac[:, dofs],
        np.array([k for _, k, _ in gains]),
        np.array([c for _, _, c in gains]),
    )


def test_inverse_and_forward_kinematics_agree_over_metres(gantry: Facility) -> None:
    m = compiled(gantry.spec())
    kinematics = gantry.kinematics(m)
    goals = poses(30, 0.75, 25.0)
    goals[:, :3] += MOUNT_HOME[:3]
    for goal in goals:
        q, left = kinematics.solve(goal)
        assert left < 1e-9
        assert max(apart(mujoco_pose(m, q, MOUNT), goal)) < NEAR


def test_it_follows_as_its_linear_equations_say(gantry: Facility) -> None:
    """x = J (M s^2 + C s + K)^-1 K J^-1 r at home, up to 1.5 times the bandwidth of each slide."""
    mass, jac, kp, kv = matrices(gantry)
    f = [2.0, 4.0, 8.0, 12.0]
    found = frequency_response(gantry, f, axes=[0, 1, 2])
    for n, s in enumerate(2j * math.pi * np.array(f)):
        law = (
            jac
            @ np.linalg.solve(mass * s**2 + np.diag(kv * s + kp), np.diag(kp))
            @ np.linalg.inv(jac)
        )
        for axis, highest in ((0, 6.0), (1, 9.0), (2, 12.0)):
            if f[n] <= highest:
                ratio = found.own[axis][n] / law[axis, axis]
                assert abs(20.0 * math.log10(abs(ratio))) < 1.0
                assert abs(math.degrees(np.angle(ratio))) < 5.0


def test_it_is_as_stiff_as_its_drives(gantry: Facility) -> None:
    """Compliance J K^-1 J^T of A, without the weight: on the axes of the slides, levers of the
    wrist and all.
    """
    _, jac, kp, _ = matrices(gantry)
    expected = jac @ np.diag(1.0 / kp) @ jac.T
    assert np.diag(static_compliance(gantry, settle=2.0))[:3] == pytest.approx(
        np.diag(expected)[:3], rel=0.02
    )
