"""The plant: runs that do not know of each other, forces that are current, a platform that
follows.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.errors import InputError
from hiltestbed.platform.build import plant_of
from hiltestbed.platform.facilities.pss33 import MOVED_PER_DRIVE
from hiltestbed.platform.plant import Plant
from tests.platform.rigs import pose, scenario
from tests.running import shipped

OUTPUTS = ("pose_act", "twist_act", "wrench_sub", "slider_cmd", "slider_act", "contact")


def driven(plant: Plant, i: int, ticks: int = 60) -> list[np.ndarray]:
    """What run ``i`` of a plant gives when each run is pressed in at its own speed."""
    n = len(plant.pose_act)
    speed = 0.02 + 0.001 * np.arange(n)
    twist, start = np.zeros((n, 6)), pose(0.1, 0.0, -1e-4, n)
    twist[:, 2] = speed
    plant.reset(start, twist)
    out = []
    for k in range(ticks):
        goal = start.copy()
        goal[:, 2] += speed * (k + 1) / 2000.0
        plant.begin(goal, twist, np.zeros((n, 6)))
        out.append(np.concatenate([np.ravel(getattr(plant, name)[i]) for name in OUTPUTS]))
        plant.finish()
    return out


@pytest.mark.parametrize(("tracking", "friction"), [("ideal", 0.1), ("servo", 0.0)])
def test_a_run_alone_is_the_run_in_a_batch_bit_for_bit(tracking: str, friction: float) -> None:
    s = scenario(tracking, friction=friction)
    among = np.array(driven(plant_of([s] * 16, nthread=2), 0))
    alone = np.array(driven(plant_of([s]), 0))
    assert np.array_equal(alone, among)
    assert among[-1][:3].any()


@pytest.mark.parametrize(("friction", "substeps"), [(0.1, 1), (0.0, 5)])
def test_a_force_told_late_is_the_force_told_at_once(friction: float, substeps: int) -> None:
    """Told once the tick has begun, from its first step, it differs by what the drives' new push
    adds to MuJoCo's soft contact: 1e-4 of that push; and of the late and the prompt in one batch
    each is what it is alone.
    """
    s = scenario(friction=friction, physics_rate=2000.0 * substeps)

    def rows(late: list[bool], i: int) -> np.ndarray:
        return np.array(driven(plant_of([s] * 2, late=np.array(late)), i, 200))

    told, at_once = rows([True, True], 0), rows([False, False], 0)
    assert np.array_equal(told, rows([True, False], 0))
    assert np.array_equal(at_once, rows([False, True], 0))
    assert np.array_equal(rows([False, False], 1), rows([True, False], 1))
    # after pose and twist; before the first tick nothing was told
    forces = slice(13, 13 + 6 * substeps)
    assert np.abs(at_once[:, forces]).max() > 50.0
    assert np.abs(told - at_once)[1:, forces].max() < 2e-4 * np.abs(at_once[:, forces]).max()
    assert np.array_equal(np.delete(told, forces, axis=1), np.delete(at_once, forces, axis=1))


@pytest.mark.parametrize(("tracking", "substeps"), [("ideal", 5), ("servo", 2), ("servo", 1)])
def test_the_forces_belong_to_their_instants(tracking: str, substeps: int) -> None:
    """Pressed in at constant speed the force is k times the depth at a tick (one a physics step
    late would be k v dt less), and grows by k v dt from one sub-instant to the next, across ticks
    as within them.
    """
    s = scenario(tracking, physics_rate=2000.0 * substeps, damping=0.0)
    plant, v = plant_of([s]), 0.02
    twist = np.array([[0.0, 0.0, v, 0.0, 0.0, 0.0]])
    plant.reset(pose(z=-1e-3), twist)
    forces, depth = [], []
    for k in range(400):
        plant.advance(pose(z=-1e-3 + v * (k + 1) / s.rate), twist, np.zeros((1, 6)))
        forces.append(plant.wrench_sub[0, :, 2].copy())
        depth.append(plant.pose_act[0, 2])
    step, found = 1e5 * v / (2000.0 * substeps), np.concatenate(forces[-50:])
    np.testing.assert_allclose(found[1:] - found[:-1], step, rtol=1e-2)
    np.testing.assert_allclose(np.array(forces)[-50:, -1], 1e5 * np.array(depth[-50:]), atol=0.05)


def test_in_free_motion_the_platform_is_where_it_was_told_to_be() -> None:
    """Sine of 10 mm at 1 Hz on all axes: the drives' feed-forward carries the motion, position
    feedback next to nothing.
    """
    s = scenario()
    plant, h, w = plant_of([s]), 1.0 / s.rate, 2.0 * np.pi
    amplitude = np.array([0.01, 0.008, 0.006])
    worst = 0.0
    plant.reset(pose(z=-0.05), np.array([[*(amplitude * w), 0.0, 0.0, 0.0]]))
    for k in range(1, 1000):
        t = k * h
        goal = pose(z=-0.05)
        goal[0, :3] += amplitude * np.sin(w * t)
        twist, accel = np.zeros((1, 6)), np.zeros((1, 6))
        twist[0, :3] = amplitude * w * np.cos(w * (t - 0.5 * h))
        accel[0, :3] = -amplitude * w * w * np.sin(w * (t - 0.5 * h))
        plant.advance(goal, twist, accel)
        worst = max(worst, float(np.abs(plant.pose_act - goal).max()))
    assert worst < 2e-6


def test_a_run_that_diverges_is_named_and_leaves_the_others_alone() -> None:
    """A contact of 1e16 N/m is far past what steps of 0.25 ms can follow: 2/dt = sqrt(k/m) at 4e10
    N/m for 600 kg.
    """
    wild, calm = scenario(stiffness=1e16, damping=0.0), scenario()
    plant, alone = plant_of([calm, wild, calm]), plant_of([calm])
    twist = np.tile([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], (3, 1))
    plant.reset(pose(z=-1e-4, n=3), twist)
    alone.reset(pose(z=-1e-4), twist[:1])
    for k in range(200):
        goal = pose(z=-1e-4 + 0.02 * (k + 1) / 2000.0, n=3)
        plant.advance(goal, twist, np.zeros((3, 6)))
        alone.advance(goal[:1], twist[:1], np.zeros((1, 6)))
    assert plant.diverged.tolist() == [False, True, False]
    assert "moves at" in plant.divergence(1)
    assert np.isfinite(plant.pose_act).all()
    assert np.array_equal(plant.pose_act[0], alone.pose_act[0])
    assert np.array_equal(plant.wrench_sub[2], alone.wrench_sub[0])


def test_runs_of_two_structures_are_refused() -> None:
    with pytest.raises(InputError, match="one structure"):
        plant_of([scenario(), scenario("ideal")])


def test_what_the_servo_takes_from_a_rebound_is_its_drives_damping() -> None:
    """The platform yields by F/(Kp + Kv s), Kp = 3 kp and Kv = 3 kv along z: a series spring that
    takes out c = k^2 Kv/Kp^2 [N s/m].

    With ln e = -pi c/(2 sqrt(k mu)) that is -4.8e-4 for 1e5 N/m and 400 kg. Everything else in the
    servo costs less than a third of it.
    """
    s = scenario(damping=0.0)
    plant, h, mu = plant_of([s]), s.tick, 400.0
    position, twist, accel = (
        pose(z=-2e-3),
        np.array([[0.0, 0.0, 0.03, 0.0, 0.0, 0.0]]),
        np.zeros((1, 6)),
    )
    plant.reset(position, twist)
    for _ in range(700):
        accel[0, 2] = -plant.wrench_sub[0, -1, 2] / mu
        twist[0, 2] += h * accel[0, 2]
        position[0, 2] += h * twist[0, 2]
        plant.advance(position, twist, accel)
    w = 2.0 * np.pi * s.rig.platform.bandwidth
    kp, kv = MOVED_PER_DRIVE * w**2, 2.0 * s.rig.platform.damping_ratio * MOVED_PER_DRIVE * w
    taken = 1e5**2 * kv / (3.0 * kp**2)
    expected = -np.pi * taken / (2.0 * np.sqrt(1e5 * mu))
    assert np.log(-twist[0, 2] / 0.03) == pytest.approx(expected, abs=abs(expected) / 3.0)
    assert abs(expected) < 1e-3


@pytest.mark.parametrize(
    ("name", "kind"), [("15-ring-docking", "stewart"), ("16-probe-drogue", "pss33")]
)
def test_what_moves_on_a_side_rubs_the_same_on_whatever_carries_it(name: str, kind: str) -> None:
    """A joint's friction creeps by its inverse weight while it sticks: that of the mechanism, in
    which no limb of a platform counts.
    """
    found = []
    for platform in ({"kind": "pss33", "tracking": "ideal"}, {"kind": kind, "tracking": "servo"}):
        model = plant_of([shipped(name, {"rig.platform": platform})]).model
        moved = [b for b in range(model.nbody) if model.body_jntnum[b]]
        parts = [b for b in moved if model.body(b).name.startswith("active_")]
        dofs = np.flatnonzero(np.isin(model.dof_bodyid, parts))
        found.append((model.dof_invweight0[dofs], model.body_invweight0[parts]))
    for alone, carried in zip(*found, strict=True):
        np.testing.assert_allclose(carried, alone, rtol=1e-6)
        assert alone.size
        assert (alone > 0.0).all()
