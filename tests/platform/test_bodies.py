"""Air bearing and suspension: momentum, periods, drifts against closed forms, and starts that are
refused.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch

from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.platform.facilities.bodies import Article
from hiltestbed.platform.facilities.facility import Runs, compiled
from hiltestbed.platform.facilities.halls import HOOK
from hiltestbed.platform.facilities.motion import GRAVITY
from tests.platform.halls import facility

STEP = 2.5e-4
CHASER = Article(
    500.0, np.diag([200.0, 180.0, 150.0]), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
)
TARGET = Article(
    2000.0, np.diag([900.0, 900.0, 700.0]), np.array([0.2, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0])
)
PADS = ("film_damping", "friction", "hose_stiffness", "hose_damping")
QUIET = {"tilt": [0.0, 0.0], **dict.fromkeys(PADS, 0.0)}
SMOOTH = {"winch_friction": 0.0, "tension_error": 0.0, "gimbal_offset": 0.0, "winch_mass": 0.0}


class Hall:
    """One pair of articles that is stepped, a force between their ports if wanted."""

    def __init__(self, hall: Any) -> None:
        self.model = compiled(hall.spec(), STEP)
        self.batch = Batch(self.model, 1, 1, persistent=True)
        self.bodies = hall.drives(
            self.model, Runs(STEP, 1, [hall.settings], np.zeros(1, dtype=bool))
        )
        bind = self.batch.bind
        self.qpos, self.qvel, self.applied = bind("qpos"), bind("qvel"), bind("qfrc_applied")
        self.pushed = bind("xfrc_applied").reshape(1, -1, 6)
        self.centres = bind("xipos").reshape(1, -1, 3)
        self.observe = self.bodies.observing(self.qpos, self.qvel, 1e3, np.zeros(1, dtype=bool))

    def start(self, pose: Array, twist: Array) -> None:
        self.batch.reset(stage=0)
        self.bodies.settle(pose[None], twist[None], self.qpos, self.qvel)
        self.batch.forward()

    def run(self, time: float, push: Array | None = None) -> Array:
        """``(steps, 7)`` place of A in W; ``push`` (3,) [N] acts on the target at P and back on the
        chaser there.
        """
        out = []
        for _ in range(round(time / STEP)):
            self.observe()
            out.append(self.bodies.place_A[0].copy())
            if push is not None:
                self._pair(push)
            self.bodies.push(0, self.qpos, self.qvel, self.applied)
            self.batch.step()
        self.observe()
        return np.array(out)

    def momentum(self) -> Array:
        """``(6,)`` linear, and angular about W's origin, of all bodies, by MuJoCo."""
        data = mujoco.MjData(self.model)
        data.qpos[:], data.qvel[:] = self.qpos[0], self.qvel[0]
        mujoco.mj_forward(self.model, data)
        mujoco.mj_subtreeVel(self.model, data)
        linear = self.model.body_subtreemass[0] * data.subtree_linvel[0]
        spin = data.subtree_angmom[0] + np.cross(data.subtree_com[0], linear)
        return np.concatenate([linear, spin])

    def _pair(self, push: Array) -> None:
        at = self.bodies.place_P[0, :3]
        for name, sign in (("chaser", -1.0), ("target", 1.0)):
            body = self.model.body(name).id
            self.pushed[0, body, :3] = sign * push
            self.pushed[0, body, 3:] = sign * np.cross(at - self.centres[0, body], push)


def floor(**over: Any) -> Any:
    return facility("air_bearing", **(QUIET | over)).stand(CHASER, TARGET)


def cables(**over: Any) -> Any:
    return facility("suspension", **(SMOOTH | over)).stand(CHASER, TARGET)


PLUMB = np.array([0.0, 0.0, -0.60, 0.0, 0.0, 0.0, 1.0])  # the cables hang straight
# A is 0.60 m above the mount: 10 mm before P
MOUNT = np.array([0.0, 0.0, -0.61, 0.0, 0.0, 0.0, 1.0])


def test_momentum_is_kept_on_a_quiet_floor() -> None:
    """Linear momentum and moment of momentum about W's origin, while the ports push each other off
    the axis.
    """
    hall = Hall(floor())
    hall.start(MOUNT, np.array([0.01, 0.0, 0.05, 0.0, 0.02, 0.0]))
    before = hall.momentum()
    # the centre is 0.4 m behind the mount
    assert before[[0, 2]] == pytest.approx([560 * (0.01 - 0.02 * 0.4), 560 * 0.05], rel=1e-6)
    hall.run(2.0, np.array([3.0, 0.0, 40.0]))
    after = hall.momentum()
    assert abs(hall.qvel[0, 3:]).max() > 1e-3
    np.testing.assert_allclose(
        after[[0, 2, 4]], before[[0, 2, 4]], atol=5e-3 * np.abs(before).max()
    )


def period(way: Array) -> float:
    """Half a period from the first return through zero."""
    crossed = np.flatnonzero((way[1:-1] > 0.0) & (way[2:] <= 0.0))[0] + 1
    return (crossed + way[crossed] / (way[crossed] - way[crossed + 1])) * STEP


