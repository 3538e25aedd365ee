"""Probe and cone of the second rig: distances and normals against a numerical search for the
nearest point.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.equipment.independent_rig.cone import (
    Surfaces,
    clearance,
    profile,
    rim_of,
    rod_clearance,
)

CONE = Surfaces()


def _places() -> list[np.ndarray]:
    """Places of the ball's centre: in the socket, along the wall, about the rim and outside, at
    random azimuths.
    """
    rng = np.random.default_rng(3)
    ring, level = rim_of(CONE)
    halfway = [(r, z) for r in np.linspace(0.0, 0.02, 4) for z in np.linspace(-0.045, -0.02, 4)]
    halfway += [
        (0.03 + 0.1 * s, -0.05 - 0.1 * s + d)
        for s in np.linspace(0.0, 1.0, 5)
        for d in (-0.03, 0.0, 0.01)
    ]
    halfway += [
        (ring + 0.04 * math.cos(a), level + 0.04 * math.sin(a))
        for a in np.linspace(-math.pi, 0.4, 8)
    ]
    turns = rng.uniform(-math.pi, math.pi, len(halfway))
    return [
        np.array([r * math.cos(a), r * math.sin(a), z])
        for (r, z), a in zip(halfway, turns, strict=True)
    ]


@pytest.mark.parametrize(
    "place", _places(), ids=lambda p: f"{math.hypot(p[0], p[1]):.3f},{p[2]:.3f}"
)
def test_the_distance_is_that_of_the_nearest_point_of_the_surface(place: np.ndarray) -> None:
    normal = np.zeros(3)
    distance = clearance(CONE, place, normal)
    surface = profile(CONE, 20_000)
    gaps = np.hypot(surface[:, 0] - math.hypot(place[0], place[1]), surface[:, 1] - place[2])
    assert distance == pytest.approx(gaps.min(), abs=1e-8)  # of a search in steps of 10 um
    # The nearest point lies against the normal, which is of unit length.
    nearest = place - distance * normal
    at = surface[gaps.argmin()]
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
    assert math.hypot(nearest[0], nearest[1]) == pytest.approx(at[0], abs=2e-5)
    assert nearest[2] == pytest.approx(at[1], abs=2e-5)


@pytest.mark.parametrize("oval", [0.0, 0.03])
def test_the_normal_is_the_gradient_of_the_distance(oval: float) -> None:
    surfaces = CONE._replace(oval=oval)
    scratch = np.zeros(3)
    for place in _places():
        normal = np.zeros(3)
        clearance(surfaces, place, normal)
        along = math.sin(CONE.half_angle) * math.hypot(place[0], place[1]) - math.cos(
            CONE.half_angle
        ) * (place[2] + CONE.socket)
        if math.hypot(place[0], place[1]) < 1e-6 or abs(along) < 1e-5:
            continue  # on the axis, and where the wall leaves the socket, the gradient jumps
        step = 1e-6
        slope = np.array(
            [
                (
                    clearance(surfaces, place + step * axis, scratch)
                    - clearance(surfaces, place - step * axis, scratch)
                )
                / (2.0 * step)
                for axis in np.eye(3)
            ]
        )
        # An oval wall is taken to first order: its gradient is of unit length but for the square of
        # the ovality.
        np.testing.assert_allclose(normal, slope / np.linalg.norm(slope), atol=2e-6 + 2.0 * oval**2)


def test_the_wall_passes_smoothly_into_the_socket() -> None:
    seam = CONE.socket * np.array(
        [math.cos(CONE.half_angle), 0.0, math.sin(CONE.half_angle)]
    ) + np.array([0.0, 0.0, -CONE.socket])
    inwards = 0.9 * (seam + np.array([0.0, 0.0, CONE.socket])) - np.array([0.0, 0.0, CONE.socket])
    along = np.array([math.sin(CONE.half_angle), 0.0, -math.cos(CONE.half_angle)])
    before, after = np.zeros(3), np.zeros(3)
    assert clearance(CONE, inwards - 1e-7 * along, before) == pytest.approx(
        clearance(CONE, inwards + 1e-7 * along, after), abs=1e-10
    )
    np.testing.assert_allclose(before, after, atol=1e-4)


def _rods() -> list[tuple[np.ndarray, np.ndarray]]:
    """Ball's centre and axis of rods that come near the rim."""
    rng = np.random.default_rng(8)
    found = []
    for _ in range(12):
        azimuth, lean = rng.uniform(-math.pi, math.pi), rng.uniform(0.6, 1.2)
        axis = np.array(
            [
                -math.sin(lean) * math.cos(azimuth),
                -math.sin(lean) * math.sin(azimuth),
                math.cos(lean),
            ]
        )
        ring, level = rim_of(CONE)
        at = rng.uniform(0.05, 0.3)
        rim = np.array([ring * math.cos(azimuth), ring * math.sin(azimuth), level])
        found.append((rim + at * axis + rng.uniform(-0.02, 0.02, 3), axis))
    return found


@pytest.mark.parametrize("rod", _rods(), ids=lambda r: f"{r[1][2]:.2f}")
def test_the_rod_is_as_far_from_the_rim_as_a_search_over_both_says(
    rod: tuple[np.ndarray, np.ndarray],
) -> None:
    ball, axis = rod
    ring, level = rim_of(CONE)
    angles = np.linspace(-math.pi, math.pi, 7200, endpoint=False)
    circle = np.stack(
        [ring * np.cos(angles), ring * np.sin(angles), np.full(angles.shape, level)], axis=1
    )
    back = np.clip((ball - circle) @ axis, CONE.tip, CONE.rod_length)
    gaps = np.linalg.norm(ball - back[:, None] * axis - circle, axis=1)
    normal, place = np.zeros(3), np.zeros(3)
    distance = rod_clearance(CONE, ball, axis, normal, place)
    assert distance == pytest.approx(gaps.min() - CONE.half_wall, abs=2e-6)
    at = circle[gaps.argmin()]
    np.testing.assert_allclose(place - (distance + CONE.half_wall) * normal, at, atol=3e-4)


def test_a_rod_far_from_the_rim_is_told_to_be_no_nearer_than_it_is() -> None:
    rng = np.random.default_rng(2)
    ring, level = rim_of(CONE)
    angles = np.linspace(-math.pi, math.pi, 720)
    circle = np.stack(
        [ring * np.cos(angles), ring * np.sin(angles), np.full(angles.shape, level)], axis=1
    )
    for _ in range(200):
        ball = np.array([*rng.uniform(-0.08, 0.08, 2), rng.uniform(-0.2, -0.03)])
        axis = np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
        axis /= np.linalg.norm(axis)
        back = np.clip((ball - circle) @ axis, CONE.tip, CONE.rod_length)
        true = np.linalg.norm(ball - back[:, None] * axis - circle, axis=1).min() - CONE.half_wall
        told = rod_clearance(CONE, ball, axis, np.zeros(3), np.zeros(3))
        assert told <= true + 1e-6
        assert (told > CONE.rod) == (true > CONE.rod)
