"""A mechanism that nobody shipped: built here from boxes, a cylinder, a ball and a mesh, with a
plunger on a spring.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed import diagnose
from hiltestbed.build import runnable
from hiltestbed.campaign.sweep import sweep
from hiltestbed.diagnosis import investigate, paths
from hiltestbed.diagnosis.find import judge
from hiltestbed.diagnosis.verdict import Verdict
from hiltestbed.errors import InputError
from hiltestbed.measured import load_dataset
from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.simulation import simulate
from tests.diagnosis.recorded import dataset_of
from tests.slow import SLOW

pytestmark = pytest.mark.usefixtures("in_this_process")

ACTIVE = """<mujoco><worldbody>
  <geom type="cylinder" size="0.10 0.05" pos="0 0 0.05" contype="0" conaffinity="0"/>
  <geom name="bar" type="box" size="0.16 0.02 0.02" pos="0 0 0.14" contype="1" conaffinity="1"/>
  <body name="plunger" pos="0 0 0.30" gravcomp="1">
    <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
    <joint name="stroke" type="slide" axis="0 0 1" range="-0.1 0.05" limited="true" stiffness="{spring}" damping="400"/>
    <geom name="ball" type="sphere" size="0.03" contype="1" conaffinity="1"/>
    <site name="nose" pos="0 0 0"/>
  </body>
  <site name="A" pos="0 0 0.33"/>
</worldbody></mujoco>"""
PASSIVE = """<mujoco><asset><mesh name="dish" file="dish.obj"/></asset><worldbody>
  <geom name="dish" type="mesh" mesh="dish" contype="1" conaffinity="1"/>
  <geom name="stop_0" type="box" size="0.02 0.02 0.02" pos="0.15 0 -0.10" contype="1" conaffinity="1"/>
  <geom name="stop_1" type="box" size="0.02 0.02 0.02" pos="-0.15 0 -0.10" contype="1" conaffinity="1"/>
  <site name="P"/><site name="seat" pos="0 0 -0.03"/>
</worldbody></mujoco>"""
K = 5.0e4


def pyramid() -> str:
    """A four-sided funnel that opens downwards, 45 deg, concave: four walls with an outside 20 mm
    behind, its apex at the origin.
    """
    s, t = 0.2, 0.02
    inner = [(0, 0, 0), (s, s, -s), (-s, s, -s), (-s, -s, -s), (s, -s, -s)]
    outer = [(x, y, z + t) for x, y, z in inner]
    faces = []
    for k in range(4):
        a, b = 1 + k, 1 + (k + 1) % 4
        faces += [(0, b, a), (5, 5 + a, 5 + b), (a, b, 5 + b), (a, 5 + b, 5 + a)]
    lines = [f"v {x} {y} {z}" for x, y, z in inner + outer] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces
    ]
    return "\n".join(lines) + "\n"


SCENARIO = """name: mine
duration: 3.0
rate: 1000
spacecraft:
  chaser: {mass: 300.0, inertia: [60, 60, 60], port: {position: [0, 0, 0.8]}}
  target: {mass: 900.0, inertia: [300, 300, 300], port: {position: [0, 0, -0.8]}}
approach: {gap: 0.06, velocity: [0, 0, 0.08], offset: [0.03, 0.01]}
rig: {platform: {tracking: ideal}}
compensation: {force: {kind: none}}
mechanism:
  kind: mjcf
  active: parts/active.xml
  passive: parts/passive.xml
  pairs:
    - {active: ball, passive: dish, stiffness: 5.0e4, damping: 200.0, friction: 0.05}
    - {active: bar, passive: stop_*, stiffness: 1.0e5, damping: 400.0}
  capture:
    - name: soft
      when: {pairs: [[nose, seat]], within: 0.02, speed: 0.2}
      close: {kind: connect, active: nose, passive: seat, stiffness: 5.0e4, damping: 800.0}
      drop_contacts: [ball]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "active.xml").write_text(ACTIVE.format(spring=2000))
    (tmp_path / "parts" / "passive.xml").write_text(PASSIVE)
    (tmp_path / "parts" / "dish.obj").write_text(pyramid())
    (tmp_path / "mine.yaml").write_text(SCENARIO)
    return tmp_path


