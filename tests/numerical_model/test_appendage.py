"""A part of a body that hangs on a spring at a place of its own: momentum, frequency, and MuJoCo as
another integrator.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed import load_scenario
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.numerical_model.bodies import inertia_matrix, rest_inertia
from hiltestbed.numerical_model.kernels import CHASER, TARGET
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.scenario import Scenario, scenario_from
from tests.physics.closed_forms import pair_momentum

SCENARIO = "05-off-centre"
PANEL: dict[str, Any] = {
    "kind": "dynamics.appendage",
    "mass_ratio": 0.1,
    "frequency": 0.8,
    "damping_ratio": 0.03,
    "body": "chaser",
}
PLACE = [0.4, -0.2, 0.1]
WRENCH = np.array([20.0, -10.0, 100.0, 3.0, 2.0, -4.0])


def with_panel(rate: int = 2000, **changes: Any) -> Scenario:
    panel = PANEL | {"place": PLACE} | changes
    return load_scenario(SCENARIO, set={"rate": rate, "physics_rate": rate, "effects": [panel]})


def point(mass: float, at: Any) -> Array:
    """(3, 3) inertia about the origin of a mass at a place."""
    at = np.asarray(at)
    return np.asarray(mass * (at @ at * np.eye(3) - np.outer(at, at)))


def momentum(model: NumericalModel, ratio: float) -> Array:
    """(6,) of both bodies and the chaser's panel about the inertial origin."""
    place, velocity = model._swing[0, CHASER, 0]
    mass = model.mass[0] * np.array([1.0 - ratio, 1.0])
    linear = ratio * model.mass[0, CHASER] * velocity
    return pair_momentum(mass, model._inertia[0], model.q[0], model.v[0]) + np.concatenate(
        [linear, np.cross(place, linear)]
    )


