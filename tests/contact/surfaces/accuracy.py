"""A ball in the shipped cone: what each way to describe the cone says of penetration and normal,
and what it costs.

python -m tests.contact.surfaces.accuracy
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit

from hiltestbed.contact.surfaces.mesh import plant
from hiltestbed.contact.surfaces.revolution import recognise
from hiltestbed.contact.surfaces.surface import MESH, TURNED, Surface, signed_distance
from hiltestbed.contact.surfaces.turned import polyline, shell, turn
from tests.equipment.independent_rig.cone import Surfaces

CONE = Path(__file__).resolve().parents[3] / "models" / "probe_cone"
SHAPE = Surfaces()
BALL, SOCKET, HALF_ANGLE, GENERATOR = SHAPE.tip, SHAPE.socket, SHAPE.half_angle, SHAPE.generator
THICKNESS = 2.0 * SHAPE.half_wall
DEPTH = 1e-3  # [m]


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


def _row(name: str, surface: Surface) -> Row:
    normal = np.zeros(3)

    def query(p: np.ndarray) -> tuple[float, np.ndarray]:
        return BALL - signed_distance(surface, p, math.inf, normal), normal

    points = places(2000)[0]
    _many(surface, points[:1], normal)
    start = time.thread_time()
    _many(surface, points, normal)
    cost = (time.thread_time() - start) / len(points)
    centres, normals = places(300)
    found = [(depth, normal.copy()) for depth, normal in map(query, centres)]
    angles = [
        math.atan2(np.linalg.norm(np.cross(n, m)), n @ m)
        for (_, n), m in zip(found, normals, strict=True)
    ]
    return Row(
        name,
        math.degrees(max(angles)),
        max(abs(d - DEPTH) for d, _ in found),
        cost,
    )


def table() -> list[Row]:
    """The descriptions of the cone, best first."""
    turned = Surface(TURNED, np.zeros(3), recognise(*turned_cone(96)).profile)
    trees = {n: Surface(MESH, np.zeros(3), tree=plant(*turned_cone(n))) for n in (1024, 256)}
    rows = [_row("profile recovered from 96 segments", turned)]
    return rows + [_row(f"tree of triangles, {n} segments", tree) for n, tree in trees.items()]


if __name__ == "__main__":
    print(
        "| model of the cone | normal error [deg] | penetration error [mm] | cost [us] "
        "|\n|---|---|---|---|"
    )
    for row in table():
        print(f"| {row.name} | {row.normal:.2g} | {row.depth * 1e3:.2g} | {row.cost * 1e6:.3g} |")
