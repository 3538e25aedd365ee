"""The kinematic coupling: its seat's stiffness in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.platform.plant import Plant
from tests.platform.rigs import scenario

K, R = 1e5, 0.25  # N/m of a contact, m: as mechanism.yaml and the files have them
PRELOAD, SHIFT = 2e-4, 5e-5  # m: seated so deep, and moved by so little, that all six points bear


def wrench(shift: np.ndarray) -> np.ndarray:
    """Wrench (6,) on P of balls that are PRELOAD deep and moved by ``shift`` (6,) [m, rad]."""
    contact = {"stiffness": K, "damping": 0.0, "friction": 0.0}
    plant = Plant([scenario("ideal", mechanism={"kind": "kinematic_coupling", "contact": contact})])
    place = shift[:3] + np.array([0.0, 0.0, PRELOAD])
    plant.reset(
        np.concatenate([place, Rotation.from_rotvec(shift[3:]).as_quat()])[None], np.zeros((1, 6))
    )
    return plant.wrench_sub[0, -1].copy()


def test_a_seat_is_six_springs_that_do_not_act_on_each_other() -> None:
    """The sum of k J^T J over six points, J = (n, p x n): k diag(3/2, 3/2, 3) and k R^2 diag(3/2,
    3/2, 3), nothing beside the diagonal.

    A turned pair's forces also move with their points, by PRELOAD/R of the stiffness at most
    (8e-4): of an entry of 3, three times that.
    """
    steps = np.diag([SHIFT] * 3 + [SHIFT / R] * 3)
    found = np.stack([(wrench(s) - wrench(-s)) / (2.0 * s.sum()) for s in steps], axis=1)
    scale = np.array([1.0] * 3 + [R] * 3)
    assert found / (K * np.outer(scale, scale)) == pytest.approx(
        np.diag([1.5, 1.5, 3.0] * 2), abs=3.0 * PRELOAD / R
    )


def test_a_seat_bears_its_preload_on_six_faces_at_45_degrees() -> None:
    """Each face is met PRELOAD/sqrt(2) deep and pushes at 45 degrees: 6 k PRELOAD/2 in all; the
    files give places to 1e-9 m.
    """
    assert wrench(np.zeros(6)) == pytest.approx(
        [0.0, 0.0, 3.0 * K * PRELOAD, 0.0, 0.0, 0.0], abs=6.0 * K * 1e-9
    )
