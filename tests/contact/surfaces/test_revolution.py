"""Profiles recovered from meshes whose generating curve is known."""

from __future__ import annotations

import math
import runpy

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.contact.surfaces.profile import Element, profile_distance
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


def found(
    loop: list[Element],
    segments: int = 48,
    turned: Rotation | None = None,
    at: tuple[float, float, float] = (0, 0, 0),
) -> Revolution:
    vertices, faces = turn(polyline(loop, math.radians(6.0)), segments)
    result = recognise((turned or Rotation.identity()).apply(vertices) + at, faces)
    assert result is not None
    return result


def distance(revolution: Revolution, point: tuple[float, float, float]) -> float:
    return profile_distance(revolution.profile, np.array(point), np.zeros(3))


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


def test_any_axis_and_place() -> None:
    turned, at = Rotation.from_euler("xyz", [0.4, -1.1, 0.2]), (0.3, -0.2, 0.5)
    torus = found(TORUS, turned=turned, at=at)
    assert abs(torus.profile[0, 3:6] @ turned.apply([0.0, 0.0, 1.0])) == pytest.approx(
        1.0, abs=1e-12
    )
    assert distance(torus, tuple(turned.apply([0.0, 0.35, 0.0]) + at)) == pytest.approx(
        0.02, abs=1e-9
    )
    assert distance(torus, tuple(turned.apply([0.31, 0.0, 0.01]) + at)) == pytest.approx(
        math.hypot(0.01, 0.01) - 0.03, abs=1e-9
    )


def test_single_precision_vertices() -> None:
    vertices, faces = turn(polyline(TORUS, math.radians(6.0)), 64)
    torus = recognise(vertices.astype(np.float32).astype(float), faces)
    assert torus is not None
    assert distance(torus, (0.0, 0.4, 0.0)) == pytest.approx(0.07, abs=3e-8)


def test_a_ball_is_a_ball() -> None:
    ball = found(BALL)
    assert distance(ball, (0.0, 0.0, 0.3)) == pytest.approx(0.1, abs=1e-9)
    assert distance(ball, (0.1, 0.1, 0.1)) == pytest.approx(math.sqrt(0.03) - 0.2, abs=1e-9)
    assert distance(ball, (0.0, 0.0, 0.0)) == pytest.approx(-0.2, abs=1e-9)


def test_the_corners_of_a_rectangle_are_no_circle() -> None:
    ring = found(SQUARE)
    assert all(e.centre is None for e in ring.loops[0])
    assert distance(ring, (0.23, 0.0, 0.14)) == pytest.approx(0.05, abs=1e-12)
    assert distance(ring, (0.0, 0.15, 0.02)) == pytest.approx(-0.02, abs=1e-12)
    assert distance(ring, (0.0, 0.0, 0.05)) == pytest.approx(0.1, abs=1e-12)


def test_a_ball_with_a_hollow() -> None:
    outer = turn(polyline(BALL, math.radians(6.0)), 48)
    inner = turn(polyline(BALL, math.radians(6.0)), 48)
    vertices = np.concatenate([outer[0], 0.5 * inner[0]])
    hollow = recognise(vertices, np.concatenate([outer[1], inner[1][:, ::-1] + len(outer[0])]))
    assert hollow is not None
    assert distance(hollow, (0.0, 0.0, 0.0)) == pytest.approx(0.1, abs=1e-9)
    assert distance(hollow, (0.13, 0.0, 0.0)) == pytest.approx(-0.03, abs=1e-9)


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
