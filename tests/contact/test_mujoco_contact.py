"""What contacts in MuJoCo's batches do when they are told stiffness, damping, friction and place
before each step.

A ball against a facet that is re-posed to the tangent plane of the shipped cone, and a weld as a
latch, each between a passive body that is fixed behind a force sensor and an active body that is
prescribed (immovable, its state written) or free.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from mujoco.batch import Batch
from scipy.spatial.transform import Rotation

from hiltestbed.contact.surfaces import of_mesh, signed_distance
from tests.contact.surfaces.accuracy import turned_cone

K, C, MU = 5e4, 400.0, 0.1
IMPEDANCE = 1e-4
SOLIMP = f"{IMPEDANCE} {IMPEDANCE} .001 .5 1"
BALL, THICK = 0.03, 0.01
CREEP = 1e-4  # [m/s]
HEAD = (
    '<option timestep="2.5e-4" gravity="0 0 0" cone="elliptic" impratio="1"><flag '
    'island="disable" autoreset="disable"/></option>'
)
IMMOVABLE = 'mass="1e15" diaginertia="1e15 1e15 1e15"'
FREE = 'mass="200" diaginertia="9 7 10"'
SENSORS = '<force site="nominal"/><torque site="nominal"/>'


def facet_model(prescribed: bool) -> mujoco.MjModel:
    return _model(
        f"""<mujoco>{HEAD}<worldbody>
        <body name="carrier"><site name="nominal"/><body name="passive"><inertial pos="0 0 .3" mass="120" diaginertia="8 8 10"/>
          <geom name="facet" type="box" size=".2 .2 {THICK}" pos="0 0 1" quat=".9 .1 .2 .3" contype="0" conaffinity="0" mass="0"/>
        </body></body>
        <body name="active"><freejoint/><inertial pos="0 0 -.03" {IMMOVABLE if prescribed else FREE}/>
          <geom name="tip" type="sphere" size="{BALL}" pos="0 0 -.03" contype="0" conaffinity="0" mass="0"/></body></worldbody>
        <contact><pair geom1="tip" geom2="facet" condim="3" solimp="{SOLIMP}" friction="1 1 .005 .0001 .0001"/></contact>
        <sensor>{SENSORS}</sensor></mujoco>""",
        prescribed,
    )


def _model(xml: str, prescribed: bool) -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_string(xml)
    if prescribed:
        model.body_invweight0[model.body("active").id] = 1.0
    return model


def towards(normal: np.ndarray) -> np.ndarray:
    """Quaternion (4,), w-first, that turns z to the ``normal``."""
    axis = np.cross([0.0, 0.0, 1.0], normal)
    q = np.array([1.0 + normal[2], *axis])
    return q / np.linalg.norm(q) if np.linalg.norm(q) > 1e-9 else np.array([0.0, 1.0, 0.0, 0.0])


def facet_errors(
    prescribed: bool, slip: float, damping: float, count: int = 40
) -> tuple[float, float, float]:
    """Worst error of the sensed force along the normal, across it, and of the torque about P, each
    part of the normal force.
    """
    model = facet_model(prescribed)
    batch = Batch(model, 1, 1, persistent=True)
    weight = model.body_invweight0[:, 0]
    a = weight[model.body("active").id] + weight[model.body("passive").id]
    place, turn = batch.expand("geom_pos")[0], batch.expand("geom_quat")[0]
    solref, tangential = (
        batch.expand("pair_solref")[0, 0],
        batch.expand("pair_solreffriction")[0, 0],
    )
    qpos, qvel, reading = batch.bind("qpos")[0], batch.bind("qvel")[0], batch.bind("sensordata")[0]
    facet, scale = model.geom("facet").id, 1.0 - IMPEDANCE
    surface, _ = of_mesh(*turned_cone(96))
    rng, n, worst = np.random.default_rng(0), np.zeros(3), np.zeros(3)
    for _ in range(count):
        azimuth, along, depth = (
            rng.uniform(0.0, 2.0 * math.pi),
            rng.uniform(0.01, 0.17),
            rng.uniform(1e-4, 5e-3),
        )
        off = 0.035 - (BALL - depth)
        rho, z = math.sqrt(0.5) * (off + along), math.sqrt(0.5) * (off - along) - 0.035
        centre = np.array([rho * math.cos(azimuth), rho * math.sin(azimuth), z])
        d = signed_distance(surface, centre, 1.0, n)
        place[facet], turn[facet] = centre - (d + THICK) * n, towards(n)
        across = np.cross(n, rng.normal(size=3))
        across *= slip / np.linalg.norm(across)
        rate = rng.uniform(0.0, 0.03)
        x, point = BALL - d, centre - n * (BALL - 0.5 * (BALL - d))
        qpos[:3], qpos[3:], qvel[:3], qvel[3:] = (
            centre + np.array([0.0, 0.0, BALL]),
            (1.0, 0.0, 0.0, 0.0),
            across - rate * n,
            0.0,
        )
        push = K * x + damping * rate
        secant = MU * push / math.hypot(slip, CREEP)
        solref[:] = -K * a * scale, min(-damping * a * scale, -1e-12)
        tangential[:] = -1e-9 * a, -secant * a * scale
        batch.step()
        sensed, wanted = -reading, -push * n + secant * across
        error = sensed[:3] - wanted
        normal_error, torque_error = (
            abs(error @ n),
            np.linalg.norm(sensed[3:] - np.cross(point, wanted)),
        )
        worst = np.maximum(
            worst,
            np.array([normal_error, np.linalg.norm(error - (error @ n) * n), torque_error]) / push,
        )
    return float(worst[0]), float(worst[1]), float(worst[2])


@pytest.mark.parametrize("damping", [0.0, C])
@pytest.mark.parametrize("slip", [1e-6, 1e-4, 1e-2, 0.1])
def test_prescribed_ball_on_a_moving_facet_feels_the_law_exactly(
    slip: float, damping: float
) -> None:
    """Normal force, friction and the sensor's torque, from the static passive body that the facet
    belongs to.
    """
    assert max(facet_errors(True, slip, damping)) < 1e-7


@pytest.mark.parametrize("slip", [1e-6, 1e-4, 1e-2, 0.1])
def test_free_ball_on_a_moving_facet_feels_it_to_the_impedance(slip: float) -> None:
    """A free body yields within the step: the force is lower by d times its acceleration's share,
    1e-4 of it for each direction.
    """
    along, across, torque = facet_errors(False, slip, C)
    assert max(along, torque) < 2.0 * IMPEDANCE
    assert across < 2.0 * IMPEDANCE * MU


def latch_errors(prescribed: bool, radius: float) -> tuple[float, float]:
    """Worst error of force and torque of a weld, part of the largest force and of what it would be
    with the radius as lever.
    """
    model = _model(
        f"""<mujoco>{HEAD}<worldbody>
        <body name="carrier"><site name="nominal"/>
          <body name="passive"><inertial pos="0 0 .3" mass="120" diaginertia="8 8 10"/></body></body>
        <body name="active"><freejoint/><inertial pos=".02 0 -.44" {IMMOVABLE if prescribed else FREE}/></body></worldbody>
        <equality><weld body1="passive" body2="active" active="false" solimp="{SOLIMP}"/></equality>
        <sensor>{SENSORS}</sensor></mujoco>""",
        prescribed,
    )
    batch = Batch(model, 2, 1)
    a, b = model.body_invweight0[[model.body("active").id, model.body("passive").id]].sum(axis=0)
    scale = 1.0 - IMPEDANCE
    batch.expand("eq_solref")[:, 0] = -K * a * scale, -C * a * scale
    data, active = batch.expand("eq_data"), batch.bind("eq_active")
    qpos, qvel, reading = batch.bind("qpos"), batch.bind("qvel"), batch.bind("sensordata")
    rng, force_error, torque_error = np.random.default_rng(0), 0.0, 0.0
    for _ in range(30):
        hold, attitude = rng.normal(size=3) * 0.05, Rotation.from_rotvec(rng.normal(size=3) * 0.1)
        shift, turn, v, w = (rng.normal(size=3) * s for s in (1e-3, 1e-3, 0.01, 0.02))
        data[:, 0, 0:3], data[:, 0, 3:6] = 0.0, hold
        data[:, 0, 6:10], data[:, 0, 10] = (
            attitude.as_quat(scalar_first=True),
            2.0 * radius * math.sqrt(b / a),
        )
        now = Rotation.from_rotvec(turn) * attitude
        qpos[:, :3], qpos[:, 3:], qvel[:, :3], qvel[:, 3:] = (
            hold + shift,
            now.as_quat(scalar_first=True),
            v,
            now.inv().apply(w),
        )
        active[:, 0] = 1.0, 0.0
        batch.step()
        force = K * shift + C * v
        torque = radius**2 * (K * turn + C * w) + np.cross(hold, force)
        assert not reading[1].any()
        force_error = max(
            force_error, float(np.abs(-reading[0, :3] - force).max()) / float(np.linalg.norm(force))
        )
        torque_error = max(
            torque_error,
            float(np.abs(-reading[0, 3:] - torque).max()) / float(np.linalg.norm(force) * radius),
        )
    return force_error, torque_error


def test_a_weld_is_a_spring_and_a_damper_in_six_axes() -> None:
    """Torque k r^2 a from torquescale 2 r sqrt(B/A), A and B the inverse weights of translation and
    rotation; k r^2 sin a in truth.
    """
    force, torque = latch_errors(prescribed=True, radius=0.15)
    assert force < 1e-7
    assert torque < 1e-5
    force, torque = latch_errors(prescribed=False, radius=0.15)
    # inverse weight at the latch, 0.44 m from the centre of mass, over that of the body
    yielding = 1.0 + 200.0 * 0.44**2 / 7.0
    assert force < yielding * IMPEDANCE
    assert torque < yielding * IMPEDANCE


@pytest.mark.parametrize("stage", ["POS", "VEL", "ACC"])
@pytest.mark.parametrize("persistent", [False, True])
def test_the_number_of_contacts_is_known_in_time_to_share_the_stiffness(
    stage: str, persistent: bool
) -> None:
    """A lying rod falls on a box: two contacts from one instant on. A contact sensor of `found`
    alone is as new as the positions.
    """
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>{HEAD}<worldbody><geom name="box" type="box" size=".5 .5 .1" pos="0 0 -.1" contype="0"/>
        <body name="rod"><freejoint/>
          <geom name="rod" type="capsule" size=".05 .2" euler="0 90 0" pos="0 0 .05" mass="100" contype="0"/></body>
        </worldbody><contact><pair geom1="rod" geom2="box" condim="1" solimp="{SOLIMP}"/></contact>
        <sensor><contact geom1="rod" geom2="box" data="found" num="1"/></sensor></mujoco>"""
    )
    batch = Batch(model, 1, 1, persistent)
    batch.reset(stage=0)
    a = model.body_invweight0[model.body("rod").id, 0]
    solref, qpos, qvel, found = (
        batch.expand("pair_solref")[0, 0],
        batch.bind("qpos")[0],
        batch.bind("qvel")[0],
        batch.bind("sensordata")[0],
    )
    solref[:] = -K * a, -1e-12
    qpos[2], qvel[2] = 1e-5, -1.0
    batch.step(stage=int(getattr(mujoco.mjtStage, f"mjSTAGE_{stage}")))
    assert found[0] == 2
    solref[0] = -K * a / found[0]
    before, depth = qvel[2], -qpos[2]
    batch.step()
    assert (qvel[2] - before) / model.opt.timestep * 100.0 == pytest.approx(K * depth, rel=2e-4)


if __name__ == "__main__":
    print(
        "| body | C [N s/m] | slip [m/s] | along | across | torque [m] |\n|---|---|---|---|---|---|"
    )
    for prescribed in (True, False):
        for damping in (0.0, C):
            for slip in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1):
                along, across, torque = facet_errors(prescribed, slip, damping)
                print(
                    f"| {'prescribed' if prescribed else 'free'} | {damping:g} | {slip:g} | "
                    f"{along:.1e} | {across:.1e} | {torque:.1e} |"
                )