@pytest.mark.parametrize("damping_ratio", [0.0, 0.03, 0.5])
def test_momentum_of_the_whole_is_kept(damping_ratio: float) -> None:
    """A push of half a second and its swing thereafter: linear and angular momentum to 1e-12 and
    1e-9 of their scale.

    The rest of the chaser and the target are balls here: the step of a body's spin keeps its
    angular momentum only then.
    """
    scenario = with_panel(damping_ratio=damping_ratio)
    ball = 150.0 * np.eye(3)
    whole = (
        ball + ball - rest_inertia(scenario.spacecraft.chaser.mass, ball, [0.1], np.array([PLACE]))
    )
    six = whole[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    data = scenario.model_dump(mode="json")
    data["spacecraft"]["chaser"]["inertia"] = six.tolist()
    data["spacecraft"]["target"]["inertia"] = [900.0] * 3
    model = NumericalModel([scenario_from(data)])
    before = momentum(model, 0.1)
    for k in range(8000):
        model.advance((WRENCH if k < 1000 else 0.0 * WRENCH)[None])
    after = momentum(model, 0.1)
    speed = np.linalg.norm(model.v[0, CHASER, :3])
    assert np.abs(after - before)[:3].max() < 1e-12 * model.mass[0, CHASER] * speed
    assert np.abs(after - before)[3:].max() < 1e-9 * model.mass[0, CHASER] * speed


def test_it_is_at_rest_what_is_believed_of_the_whole_body() -> None:
    """Rest and panel at its place: mass, centre and inertia of the scenario's chaser."""
    scenario = with_panel()
    model = NumericalModel([scenario])
    body, ratio = scenario.spacecraft.chaser, 0.1
    turn = Rotation.from_quat(model.q[0, CHASER, 3:7])
    rest = turn.inv().apply(model.q[0, CHASER, :3] - model.centres()[0, CHASER, :3])
    panel = turn.inv().apply(model._swing[0, CHASER, 0, 0] - model.centres()[0, CHASER, :3])
    np.testing.assert_allclose(panel, PLACE, atol=1e-12)
    np.testing.assert_allclose((1.0 - ratio) * rest + ratio * panel, 0.0, atol=1e-12)
    whole = model._inertia[0, CHASER] + point((1.0 - ratio) * body.mass, rest)
    whole += point(ratio * body.mass, panel)
    np.testing.assert_allclose(whole, inertia_matrix(body.inertia), atol=1e-9)


def test_the_frequency_is_that_with_the_body_held() -> None:
    """A body a million times heavier is held; the panel rings at 0.8 Hz after a jerk."""
    model = NumericalModel([with_panel(rate=4000, mass_ratio=1e-6, damping_ratio=0.0)])
    away = np.empty(8000)
    for k in range(len(away)):
        model.advance((1e3 * WRENCH if k == 0 else 0.0 * WRENCH)[None])
        turn = Rotation.from_quat(model.q[0, CHASER, 3:7])
        away[k] = (
            model._swing[0, CHASER, 0, 0] - model.centres()[0, CHASER, :3] - turn.apply(PLACE)
        )[2]
    crossings = np.flatnonzero(np.diff(np.sign(away)) != 0)
    crossings = crossings + away[crossings] / (away[crossings] - away[crossings + 1])
    half_period = np.diff(crossings).mean() / 4000.0
    assert 0.5 / half_period == pytest.approx(0.8, rel=2e-4)


def in_mujoco(scenario: Scenario, duration: float) -> tuple[Array, Array]:
    """(2, 3), (2, 4) of both bodies' centres at the end: free bodies, the panel on three slides."""
    model = NumericalModel([scenario])
    ratio, bodies = PANEL["mass_ratio"], (scenario.spacecraft.chaser, scenario.spacecraft.target)
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    spec.option.timestep = 1e-3
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    for b, name in ((CHASER, "chaser"), (TARGET, "target")):
        body = spec.worldbody.add_body(name=name)
        body.add_freejoint(name=name)
        rest = -ratio * np.array(PLACE) / (1.0 - ratio) if b == CHASER else np.zeros(3)
        body.explicitinertial = True
        body.mass = bodies[b].mass * ((1.0 - ratio) if b == CHASER else 1.0)
        body.ipos = rest
        whole = inertia_matrix(bodies[b].inertia)
        if b == CHASER:
            whole = whole - point(body.mass, rest) - point(ratio * bodies[b].mass, PLACE)
        body.fullinertia = whole[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    panel = spec.body("chaser").add_body(name="panel", pos=PLACE)
    mass, w = ratio * bodies[CHASER].mass, 2.0 * math.pi * PANEL["frequency"]
    panel.explicitinertial = True
    panel.mass = mass
    panel.ipos = np.zeros(3)
    panel.inertia = np.full(3, 1e-9)
    for axis in np.eye(3):
        joint = panel.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        joint.stiffness[0], joint.damping[0] = mass * w * w, 2.0 * PANEL["damping_ratio"] * mass * w
    m = spec.compile()
    d = mujoco.MjData(m)
    start = model.centres()[0]
    for b, name in ((CHASER, "chaser"), (TARGET, "target")):
        q, v = m.joint(name).qposadr[0], m.joint(name).dofadr[0]
        d.qpos[q : q + 3], d.qpos[q + 3 : q + 7] = start[b, :3], start[b, [6, 3, 4, 5]]
        turn = Rotation.from_quat(start[b, 3:7])
        spin = turn.apply(model.v[0, b, 3:6])
        d.qvel[v : v + 3] = model.v[0, b, :3] + np.cross(spin, start[b, :3] - model.q[0, b, :3])
        d.qvel[v + 3 : v + 6] = model.v[0, b, 3:6]
    port = bodies[TARGET].port

    def push(m: mujoco.MjModel, d: mujoco.MjData) -> None:
        turn = Rotation.from_matrix(d.body("target").xmat.reshape(3, 3))
        frame = turn * Rotation.from_euler("xyz", port.attitude_deg, degrees=True)
        force, torque = frame.apply(WRENCH[:3]), frame.apply(WRENCH[3:])
        point = d.body("target").xpos + turn.apply(port.position)
        d.qfrc_applied[:] = 0.0
        for name, sign in (("chaser", -1.0), ("target", 1.0)):
            mujoco.mj_applyFT(
                m, d, sign * force, sign * torque, point, m.body(name).id, d.qfrc_applied
            )

    mujoco.set_mjcb_control(push)
    try:
        for _ in range(round(duration / 1e-3)):
            mujoco.mj_step(m, d)
        mujoco.mj_forward(m, d)
    finally:
        mujoco.set_mjcb_control(None)
    places = np.array([d.body(name).xpos for name in ("chaser", "target")])
    return places, np.array([d.body(name).xquat[[1, 2, 3, 0]] for name in ("chaser", "target")])


def test_the_step_converges_to_another_integrator_in_first_order() -> None:
    """Two bodies and the panel in MuJoCo, fourth order, a constant wrench: half the tick, half the
    error; and a panel that turns.
    """
    places, attitudes = in_mujoco(with_panel(), 1.5)
    errors, turned = [], []
    for rate in (1000, 2000, 4000):
        model = NumericalModel([with_panel(rate)])
        for _ in range(round(1.5 * rate)):
            model.advance(WRENCH[None])
        centres = model.centres()[0]
        turn = Rotation.from_quat(attitudes[CHASER]).inv() * Rotation.from_quat(
            centres[CHASER, 3:7]
        )
        errors.append(np.abs(centres[:, :3] - places).max())
        turned.append(np.abs(turn.as_rotvec()).max())
    for kind in (errors, turned):
        assert kind[0] / kind[1] == pytest.approx(2.0, abs=0.1)
        assert kind[1] / kind[2] == pytest.approx(2.0, abs=0.1)
    assert 2.0 * errors[2] < 2e-4
    still = NumericalModel([with_panel(4000, place=[0.0, 0.0, 0.0])])
    for _ in range(6000):
        still.advance(WRENCH[None])
    apart = Rotation.from_quat(attitudes[CHASER]).inv() * Rotation.from_quat(
        still.q[0, CHASER, 3:7]
    )
    assert np.abs(apart.as_rotvec()).max() > 30.0 * turned[2]


def test_a_place_that_takes_more_inertia_than_there_is_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"takes more inertia than the chaser has: 50 kg at \[0\.0, 0\.0, 3\.0\] m"
    ):
        with_panel(place=[0.0, 0.0, 3.0])
