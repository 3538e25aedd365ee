"""Distances from triangle meshes against coal and closed forms; what is wrong with a mesh."""

from __future__ import annotations

import math

import coal
import numpy as np
import pytest

from hiltestbed.contact.surfaces.mesh import mesh_beyond, mesh_distance, plant
from hiltestbed.contact.surfaces.profile import TURNED, profile_distance
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.soundness import MOST_TRIANGLES, examine
from hiltestbed.contact.surfaces.surface import (
    MESH,
    of_geom,
    of_mesh,
    segment_distance,
    signed_distance,
)
from tests.contact.surfaces.accuracy import table, turned_cone

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SIDES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
CUBE_FACES = np.concatenate([SIDES[:, [0, 1, 2]], SIDES[:, [0, 2, 3]]])


def test_a_cube_of_triangles_is_a_box() -> None:
    tree, box = plant(CUBE, CUBE_FACES), of_geom(6, np.ones(3))
    normal, expected = np.zeros(3), np.zeros(3)
    for p in np.random.default_rng(0).uniform(-1.6, 1.6, (2000, 3)):
        wanted = signed_distance(box, p, math.inf, expected)
        assert mesh_distance(tree, p, math.inf, normal) == pytest.approx(wanted, abs=1e-14)
        assert np.abs(normal - expected).max() < 1e-9


def test_nearest_points_are_those_of_coal() -> None:
    vertices, faces = turned_cone(64)
    tree, model = plant(vertices, faces), coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(vertices)
    model.addTriangles(faces)
    model.endModel()
    point, normal = coal.Sphere(1e-9), np.zeros(3)
    for p in np.random.default_rng(0).uniform(-0.2, 0.2, (300, 3)):
        result = coal.DistanceResult()
        coal.distance(
            model,
            coal.Transform3s(),
            point,
            coal.Transform3s(np.eye(3), p),
            coal.DistanceRequest(),
            result,
        )
        theirs = float(np.linalg.norm(p - result.getNearestPoint1()))
        assert abs(mesh_distance(tree, p, math.inf, normal)) == pytest.approx(theirs, abs=2e-9)


def test_beyond_reach_a_bound_is_told_and_within_it_the_distance() -> None:
    tree, normal = plant(*turned_cone(256)), np.zeros(3)
    for p in np.random.default_rng(3).uniform(-0.3, 0.3, (500, 3)):
        exact = mesh_distance(tree, p, math.inf, normal)
        told = mesh_distance(tree, p, 0.05, normal)
        if abs(exact) < 0.05:
            assert told == exact
        else:
            assert 0.05 <= told <= abs(exact)


def test_the_bound_of_a_segment_is_no_more_than_the_least_of_its_points() -> None:
    """And it tells most that are away: a rod of 18 mm before or in a cone."""
    tree = plant(*turned_cone(256))
    normal = np.zeros(3)
    rng = np.random.default_rng(4)
    told = 0
    away = 0
    for start in rng.uniform(-0.2, 0.2, (300, 3)):
        end = start + rng.normal(scale=0.1, size=3)
        points = start + np.linspace(0.0, 1.0, 65)[:, None] * (end - start)
        # of points: no less than the segment's
        least = min(abs(mesh_distance(tree, p, math.inf, normal)) for p in points)
        bound = mesh_beyond(tree, start, end, 0.018)
        assert bound <= least + 1e-15
        assert bound == -math.inf or bound >= 0.018
        told, away = told + (bound > 0.0), away + (least > 0.018)
    assert told > 0.8 * away > 100


def test_the_table_of_descriptions() -> None:
    """Facets of n segments turn the normal by pi/n at most on a cone: 0.70 deg and 0.18 deg, times
    the sine of the half angle.
    """
    rows = {row.name: row for row in table()}
    exact = rows["profile recovered from 96 segments"]
    assert exact.normal < 1e-6
    assert exact.depth < 1e-12
    for segments in (256, 1024):
        row = rows[f"tree of triangles, {segments} segments"]
        assert row.normal < math.degrees(math.pi / segments) * math.sin(math.pi / 4.0) * 1.02


def test_rod_against_the_rim_is_the_least_of_its_points() -> None:
    surface, _ = of_mesh(*turned_cone(96))
    assert surface.kind == TURNED
    normal, nearest, scratch = np.zeros(3), np.zeros(3), np.zeros(3)
    rng = np.random.default_rng(2)
    for _ in range(30):
        start = rng.uniform([-0.2, -0.2, -0.1], [0.2, 0.2, 0.1])
        end = rng.uniform([-0.2, -0.2, -0.5], [0.2, 0.2, -0.2])
        least = segment_distance(surface, start, end, math.inf, normal, nearest)
        along = start + np.linspace(0.0, 1.0, 3001)[:, None] * (end - start)
        sampled = min(profile_distance(surface.profile, p, scratch) for p in along)
        assert sampled - 0.5 * np.linalg.norm(end - start) / 3000 <= least <= sampled
        assert profile_distance(surface.profile, nearest, scratch) == pytest.approx(
            least, abs=1e-15
        )
        bounded = segment_distance(surface, start, end, 0.02, normal, nearest)
        assert bounded == pytest.approx(least, abs=1e-12) if least < 0.02 else bounded >= 0.02


def test_rod_across_a_box_edge() -> None:
    """A line at a height over the edge, across it and at 45 degrees to both faces."""
    start, end = np.array([2.0 + 0.1, 0.0, 0.1]), np.array([0.1, 0.0, 2.0 + 0.1])
    normal, nearest = np.zeros(3), np.zeros(3)
    least = segment_distance(of_geom(6, np.ones(3)), start, end, 1.0, normal, nearest)
    assert least == pytest.approx(0.1 * math.sqrt(2.0), abs=1e-12)
    assert normal == pytest.approx([math.sqrt(0.5), 0.0, math.sqrt(0.5)], abs=1e-7)


def test_a_mesh_that_was_not_turned_keeps_its_triangles() -> None:
    surface, findings = of_mesh(CUBE, CUBE_FACES)
    assert (surface.kind, findings) == (MESH, [])
    assert recognise(CUBE, CUBE_FACES) is None


@pytest.mark.parametrize(
    ("kind", "faces"),
    [
        ("open", CUBE_FACES[1:]),
        ("branched", np.concatenate([CUBE_FACES, CUBE_FACES[:1]])),
        ("crossed", np.concatenate([CUBE_FACES[:1, ::-1], CUBE_FACES[1:]])),
        ("inverted", CUBE_FACES[:, ::-1]),
        ("too_small", CUBE_FACES[:2]),
        ("too_large", np.tile(CUBE_FACES, (MOST_TRIANGLES // 12 + 1, 1))),
    ],
)
def test_what_cannot_be_touched_is_said(kind: str, faces: np.ndarray) -> None:
    surface, findings = of_mesh(CUBE, faces)
    assert surface is None
    assert kind in [f.kind for f in findings]


def test_flat_triangles_are_left_out_and_doubled_vertices_made_one() -> None:
    corners = CUBE[CUBE_FACES].reshape(-1, 3)  # as an STL file has them
    faces = np.concatenate([np.arange(36).reshape(12, 3), [[0, 0, 1]]])
    surface, findings = of_mesh(corners, faces)
    assert surface is not None
    assert [(f.kind, f.count) for f in findings] == [("flat", 1)]
    assert examine(corners, faces[:12]) == []
    assert signed_distance(
        surface, np.array([1.2, 1.3, 0.0]), math.inf, np.zeros(3)
    ) == pytest.approx(math.hypot(0.2, 0.3), abs=1e-14)
