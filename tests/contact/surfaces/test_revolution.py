"""Profiles recovered from meshes whose generating curve is known."""

from __future__ import annotations

import math
import runpy

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.contact.surfaces.profile import Element, compile_profile, profile_distance
from hiltestbed.contact.surfaces.revolution import Revolution, recognise
from hiltestbed.contact.surfaces.turned import obj_text, polyline, turn
from tests.contact.surfaces.accuracy import CONE
from tests.equipment.independent_rig.cone import Surfaces, clearance

SQUARE = [
    Element((0.1, 0.0), (0.1, 0.1)),
    Element((0.1, 0.1), (0.2, 0.1)),
    Element((0.2, 0.1), (0.2, 0.0)),
    Element((0.2, 0.0), (0.1, 0.0)),
]
TORUS = [Element((0.33, 0.0), (0.33, 0.0), (0.3, 0.0), clockwise=True)]
BALL = [Element((0.0, 0.2), (0.0, -0.2), (0.0, 0.0), clockwise=True)]
HOLLOW = [Element((0.0, -0.1), (0.0, 0.1), (0.0, 0.0))]


def test_the_shipped_cone_is_what_its_dimensions_say() -> None:
    """Against the closed form of the independent rig, within the shell's half thickness of its
    inside and its rim.
    """
    cone = _shipped()
    rng, normal, expected = np.random.default_rng(0), np.zeros(3), np.zeros(3)
    compared = 0
    for p in rng.uniform([-0.2, -0.2, -0.2], [0.2, 0.2, 0.0], (5000, 3)):
        wanted = clearance(Surfaces(), p, expected)
        if -0.01 < wanted < 0.03 and p[2] < -0.02:
            compared += 1
            assert profile_distance(cone.profile, p, normal) == pytest.approx(wanted, abs=1e-8)
            assert np.linalg.norm(np.cross(normal, expected)) < 1e-6
    assert compared > 400


def _shipped() -> Revolution:
    model = mujoco.MjModel.from_xml_path(str(CONE / "passive.xml"))
    vertices = np.zeros((model.nmeshvert, 3))
    # MuJoCo keeps them in a frame of the mesh's own
    for v, out in zip(model.mesh_vert.astype(float), vertices, strict=True):
        mujoco.mju_rotVecQuat(out, v, model.mesh_quat[0])
    cone = recognise(vertices + model.mesh_pos[0], model.mesh_face)
    assert cone is not None
    return cone


def test_the_shipped_cone_is_what_its_script_writes() -> None:
    script = runpy.run_path(str(CONE / "turn_cone.py"))
    vertices, faces = turn(polyline(script["PROFILE"], script["ARC_STEP"]), script["SEGMENTS"])
    assert (CONE / "cone.obj").read_text().split("\n", 1)[1] == obj_text(vertices, faces, "").split(
        "\n", 1
    )[1]


@pytest.mark.parametrize("precision", [np.float64, np.float32])
@pytest.mark.parametrize("loops", [[SQUARE], [TORUS], [BALL], [BALL, HOLLOW]])
def test_a_turned_mesh_is_its_generating_curve_on_any_axis_and_place(loops, precision) -> None:
    """Arcs are circles again, and corners are none; two nested loops are a hollow ball."""
    turned, at = Rotation.from_euler("xyz", [0.4, -1.1, 0.2]), np.array([0.3, -0.2, 0.5])
    meshes, count = [turn(polyline(loop, math.radians(6.0)), 48) for loop in loops], 0
    faces = []
    for vertices, own in meshes:
        faces.append(own + count)
        count += len(vertices)
    placed = turned.apply(np.concatenate([vertices for vertices, _ in meshes])) + at
    found = recognise(placed.astype(precision).astype(float), np.concatenate(faces))
    assert found is not None
    truth, normal = compile_profile(loops, at, turned.apply([0.0, 0.0, 1.0])), np.zeros(3)
    for p in at + np.random.default_rng(2).uniform(-0.4, 0.4, (300, 3)):
        expected = profile_distance(truth, p, normal)
        within = 1e-9 if precision is np.float64 else 1e-7
        assert profile_distance(found.profile, p, normal) == pytest.approx(expected, abs=within)


def _box() -> tuple[np.ndarray, np.ndarray]:
    return turn(np.array([[0.0, -0.1], [0.1, -0.1], [0.1, 0.1], [0.0, 0.1]]), 4)


def _dented() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = turn(polyline(TORUS, math.radians(6.0)), 48)
    vertices[100] *= 1.001
    return vertices, faces


def _sector() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = turn(polyline(TORUS, math.radians(6.0)), 48)
    return vertices, faces[vertices[faces][:, :, 0].min(axis=1) > 0.0]


@pytest.mark.parametrize("mesh", [_box, _dented, _sector])
def test_what_was_not_turned_is_not_recognised(mesh) -> None:
    assert recognise(*mesh()) is None
