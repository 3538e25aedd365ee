"""Probe and cone: a force that is exact anywhere on the surface, friction at its limit, an axis of
symmetry that is one.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.contact.facets import NORM, SLIP
from hiltestbed.frames import Array
from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import Scenario
from tests.equipment.independent_rig.cone import Surfaces
from tests.platform.rigs import pose, scenario

K = 1e5
SHAPE = Surfaces()
BALL, ROD_RADIUS, R, EDGE = SHAPE.tip, SHAPE.rod, SHAPE.socket, SHAPE.half_wall
ALPHA, LENGTH = SHAPE.half_angle, SHAPE.generator
SINGLE = 1e-8  # [m] vertices of a mesh are single precision numbers
BALLS, ROD = 1, 0  # places of the facets of ball and rod


def rig(
    tracking: str = "ideal", *, damping: float = 0.0, friction: float = 0.0, **more: object
) -> Scenario:
    contact = {"stiffness": K, "damping": damping, "friction": friction}
    return scenario(tracking, mechanism={"kind": "probe_cone", "contact": contact, **more})


def profile(where: str, t: float) -> tuple[Array, Array]:
    """A point (rho, z) of the surface and its outward normal there, written down from the
    dimensions alone.

    ``t`` in 0..1 runs along the part: socket from the bottom up, cone from socket to rim, rim from
        inside to outside, outside upwards.
    """
    # of the cone, towards the axis and the opening
    inward = np.array([-math.cos(ALPHA), -math.sin(ALPHA)])
    along = np.array([math.sin(ALPHA), -math.cos(ALPHA)])
    socket = np.array([0.0, -R])
    start = socket - R * inward
    if where == "socket":
        angle = t * (math.pi / 2.0 - ALPHA)
        out = np.array([math.sin(angle), math.cos(angle)])
        return socket + R * out, -out
    if where == "cone":
        return start + t * LENGTH * along, inward
    ring = start + LENGTH * along - EDGE * inward
    if where == "rim":
        turn = t * math.pi
        normal = inward * math.cos(turn) + along * math.sin(turn)
        return ring + EDGE * normal, normal
    return ring - EDGE * inward - t * LENGTH * along, -inward


PLACES = [("socket", 0.0), ("socket", 0.4), ("cone", 0.1), ("cone", 0.6), ("cone", 0.95)]
PLACES += [("rim", 0.2), ("rim", 0.5), ("rim", 0.9), ("outside", 0.1), ("outside", 0.4)]


def pressed(where: str, t: float, azimuth: float, depth: float) -> tuple[Array, Array]:
    """The pose ``(1, 7)`` of a probe whose ball is ``depth`` [m] in the surface, and the direction
    (3,) that it pushes.

    Upright; on the outside, where the rim is in the way of an upright rod, along the direction that
    it pushes.
    """
    point, normal = profile(where, t)
    centre = point + (BALL - depth) * normal
    c, s = math.cos(azimuth), math.sin(azimuth)
    push = -np.array([normal[0] * c, normal[0] * s, normal[1]])
    turn = (
        Rotation.align_vectors(push[None], [[0.0, 0.0, 1.0]])[0]
        if where == "outside"
        else Rotation.identity()
    )
    tip = np.array([centre[0] * c, centre[0] * s, centre[1]]) + BALL * turn.apply([0.0, 0.0, 1.0])
    return np.concatenate([tip, turn.as_quat()])[None], push


def test_force_of_a_penetration_anywhere_on_the_passive_surface(subtests: pytest.Subtests) -> None:
    """Magnitude k x within 0.1 %, direction within 0.01 deg, one contact."""
    plant = plant_of([rig()])
    for (where, t), azimuth in product(PLACES, [0.0, 1.0, 2.2, -0.7, -2.9]):
        with subtests.test(where=where, t=t, azimuth=azimuth):
            start, push = pressed(where, t, azimuth, 1e-3)
            plant.reset(start, np.zeros((1, 6)))
            force = plant.wrench_sub[0, -1, :3]
            size = np.linalg.norm(force)
            assert size == pytest.approx(K * 1e-3, abs=K * SINGLE)
            assert math.degrees(math.acos(min(1.0, force @ push / size))) < 1e-4
            centre = start[0, :3] - BALL * Rotation.from_quat(start[0, 3:]).apply([0.0, 0.0, 1.0])
            arm = centre + (BALL - 0.5e-3) * push
            np.testing.assert_allclose(plant.wrench_sub[0, -1, 3:], np.cross(arm, force), atol=1e-5)


@pytest.mark.parametrize(("where", "t"), [("cone", 0.6), ("rim", 0.5)])
def test_the_servo_feels_the_same_force_at_the_pose_that_it_reaches(where: str, t: float) -> None:
    plant, still = plant_of([rig("servo", damping=200.0)]), np.zeros((1, 6))
    start, push = pressed(where, t, 0.4, 1e-3)
    plant.reset(start, still)
    for _ in range(600):
        plant.advance(start, still, still)
    moved = plant.pose_act[0, :3] - start[0, :3]
    force = plant.wrench_sub[0, -1, :3]
    assert np.linalg.norm(force) == pytest.approx(K * (1e-3 + moved @ push), rel=1e-3)
    assert math.degrees(math.acos(force @ push / np.linalg.norm(force))) < 0.05


@pytest.mark.parametrize("azimuth", [0.0, 0.9, 2.5])
def test_the_rod_meets_the_rim_in_one_contact(azimuth: float) -> None:
    """A rod that leans over the rim at 60 deg from the axis, steeper than the cone, is pushed
    across itself; its ball is clear.
    """
    ring = np.array(
        [
            (R + EDGE) * math.cos(ALPHA) + LENGTH * math.sin(ALPHA),
            (R + EDGE) * math.sin(ALPHA) - R - LENGTH * math.cos(ALPHA),
        ]
    )
    wanted, lean = 5e-4, math.radians(60.0)
    back = np.array([math.sin(lean), -math.cos(lean)])
    across = np.array([math.cos(lean), math.sin(lean)])
    tip = ring - 0.12 * back - (ROD_RADIUS + EDGE - wanted) * across
    c, s = math.cos(azimuth), math.sin(azimuth)

    def around(v: Array) -> Array:
        return np.array([v[0] * c, v[0] * s, v[1]])

    axis, centre = around(-back), around(tip)
    turn = Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0]
    plant = plant_of([rig()])
    plant.reset(np.concatenate([centre + BALL * axis, turn.as_quat()])[None], np.zeros((1, 6)))
    met = plant.contacts().met[0]
    assert met[BALLS, 0] < 0.0
    assert met[ROD, 0] == pytest.approx(wanted, abs=SINGLE)
    np.testing.assert_allclose(met[ROD, NORM:SLIP], around(across), atol=1e-6)


def test_nothing_is_felt_where_nothing_touches() -> None:
    plant = plant_of([rig()])
    for x, z in ((0.0, -0.01), (0.1, -0.12), (0.25, -0.1), (0.25, 0.0)):
        plant.reset(pose(x, 0.0, z), np.zeros((1, 6)))
        assert not plant.wrench_sub.any()
        assert not plant.contact[0]


@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_sliding_down_the_cone_is_at_the_coulomb_limit(tracking: str) -> None:
    """Tangential over normal force within 1 % of mu, sliding at 0.05 m/s along the generator."""
    plant, mu, speed = plant_of([rig(tracking, friction=0.2)]), 0.2, 0.05
    start, push = pressed("cone", 0.7, 0.3, 1e-3)
    down = np.array(
        [-math.sin(ALPHA) * math.cos(0.3), -math.sin(ALPHA) * math.sin(0.3), math.cos(ALPHA)]
    )
    twist = np.concatenate([speed * down, np.zeros(3)])[None]
    plant.reset(start, twist)
    for k in range(600):
        goal = start.copy()
        goal[0, :3] += speed * down * (k + 1) / 2000.0
        plant.advance(goal, twist, np.zeros((1, 6)))
    force = plant.wrench_sub[0, -1, :3]
    assert (force @ down) / (force @ push) == pytest.approx(mu, rel=1e-2)


def test_below_the_limit_the_creep_is_as_stated() -> None:
    """mu |F| v/sqrt(v^2 + v_0^2), v_0 = 1e-4 m/s: a tenth of the limit is borne at v_0/sqrt(99)."""
    plant = plant_of([rig(friction=0.2)])
    start, push = pressed("socket", 0.0, 0.0, 1e-3)
    creep = 1e-4 / math.sqrt(99.0)
    plant.reset(start, np.array([[creep, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    force = plant.wrench_sub[0, -1, :3]
    assert force[0] / (force @ push) == pytest.approx(0.02, rel=1e-6)
