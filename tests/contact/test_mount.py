"""The compliant mount: each axis is the spring and damper that it is said to be, quasi-statically
and in motion.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.contact.wrench import LATCH_RADIUS
from hiltestbed.frames import Array
from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import Scenario
from tests.platform.rigs import scenario

STIFFNESS = (4.0e5, 5.0e5, 1.0e5, 2.0e4, 2.5e4, 1.5e4)
DAMPING = (400.0, 500.0, 300.0, 40.0, 50.0, 30.0)
LATCH = 1.0e8  # [N/m] a thousand times the mount's z


def rig(tracking: str = "ideal") -> Scenario:
    contact = {"stiffness": LATCH, "damping": 1.0e5, "friction": 0.0}
    mount = {"stiffness": list(STIFFNESS), "damping": list(DAMPING)}
    return scenario(
        tracking,
        rate=2000.0,
        physics_rate=8000.0,
        mechanism={"kind": "latched", "contact": contact, "mount": mount},
    )


def displaced(axis: int, amount: float) -> Array:
    """Pose ``(1, 7)`` of A moved along (0..2) [m] or turned about (3..5) [rad] one axis."""
    out = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    if axis < 3:
        out[0, axis] = amount
    else:
        out[0, 3:] = Rotation.from_rotvec(amount * np.eye(3)[axis - 3]).as_quat()
    return out


def in_series(axis: int) -> float:
    """Stiffness of mount and latch one behind the other."""
    latch = LATCH * (LATCH_RADIUS**2 if axis > 2 else 1.0)
    return 1.0 / (1.0 / STIFFNESS[axis] + 1.0 / latch)


@pytest.mark.parametrize("axis", range(6))
def test_each_axis_is_its_spring_and_damper_in_motion(axis: int) -> None:
    """A sine of 1.5 Hz through the latch: k within 0.2 %, c within 2 %, by least squares of the
    reading on the path of A.

    The passive side's inertia, 19 kg m^2 about P, stretches the latch by I w^2/(k LATCH_RADIUS^2) =
    0.08 % of the path.
    """
    s = rig()
    plant, w, amount = plant_of([s]), 2.0 * np.pi * 1.5, (1e-3 if axis < 3 else 2e-3)
    plant.reset(displaced(axis, 0.0), np.zeros((1, 6)))
    rows = []
    for k in range(2000):
        t = (k + 1) * s.tick
        goal = displaced(axis, amount * np.sin(w * t))
        plant.advance(goal, np.zeros((1, 6)), np.zeros((1, 6)))
        rows.append(
            (amount * np.sin(w * t), amount * w * np.cos(w * t), plant.wrench_sub[0, -1, axis])
        )
    x, v, force = np.array(rows)[667:].T
    k_c, *_ = np.linalg.lstsq(np.column_stack([x, v]), force, rcond=None)
    assert k_c[0] == pytest.approx(in_series(axis), rel=2e-3)
    assert k_c[1] == pytest.approx(DAMPING[axis], rel=2e-2)
