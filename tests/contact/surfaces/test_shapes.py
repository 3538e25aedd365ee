"""Distances from analytic geoms against a dense sampling of their surfaces and against what a
nearest point must fulfil.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from hiltestbed.contact.surfaces.surface import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    of_geom,
    signed_distance,
)

SIZES = {
    PLANE: [0.0, 0.0, 0.0],
    SPHERE: [0.3, 0.0, 0.0],
    CAPSULE: [0.1, 0.25, 0.0],
    CYLINDER: [0.2, 0.1, 0.0],
    BOX: [0.3, 0.2, 0.1],
    ELLIPSOID: [0.3, 0.2, 0.1],
}


def inside(kind: int, sizes: list[float], p: np.ndarray) -> bool:
    a, b, _ = sizes
    if kind == PLANE:
        return float(p[2]) < 0.0
    if kind == SPHERE:
        return float(np.linalg.norm(p)) < a
    if kind == CAPSULE:
        return float(np.linalg.norm(p - [0.0, 0.0, np.clip(p[2], -b, b)])) < a
    if kind == CYLINDER:
        return math.hypot(p[0], p[1]) < a and abs(float(p[2])) < b
    if kind == BOX:
        return bool(np.all(np.abs(p) < sizes))
    return float(((p / np.array(sizes)) ** 2).sum()) < 1.0


def awkward_points(kind: int) -> np.ndarray:
    """At random, in the planes of symmetry, on axes, on edges' and corners' diagonals."""
    rng = np.random.default_rng(kind)
    points = rng.uniform(-0.4, 0.4, (200, 3))
    for i in range(3):
        points[20 * i : 20 * (i + 1), i] = 0.0
    points[60:70, :2] = 0.0
    points[70:80, 1:] = 0.0
    points[80:100] = (
        rng.choice([-1.0, 1.0], (20, 3)) * np.array(SIZES[BOX]) * rng.uniform(0.8, 1.2, (20, 1))
    )
    return points


@pytest.mark.parametrize("kind", SIZES)
def test_the_foot_is_on_the_surface_and_the_sign_tells_the_side(kind: int) -> None:
    sizes, normal, there = np.array(SIZES[kind]), np.zeros(3), np.zeros(3)
    for p in awkward_points(kind):
        distance = signed_distance(of_geom(kind, sizes), p, math.inf, normal)
        assert (distance < 0.0) == inside(kind, SIZES[kind], p)
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        assert (
            abs(signed_distance(of_geom(kind, sizes), p - distance * normal, math.inf, there))
            < 1e-12
        )


@pytest.mark.parametrize("kind", [k for k in SIZES if k != PLANE])
def test_no_point_of_the_surface_is_nearer(kind: int) -> None:
    """A ball of the distance's radius about the point holds no change of side: on 200 of its
    directions all is inside, or outside.
    """
    sizes, normal = np.array(SIZES[kind]), np.zeros(3)
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for p in awkward_points(kind)[::4]:
        distance = signed_distance(of_geom(kind, sizes), p, math.inf, normal)
        within = inside(kind, SIZES[kind], p)
        assert all(
            inside(kind, SIZES[kind], q) == within
            for q in p + abs(distance) * (1.0 - 1e-9) * directions
        )


@pytest.mark.parametrize("kind", SIZES)
def test_the_sizes_are_those_of_mujoco(kind: int) -> None:
    """MuJoCo's own distance of a small ball from the geom."""
    name = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
    size = "1 1 1" if kind == PLANE else " ".join(map(str, SIZES[kind]))
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><geom type="{name}" size="{size}"/>
        <body><freejoint/><geom type="sphere" size="0.01"/></body></worldbody></mujoco>""")
    data, normal = mujoco.MjData(model), np.zeros(3)
    for p in awkward_points(kind)[100:140]:
        distance = signed_distance(of_geom(kind, np.array(SIZES[kind])), p, math.inf, normal)
        if distance < 0.02:
            continue
        data.qpos[:3] = p
        mujoco.mj_kinematics(model, data)
        assert mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None) == pytest.approx(
            distance - 0.01, abs=1e-4
        )