def mine(folder: Path, **more: object) -> Scenario:
    return runnable(load_scenario(folder / "mine.yaml", set=more))


def test_it_docks(folder: Path) -> None:
    run = simulate([mine(folder)], trace=True)
    assert not run.trouble
    assert run.outcomes[0]["outcome"] == "captured"
    assert run.outcomes[0]["phases"][0]["at"] < 2.5
    wrench = run.trace.run(0)["wrench_true"]
    assert np.abs(wrench[:, 2]).max() > 20.0


def test_a_ball_on_a_wall_of_the_mesh_is_pressed_along_its_normal(folder: Path) -> None:
    """45 deg: at a lateral place of 60 mm the force is k x along the wall's normal. The plunger
    stands still at the first instant.
    """
    plant = plant_of(
        [mine(folder, **{"mechanism.pairs.0.friction": 0.0, "mechanism.pairs.0.damping": 0.0})]
    )
    depth, r = 1e-3, 0.03
    wall = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)  # from the ball into the wall
    centre = np.array([0.06, 0.0, -0.06]) - (r - depth) * wall
    pose = np.array([[*centre[:2], centre[2] + r, 0.0, 0.0, 0.0, 1.0]])
    plant.reset(pose, np.zeros((1, 6)))
    np.testing.assert_allclose(plant.wrench_sub[0, -1, :3], K * depth * wall, atol=1e-3 * K * depth)


