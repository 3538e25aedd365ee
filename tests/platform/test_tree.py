"""The compiled tree against MuJoCo's own kinematics, Jacobians and weights."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hiltestbed.config.models import load
from hiltestbed.errors import InputError
from hiltestbed.platform.facilities.facility import compiled
from hiltestbed.platform.facilities.kinematics import Axis, Kinematics
from hiltestbed.platform.facilities.motion import (
    move,
    place,
    scratch,
    tool_pose,
    tool_twist,
    weights,
)
from hiltestbed.platform.facilities.tree import build_tree
from tests.platform.halls import apart, arms, mujoco_pose

# Every type of joint, off their bodies' origins, with references that are not zero and several in
# one body.
CHAIN = """
<mujoco><compiler angle="radian"/><option gravity="1 -2 -9"/><worldbody>
 <body name="a" pos="0.1 0.2 0.3" quat="0.8 0.2 -0.4 0.4"><inertial pos="0.1 -0.2 0.05" mass="3" fullinertia="0.3 0.4 0.5 0.01 0.02 -0.03"/>
  <joint name="s" type="slide" axis="0.6 0 0.8" ref="0.2"/><joint name="h" axis="0 0.6 0.8" pos="0.1 0 0.2" ref="0.5" armature="0.7"/>
  <body name="b" pos="0.5 0 0.1" gravcomp="1"><inertial pos="0 0.1 0" mass="2" diaginertia="0.1 0.2 0.25"/>
   <joint name="ball" type="ball" pos="0.05 0.1 0"/>
   <body name="c" pos="0 0.4 0"><inertial pos="0.1 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/><joint name="k" axis="1 0 0"/>
    <site name="tool" pos="0.3 0.1 0" quat="0.5 0.5 -0.5 0.5"/></body></body></body>
 <body name="d" pos="0 0 1" gravcomp="0.4"><freejoint name="free"/>
  <inertial pos="0.1 0.2 0" mass="4" diaginertia="0.5 0.6 0.7"/><site name="loose"/></body>
</worldbody></mujoco>
"""


def random_state(m: mujoco.MjModel, seed: int) -> mujoco.MjData:
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(m)
    mujoco.mj_integratePos(m, data.qpos, rng.normal(size=m.nv) * 0.4, 1.0)
    data.qvel[:] = rng.normal(size=m.nv)
    return data


@pytest.mark.parametrize(
    "make",
    [
        lambda: mujoco.MjSpec.from_string(CHAIN),
        lambda: load("stewart/stewart"),
        lambda: arms().spec(),
    ],
)
def test_places_velocities_and_weights_are_mujocos_own(make) -> None:
    m = compiled(make())
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    m.dof_damping[:] = m.jnt_stiffness[:] = 0.0
    site = m.site(m.nsite - 1).name
    tree = build_tree(m, [site])
    w = scratch(tree)
    for seed in range(5):
        data = random_state(m, seed)
        mujoco.mj_forward(m, data)
        place(tree, data.qpos.copy(), w)
        np.testing.assert_allclose(w.poses[:, :3], data.xpos, atol=1e-13)
        pose, twist, jac = np.empty(7), np.empty(6), np.zeros((6, m.nv))
        tool_pose(tree, w, 0, pose)
        assert max(apart(pose, mujoco_pose(m, data.qpos, site))) < 1e-7  # an angle from a matrix
        carried, rest = np.empty(m.nv), mujoco.MjData(m)
        rest.qpos[:] = data.qpos
        mujoco.mj_inverse(m, rest)
        weights(tree, m.opt.gravity.copy(), w, carried)
        size = np.abs(carried).max()
        np.testing.assert_allclose(carried, rest.qfrc_inverse, atol=1e-10 * size)
        move(tree, data.qvel.copy(), w)
        tool_twist(tree, w, 0, twist)
        mujoco.mj_jacSite(m, data, jac[:3], jac[3:], m.site(site).id)
        np.testing.assert_allclose(twist, jac @ data.qvel, atol=1e-12)


LINKAGE = """
<mujoco><compiler angle="radian"/><worldbody>
 <body name="crank"><joint name="crank" axis="0 1 0"/><inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/>
  <body name="rod" pos="0 0 0.3"><joint name="rod" axis="0 1 0"/><inertial pos="0.5 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
   <site name="end" pos="1 0 0"/><site name="tool" pos="0.5 0 0.2"/></body></body>
 <body name="piston" pos="1 0 0.3"><joint name="piston" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
  <joint name="pin" axis="0 1 0"/><site name="bush"/></body>
 <body name="gear" pos="0 2 0"><joint name="gear" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body>
</worldbody><equality><{kind} site1="end" site2="bush"/><joint joint1="gear" joint2="crank" polycoef="0.1 2 0 0 0"/></equality></mujoco>
"""


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_a_slider_crank_closes_as_its_formula_says(kind: str) -> None:
    """Crank r = 0.3 m and rod 1 m: x = r sin a + sqrt(1 - (0.3 - r cos a)^2). A planar loop closed
    in space has redundant rows.
    """
    m = compiled(mujoco.MjSpec.from_string(LINKAGE.format(kind=kind)))
    drive = Axis("crank", "rad", -3.0, 3.0, 1.0, 1.0, 1.0)
    kinematics = Kinematics(m, ["tool"], [drive])
    for angle in (-0.9, -0.2, 0.4, 1.1):
        q = kinematics.home.copy()
        q[0] = angle
        q = kinematics.closed(q)
        assert q[2] == pytest.approx(
            0.3 * np.sin(angle) + np.sqrt(1.0 - (0.3 - 0.3 * np.cos(angle)) ** 2) - 1.0, abs=1e-9
        )
        assert q[4] == pytest.approx(0.1 + 2.0 * angle, abs=1e-9)


def test_a_loop_closed_by_a_tendon_is_refused_by_name() -> None:
    text = LINKAGE.format(kind="connect").replace(
        '<joint joint1="gear" joint2="crank" polycoef="0.1 2 0 0 0"/>',
        '<tendon name="belt" tendon1="t"/>',
    )
    text = text.replace(
        "</mujoco>",
        '<tendon><fixed name="t"><joint joint="gear" coef="1"/></fixed></tendon></mujoco>',
    )
    with pytest.raises(InputError, match="'belt' closes a loop by tendon"):
        build_tree(mujoco.MjSpec.from_string(text).compile(), ["tool"])
