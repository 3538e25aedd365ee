"""Kinematics of the platform against MuJoCo's own, and its derived Jacobian at home."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from hiltestbed.config.models import load, models_folder
from hiltestbed.errors import InputError
from hiltestbed.platform.build import plant_of
from hiltestbed.platform.facilities.facility import MOUNT, MOUNT_HOME, compiled
from hiltestbed.platform.facilities.kinematics import Kinematics
from hiltestbed.platform.facilities.limbs import (
    LimbKinematics,
    jacobian,
    limb_forces,
    moved_masses,
    slider,
)
from hiltestbed.platform.facilities.prs3 import upper_kinematics
from hiltestbed.platform.facilities.pss33 import shipped_limbs
from hiltestbed.platform.facilities.upper_drives import upper_model
from hiltestbed.platform.shipped.pss33 import Pss33
from tests.platform.halls import facility, poses
from tests.platform.rigs import scenario

LIMBS = shipped_limbs()
CENTRE = np.array([0.0, 0.0, -0.64])  # [m] the platform's origin from A's, models/pss33
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def test_the_workspace_is_within_the_sliders_stroke() -> None:
    m = load("pss33/pss33").compile()
    stroke = m.joint("slider_0").range[1]
    sliders = np.empty((2000, 6))
    for row, pose in zip(sliders, poses(2000, 0.25, 10.0), strict=True):
        row[:] = [slider(limb, pose, np.empty(3)) for limb in LIMBS]
    assert np.abs(sliders).max() < stroke


def test_jacobian_at_home_decouples_into_two_groups() -> None:
    """About the centre of the anchors' plane J^T J = diag(1.5, 1.5, 3, 1.5 r^2, 1.5 r^2, 3 R^2): s'
    = u.v + (b x u).w with three vertical links at 120 deg on radius r and three tangential ones on
    radius R; sum of cos^2 over three spokes is 3/2.
    """
    jac, sliders = np.empty((6, 6)), np.empty(6)
    jacobian(LIMBS, HOME, sliders, jac)
    np.testing.assert_allclose(sliders, 0.0, atol=1e-9)
    x, y, z = CENTRE
    from_centre = np.eye(6)  # twist of the centre to twist of A: v_A = v_C + centre x w
    from_centre[:3, 3:] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    about_centre = jac @ from_centre
    r, big_r = 0.60, 0.80
    expected = np.diag([1.5, 1.5, 3.0, 1.5 * r**2, 1.5 * r**2, 3.0 * big_r**2])
    np.testing.assert_allclose(about_centre.T @ about_centre, expected, atol=1e-9)
    anchors = LIMBS[:, 6:9] - CENTRE
    np.testing.assert_allclose(np.linalg.norm(anchors, axis=1), [r] * 3 + [big_r] * 3, rtol=1e-9)


def test_the_closed_form_solves_the_equations_that_every_facility_solves() -> None:
    """All joints and rates of the bare platform, from the loops' own equations by Newton's method
    to 1e-10.
    """
    platform = facility("pss33")
    model = compiled(platform.spec())
    closed, general = platform.kinematics(model), Kinematics(model, [MOUNT], platform.axes)
    rng, jac, sliders = np.random.default_rng(7), np.empty((6, 6)), np.empty(6)
    for goal in poses(5, 0.25, 10.0):
        goal[:3] += MOUNT_HOME[:3]
        twist, none = rng.normal(size=(1, 6)), np.empty(0)
        q, v = closed.motion(goal[None], twist, none, none)
        np.testing.assert_allclose(q, general.solve(goal[None])[0], atol=1e-8)
        np.testing.assert_allclose(v, general.rates(q, twist), atol=1e-7)
        jacobian(closed.limbs, goal, sliders, jac)
        np.testing.assert_allclose([sliders, jac @ twist[0]], [q[closed.q], v[closed.v]], atol=1e-9)


def bare_platform() -> tuple[mujoco.MjModel, LimbKinematics]:
    model = compiled(facility("pss33").spec())
    return model, facility("pss33").kinematics(model)


def upper_platform() -> tuple[mujoco.MjModel, LimbKinematics]:
    model = upper_model(scenario().mechanism, 1e-3)
    return model, upper_kinematics(model)


@pytest.mark.parametrize("make", [bare_platform, upper_platform])
def test_the_drives_forces_in_closed_form_are_those_of_the_whole_model(make) -> None:
    """From rest, with links that are uniform rods: the work of the drives in each motion that the
    loops allow is that of all joint forces, by MuJoCo's own mass matrix and weight.
    """
    model, kinematics = make()
    count = len(kinematics.limbs)
    for j in range(count):
        link, end = model.body(f"link_{j}"), model.site(f"link_end_{j}").pos
        across = link.mass[0] * (end @ end) / 12.0
        link.ipos[:], link.inertia[:] = 0.5 * end, [across, across, 0.0]
        mujoco.mju_quatZ2Vec(link.iquat, end)
    data, rng = mujoco.MjData(model), np.random.default_rng(8)
    q = kinematics.home.copy()
    q[kinematics.q] += rng.uniform(-0.02, 0.02, count)
    data.qpos[:] = q = kinematics.closed(q)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    every = np.array([kinematics.following(q, unit) for unit in np.eye(count)])
    ways = np.array([kinematics.twists(q, rates)[0] for rates in every]).T.copy()
    accel, found, work = rng.normal(size=count), np.empty(count), np.empty((8, 3))
    bend = ways @ accel - [*model.opt.gravity, 0.0, 0.0, 0.0]
    moving = kinematics.poses(q)[0], np.zeros(3), bend
    moved = moved_masses(model, kinematics.tools[0])
    limb_forces(kinematics.limbs, moved, ways, moving, accel, work, found)
    expected = every @ (mass @ (accel @ every) + data.qfrc_bias)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"limits": {"stroke": 0.1}},
            "joint slider_0 would be at 0.2 m; its travel is -0.1 to 0.1",
        ),
        ({"workspace": {"translation": 3.0}}, "a link is .* m too short at"),
    ],
)
def test_a_start_that_the_sliders_do_not_reach_is_refused(
    settings: dict[str, Any], words: str
) -> None:
    s = scenario()
    platform = Pss33.model_validate({"kind": "pss33", **settings})
    plant = plant_of(
        [s.model_copy(update={"rig": s.rig.model_copy(update={"platform": platform})})]
    )
    start = HOME[None].copy()
    start[0, 2] = 0.2
    start[0, 0] = 2.0 if "workspace" in settings else 0.0
    with pytest.raises(InputError, match=words):
        plant.reset(start, np.zeros((1, 6)))


@pytest.mark.parametrize("mechanism", ["pss33", "frame", "bumper"])
def test_every_mechanism_states_its_dimensions(mechanism: str) -> None:
    text = (models_folder() / mechanism / "README.md").read_text()
    assert "reason" in text.lower()
