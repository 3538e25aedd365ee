"""Drawn surfaces: closed, facing out, of the volume of the body that they stand for."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hiltestbed.viewer import solids

RGBA = np.array([0.2, 0.4, 0.6, 1.0])


def volume(shape: solids.Solid) -> float:
    """Of a closed surface, by the divergence theorem; negative when it faces inwards."""
    a, b, c = (shape.vertices[shape.triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def facing(shape: solids.Solid) -> float:
    """The smallest cosine between a triangle's own normal and those of its vertices."""
    a, b, c = (shape.vertices[shape.triangles[:, i]] for i in range(3))
    n = np.cross(b - a, c - a)
    size = np.linalg.norm(n, axis=1)
    n = n[size > 1e-12] / size[size > 1e-12, None]
    mean = shape.normals[shape.triangles[size > 1e-12]].mean(axis=1)
    return float(np.einsum("ij,ij->i", n, mean).min())


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (solids.box(np.array([0.3, 0.2, 0.1]), RGBA), 8 * 0.3 * 0.2 * 0.1),
        (solids.cylinder(0.3, 0.2, RGBA), np.pi * 0.3**2 * 0.4),
        (solids.capsule(0.1, 0.2, RGBA), np.pi * 0.1**2 * (0.4 + 4 / 3 * 0.1)),
        (solids.capsule(0.1, 0.0, RGBA), 4 / 3 * np.pi * 0.1**3),
        (solids.ellipsoid(np.array([0.1, 0.2, 0.3]), RGBA), 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
    ],
    ids=["box", "cylinder", "capsule", "sphere", "ellipsoid"],
)
def test_surface_is_closed_and_faces_out(shape: solids.Solid, expected: float) -> None:
    # 48 segments and 20 rings take under 1.5 % of a ball, the bevels under 0.5 % of these boxes and
    # cylinders
    assert volume(shape) == pytest.approx(expected, rel=0.02)
    assert volume(shape) < expected
    assert facing(shape) > 0.5
    assert np.linalg.norm(shape.normals, axis=1) == pytest.approx(1.0)


def test_arrow_points_along_its_vector() -> None:
    vector = np.array([0.2, -0.3, 0.5])
    shape = solids.arrow(vector, 0.01, RGBA)
    along = shape.vertices @ vector / np.linalg.norm(vector)
    assert along.max() == pytest.approx(np.linalg.norm(vector))
    assert along.min() == pytest.approx(0.0, abs=1e-12)
    assert volume(shape) > 0.0


def test_geoms_are_drawn_in_their_size_and_colour() -> None:
    m = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><material name="red" rgba="1 0 0 1"/>
             <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
           <worldbody>
             <geom type="box" size=".1 .2 .3" material="red"/> <geom type="sphere" size=".2" rgba="0 1 0 1"/>
             <geom type="mesh" mesh="wedge"/> <geom type="plane" size="0 0 .1"/>
           </worldbody></mujoco>"""
    )
    drawn = [solids.geom_solid(m, g) for g in range(m.ngeom)]
    assert np.abs(drawn[0].vertices).max(axis=0) == pytest.approx([0.1, 0.2, 0.3])
    assert drawn[0].colors[0].tolist() == [255, 0, 0, 255]
    assert drawn[1].colors[0].tolist() == [0, 255, 0, 255]
    assert volume(drawn[2]) == pytest.approx(1 / 6)  # the tetrahedron
    assert np.abs(drawn[3].vertices[:, :2]).max() == pytest.approx(solids.PLANE)


def test_joined_keeps_every_surface() -> None:
    box = solids.box(np.full(3, 0.1), RGBA)
    two = solids.Solid.joined([box, box.moved(np.array([1.0, 0.0, 0.0]), np.eye(3))])
    assert volume(two) == pytest.approx(2.0 * volume(box))
