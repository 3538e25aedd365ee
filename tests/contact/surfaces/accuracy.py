"""A ball in the shipped cone: what each way to describe the cone says of penetration and normal,
and what it costs.

python -m tests.contact.surfaces.accuracy
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import coal
import mujoco
import numpy as np
from numba import njit

from hiltestbed.contact.surfaces.mesh import plant
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.surface import MESH, TURNED, Surface, signed_distance
from hiltestbed.contact.surfaces.turned import obj_text, polyline, shell, turn
from tests.equipment.independent_rig.cone import Surfaces

CONE = Path(__file__).resolve().parents[3] / "models" / "probe_cone"
SHAPE = Surfaces()
BALL, SOCKET, HALF_ANGLE, GENERATOR = SHAPE.tip, SHAPE.socket, SHAPE.half_angle, SHAPE.generator
THICKNESS = 2.0 * SHAPE.half_wall
DEPTH = 1e-3  # [m]
# a place of the ball's centre to penetration and outward normal
Query = Callable[[np.ndarray], tuple[float, np.ndarray]]


@dataclass(frozen=True)
class Row:
    """What a description of the cone is worth: worst error of the normal [deg], of the penetration
    [m], and a query's time [s].
    """

    name: str
    normal: float
    depth: float
    cost: float


def turned_cone(segments: int) -> tuple[np.ndarray, np.ndarray]:
    return turn(
        polyline(shell(SOCKET, HALF_ANGLE, GENERATOR, THICKNESS), math.radians(5.0)), segments
    )


def places(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (count, 3) [m] of a ball DEPTH in the straight part, and the normals, by hand."""
    rng = np.random.default_rng(4)
    azimuth, along = rng.uniform(0.0, 2.0 * math.pi, count), rng.uniform(0.04, 0.18, count)
    sin, cos = math.sin(HALF_ANGLE), math.cos(HALF_ANGLE)
    off = SOCKET - (BALL - DEPTH)  # from the socket's centre across the generator
    rho, z = off * cos + along * sin, off * sin - SOCKET - along * cos
    radial = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    return np.column_stack([rho[:, None] * radial, z]), np.column_stack(
        [-cos * radial, np.full(count, -sin)]
    )


@njit
def _many(surface, points, normal):
    total = 0.0
    for i in range(points.shape[0]):
        total += signed_distance(surface, points[i], math.inf, normal)
    return total


def _kernel(name: str, surface: Surface) -> Row:
    normal = np.zeros(3)

    def query(p: np.ndarray) -> tuple[float, np.ndarray]:
        return BALL - signed_distance(surface, p, math.inf, normal), normal

    points = places(2000)[0]
    _many(surface, points[:1], normal)
    start = time.thread_time()
    _many(surface, points, normal)
    return _row(name, query, (time.thread_time() - start) / len(points))


def _row(name: str, query: Query, cost: float | None = None, count: int = 300) -> Row:
    centres, normals = places(count)
    start = time.thread_time()
    found = [(depth, normal.copy()) for depth, normal in map(query, centres)]
    spent = (time.thread_time() - start) / count
    angles = [
        math.atan2(np.linalg.norm(np.cross(n, m)), n @ m)
        for (_, n), m in zip(found, normals, strict=True)
    ]
    return Row(
        name,
        math.degrees(max(angles)),
        max(abs(d - DEPTH) for d, _ in found),
        spent if cost is None else cost,
    )


def _coal(segments: int) -> Row:
    vertices, faces = turned_cone(segments)
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(vertices))
    tree.addVertices(vertices)
    tree.addTriangles(faces)
    tree.endModel()
    point = coal.Sphere(1e-9)
    request = coal.DistanceRequest()
    still = coal.Transform3s()
    turned = np.eye(3)

    def query(p: np.ndarray) -> tuple[float, np.ndarray]:
        result = coal.DistanceResult()
        coal.distance(tree, still, point, coal.Transform3s(turned, p), request, result)
        away = p - result.getNearestPoint1()
        distance = float(np.linalg.norm(away))
        return BALL - distance, away / distance

    return _row(f"coal, {segments} segments", query)


def _contacts(name: str, assets: str, geoms: str, files: dict[str, bytes]) -> Row:
    """MuJoCo's own contacts, summed by depth; the cost is that of mj_forward."""
    xml = f"""<mujoco><option gravity="0 0 0"/><asset>{assets}</asset><worldbody>{geoms}
      <body name="ball"><freejoint/><geom type="sphere" size="{BALL}" mass="1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml, files)
    data = mujoco.MjData(model)

    def query(p: np.ndarray) -> tuple[float, np.ndarray]:
        data.qpos[:] = (*p, 1.0, 0.0, 0.0, 0.0)
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        depths = np.maximum(-data.contact.dist, 0.0)
        if not depths.size or depths.max() == 0.0:
            return 0.0, np.array([1.0, 0.0, 0.0])
        normals = (
            data.contact.frame[:, :3]
            * np.where(data.contact.geom2 == model.ngeom - 1, 1.0, -1.0)[:, None]
        )
        normal = depths @ normals
        return float(depths.max()), normal / np.linalg.norm(normal)

    return _row(name, query, count=100)


def _wedges(count: int) -> Row:
    """The straight part of the shell cut along meridians into convex pieces."""
    sin, cos = math.sin(HALF_ANGLE), math.cos(HALF_ANGLE)
    corners = [(o, a) for o in (SOCKET, SOCKET + THICKNESS) for a in (0.0, GENERATOR)]
    profile = np.array([(o * cos + a * sin, o * sin - SOCKET - a * cos) for o, a in corners])
    assets, geoms = "", ""
    for k in range(count):
        azimuth = 2.0 * math.pi * (np.array([k, k + 1])) / count
        points = [(r * math.cos(a), r * math.sin(a), z) for r, z in profile for a in azimuth]
        text = " ".join(f"{x:.12g}" for p in points for x in p)
        assets += f'<mesh name="w{k}" vertex="{text}"/>'
        geoms += f'<geom type="mesh" mesh="w{k}"/>'
    return _contacts(f"{count} convex wedges", assets, geoms, {})


def _field(segments: int) -> Row:
    text = obj_text(*turned_cone(segments), "cone").encode()
    assets = '<mesh name="cone" file="cone.obj" inertia="shell"/>'
    return _contacts(
        f"MuJoCo signed distance field, {segments} segments",
        assets,
        '<geom type="sdf" mesh="cone"/>',
        {"cone.obj": text},
    )


def _turned(segments: int) -> Surface:
    found = recognise(*turned_cone(segments))
    return Surface(TURNED, np.zeros(3), found.profile)


def _tree(segments: int) -> Surface:
    return Surface(MESH, np.zeros(3), tree=plant(*turned_cone(segments)))


def table() -> list[Row]:
    """The descriptions of the cone, best first."""
    rows = [_kernel("profile recovered from 96 segments", _turned(96))]
    rows += [_kernel(f"tree of triangles, {n} segments", _tree(n)) for n in (1024, 256)]
    rows += [_coal(1024), _coal(256), _wedges(128), _wedges(64), _field(256)]
    return rows


if __name__ == "__main__":
    print(
        "| model of the cone | normal error [deg] | penetration error [mm] | cost [us] "
        "|\n|---|---|---|---|"
    )
    for row in table():
        print(f"| {row.name} | {row.normal:.2g} | {row.depth * 1e3:.2g} | {row.cost * 1e6:.3g} |")