def test_the_film_slows_an_article_as_an_exponential() -> None:
    hall = Hall(floor(film_damping=30.0))
    hall.start(MOUNT, np.array([0.0, 0.0, 0.05, 0.0, 0.03, 0.0]))
    start = hall.qvel.copy()
    hall.run(4.0)
    kept, inertia = hall.qvel[0, 1:3] / start[0, 1:3], 180.0 + 0.5 * 60.0 * 0.6**2
    rates = 30.0 / np.array([560.0, inertia / 0.36])
    np.testing.assert_allclose(kept, np.exp(-4.0 * rates), rtol=5e-3)


def test_a_tilted_floor_pulls_with_its_share_of_gravity() -> None:
    hall, tilt, t = Hall(floor(tilt=[2e-4, 1e-4])), np.array([2e-4, 1e-4]), 3.0 - STEP
    hall.start(MOUNT, np.zeros(6))
    place = hall.run(3.0)[:, [0, 2]]
    np.testing.assert_allclose(place[-1] - place[0], 0.5 * GRAVITY * tilt * t**2, rtol=5e-3)


def test_a_hose_is_a_spring() -> None:
    hall = Hall(floor(hose_stiffness=200.0, target="fixed"))
    hall.start(MOUNT, np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0]))
    way = hall.run(6.0)[:, 2] - MOUNT[2]
    assert period(way) == pytest.approx(math.pi * math.sqrt(560.0 / 200.0), rel=5e-3)


@pytest.mark.parametrize("cable_mass", [0.0, 40.0])
def test_a_hung_article_swings_as_its_formula_says(cable_mass: float) -> None:
    """w^2 = (g/L) (1 + m_c/(2 m))/(1 + m_c/(3 m))."""
    hall = Hall(cables(cable_mass=cable_mass, length=4.0))
    hall.start(PLUMB, np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0]))
    ratio = cable_mass / (CHASER.mass + HOOK)
    half = math.pi / math.sqrt(GRAVITY / 4.0 * (1.0 + 0.5 * ratio) / (1.0 + ratio / 3.0))
    assert period(hall.run(1.1 * half)[:, 2] - PLUMB[2]) == pytest.approx(half, rel=5e-3)


def test_a_hung_article_keeps_its_attitude_and_height() -> None:
    """The gimbal at the centre of mass lets it turn freely; the winch holds the weight, so that a
    vertical push moves mass alone.
    """
    hall = Hall(cables(winch_mass=30.0, cable_mass=1e-6))
    hall.start(MOUNT, np.array([0.0, 0.0, 0.0, 0.01, 0.02, 0.03]))
    hall.observe()
    spin, size = hall.bodies.motion_A[0, 3:].copy(), np.linalg.norm
    hall.run(0.5)
    inertia = np.array([200.0, 180.0, 150.0])
    assert size(inertia * spin) == pytest.approx(size(inertia * [0.01, 0.02, 0.03]), rel=1e-6)
    assert size(hall.bodies.motion_A[0, 3:]) == pytest.approx(size(spin), rel=5e-3)
    hall.start(MOUNT, np.zeros(6))
    hall.applied[:] = 0.0
    hall.pushed[0, hall.model.body("chaser").id, 1] = 20.0
    hall.run(1.0)
    fast = 20.0 * 1.0 / (CHASER.mass + HOOK + 30.0)
    assert hall.bodies.motion_A[0, 1] == pytest.approx(fast, rel=5e-3)


def test_a_tension_that_is_off_drifts() -> None:
    hall = Hall(cables(tension_error=-0.002, cable_mass=1e-6))
    hall.start(MOUNT, np.zeros(6))
    hall.run(1.0)
    assert hall.bodies.motion_A[0, 1] == pytest.approx(-0.002 * GRAVITY * 1.0, rel=5e-3)


def test_an_unbalanced_gimbal_is_a_pendulum() -> None:
    """With the gimbal d above the centre: w^2 = m g d/(I + m d^2), the cable too long to swing with
    it.
    """
    offset = 0.02
    hall = Hall(cables(gimbal_offset=offset, length=200.0, target="fixed"))
    hall.start(MOUNT, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.002]))
    half = math.pi / math.sqrt(CHASER.mass * GRAVITY * offset / 150.0)
    out = hall.run(1.2 * half)
    assert period(2.0 * out[:, 5]) == pytest.approx(half, rel=5e-3)


def test_a_plane_has_three_motions() -> None:
    hall, off = Hall(floor()), MOUNT.copy()
    off[1] = 0.01
    with pytest.raises(InputError, match="do not go along y"):
        hall.start(off, np.zeros(6))
    with pytest.raises(InputError, match="do not move about x"):
        hall.start(MOUNT, np.array([0.0, 0.0, 0.03, 0.01, 0.0, 0.0]))
    assert floor().complaints(np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0])) == []
    assert "along y" in floor().complaints(np.array([0.0, 0.02, -0.1, 0.0, 0.0, 0.0, 1.0]))[0]