def test_each_class_of_pairs_has_its_own_stiffness_without_friction_too(folder: Path) -> None:
    """Two balls on a plane, 1 mm deep: 5e4 and 1e5 N/m."""
    ball = (
        '<geom name="{}" type="sphere" size="0.03" pos="{} 0 -0.03" contype="1" conaffinity="1"/>'
    )
    balls = ball.format("soft", 0.1) + ball.format("stiff", -0.1)
    active = f'<mujoco><worldbody>{balls}<site name="A"/></worldbody></mujoco>'
    plane = (
        '<geom name="plane" type="plane" size="1 1 1" quat="0 1 0 0" contype="1" conaffinity="1"/>'
    )
    passive = f'<mujoco><worldbody>{plane}<site name="P"/></worldbody></mujoco>'
    (folder / "parts" / "active.xml").write_text(active)
    (folder / "parts" / "passive.xml").write_text(passive)
    pairs = [
        {"active": "soft", "passive": "plane", "stiffness": K},
        {"active": "stiff", "passive": "plane", "stiffness": 2.0 * K},
    ]
    plant = plant_of([mine(folder, **{"mechanism.pairs": pairs, "mechanism.capture": []})])
    plant.reset(np.array([[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)))
    force = [0.0, 0.0, 3.0 * K * 1e-3, 0.0, 0.1 * K * 1e-3, 0.0]
    np.testing.assert_allclose(plant.wrench_sub[0, -1], force, rtol=1e-3, atol=1e-3)


def test_it_runs_in_a_campaign(folder: Path) -> None:
    """A stiffness of one of its pairs is varied like any key: each case is the run alone."""
    key = "mechanism.pairs.0.stiffness"
    (folder / "campaign.yaml").write_text(
        f"scenario: mine.yaml\nset: {{duration: 1.2}}\n"
        f"vary: {{{key}: {{values: [3.0e4, 6.0e4]}}}}\ndesign: {{kind: grid}}\n"
    )
    found = sweep(folder / "campaign.yaml", folder / "out").to_pandas().set_index(key)
    runs = [mine(folder, **{"duration": 1.2, key: k}) for k in found.index]
    peaks = [simulate([run]).figures[0].peak_force for run in runs]
    assert list(found["status"]) == ["completed"] * 2
    assert list(found["peak_force"]) == peaks
    assert peaks[0] != peaks[1]


def test_bad_files_are_refused(folder: Path) -> None:
    active, inertia = ACTIVE.format(spring=2000), 'mass="2" diaginertia="0.01 0.01 0.01"'
    massless = active.replace(f'<inertial pos="0 0 0" {inertia}/>', "")
    for text, said in (
        (active.replace('name="A"', 'name="B"'), "has no site 'A'"),
        (massless.replace('type="sphere"', 'type="sphere" mass="0"'), "plunger"),
        (active.replace('"ball"', '"bulb"'), "no geom is called 'ball'"),
        ("<mujoco><body>", "MJCF"),
    ):
        (folder / "parts" / "active.xml").write_text(text)
        with pytest.raises(InputError, match=said):
            mine(folder)
    (folder / "parts" / "active.xml").write_text(active)
    with pytest.raises(InputError, match="overlap at the start"):
        mine(folder, **{"approach.gap": 0.001, "approach.offset": [0.08, 0.0]})
    with pytest.raises(InputError, match="no such file"):
        mine(folder, **{"mechanism.active": "parts/nowhere.xml"})
    turned = "\n".join(
        line if line[0] == "v" else "f {0} {2} {1}".format(*line.split()[1:])
        for line in pyramid().strip().splitlines()
    )
    # MuJoCo remembers a mesh by its name for a second
    (folder / "parts" / "turned.obj").write_text(turned + "\n")
    (folder / "parts" / "passive.xml").write_text(PASSIVE.replace("dish.obj", "turned.obj"))
    with pytest.raises(InputError, match="point inwards"):
        mine(folder)


def recorded(folder: Path, *effects: dict[str, object], **believed: object) -> Path:
    """The dataset of two runs at two speeds, believed to be without effects."""
    noise = {"sensor.noise": 0.1, "sensor.torque_noise": 0.01, "duration": 0.4}
    told = {"approach.gap": 0.045, **believed}
    sets = [{"approach.velocity": [0, 0, speed], **told} for speed in (0.2, 0.16)]
    return dataset_of(folder, mine(folder), sets, effects, unknown=noise)


def verdict_on(dataset: Path) -> Verdict:
    """The verdict alone: what else a diagnosis tells takes replays of its own."""
    return judge(investigate.investigate(load_dataset(dataset))).verdict


@SLOW
@pytest.mark.parametrize("tracking", ["ideal", "servo"])
def test_what_departs_in_it_is_named(folder: Path, tracking: str) -> None:
    """The plunger's force hangs on how A moved before, which the diagnosis plays."""
    hidden = {"kind": "contact.stiffness", "factor": 1.3}
    found = diagnose(recorded(folder, hidden, **{"rig.platform.tracking": tracking})).finding
    assert found.verdict == "named"
    assert not found.not_judged
    (cause,) = found.causes
    assert cause.effect == "contact.stiffness"
    assert cause.parameters["factor"].estimate == pytest.approx(1.3, rel=0.005)


@SLOW
def test_where_nothing_departs_in_it_nothing_is_found(folder: Path) -> None:
    found = verdict_on(recorded(folder, **{"rig.platform.tracking": "servo"}))
    assert found.verdict == "no_discrepancy"
    assert not found.not_judged


def test_a_diagnosis_does_not_judge_what_hangs_on_motion_within_a_tick(folder: Path) -> None:
    """A platform that is given by its response follows a curve between two rows."""
    found = verdict_on(recorded(folder, **{"rig.platform.tracking": "response"}))
    assert found.verdict == "inconclusive"
    assert any("how A moves within a tick" in why for why in found.not_judged.values())


@SLOW
def test_where_copies_agree_on_too_little_contact_and_sensor_are_not_judged(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # more than there is, in place of a mechanism that does what it likes
    monkeypatch.setattr(paths, "MIN_COMPARED", 1.01)
    found = verdict_on(recorded(folder, **{"rig.platform.tracking": "servo"}))
    assert found.verdict == "inconclusive"
    assert any("the smallest difference decides" in why for why in found.not_judged.values())
