"""Probe and cone: what they exert on each other at any pose and twist."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from hiltestbed.platform.build import plant_of
from tests.equipment.independent_rig.cone import Surfaces, clearance
from tests.equipment.independent_rig.contact import STATES, Contact
from tests.equipment.independent_rig.docking import ROD, TIP, touch_wrench
from tests.platform.rigs import scenario

K, C, MU = 1e5, 300.0, 0.2
SINGLE = 1e-8  # [m] vertices of a mesh are single precision numbers
SHAPE = Surfaces()


def test_the_wrench_at_any_pose_and_twist_is_that_of_the_closed_form() -> None:
    """Of ball and rod on socket, cone, rim and outside, up to 2 mm deep: K x + C v and friction
    along the normal, at the middle of the overlap, written down from the dimensions alone.
    """
    contact = {"stiffness": K, "damping": C, "friction": MU}
    mechanism = {"kind": "probe_cone", "contact": contact}
    plant, law = plant_of([scenario("ideal", mechanism=mechanism)]), Contact(K, C, MU, lever=0.5)
    rng, met = np.random.default_rng(5), {TIP: [], ROD: []}
    for _ in range(40_000):
        turn = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3))
        # all about the cone, or in its socket; sliding, or creeping
        place = rng.choice([1.0, 0.08]) * rng.uniform([-0.25, -0.25, -0.22], [0.25, 0.25, 0.002])
        pose = np.array([*place, *turn.as_quat()])
        twist = rng.choice([0.05, 1e-4]) * rng.uniform(-1.0, 1.0, 6)
        wrench, seen = np.empty(6), np.empty((2, 2))
        touch_wrench(law, SHAPE, pose, twist, np.zeros((2, STATES)), wrench, seen)
        depth = seen[:, 0].max()
        if depth > 2e-3 or (depth < -1e-3 and rng.random() < 0.99):
            continue
        # a rod that is in the wall elsewhere than at the rim has come through it
        axis, back = turn.apply([0.0, 0.0, 1.0]), np.linspace(SHAPE.tip, SHAPE.rod_length, 80)
        least = min(clearance(SHAPE, pose[:3] - b * axis, np.empty(3)) for b in back)
        if least < SHAPE.rod - max(seen[ROD, 0], 0.0) - 1e-4:
            continue
        plant.reset(pose[None], twist[None])
        np.testing.assert_allclose(plant.wrench_sub[0, -1], wrench, atol=K * SINGLE)
        assert plant.contact[0] == (depth > 0.0)
        for which in (TIP, ROD):
            met[which] += [pose[2]] if seen[which, 0] > 0.0 else []
    assert min(len(met[TIP]), len(met[ROD])) > 20
    # from beside the rim, whose height is that of the wall's end, into the socket
    assert min(met[TIP]) < -SHAPE.generator * math.cos(SHAPE.half_angle) - 0.01
    assert max(met[TIP]) > -0.01
