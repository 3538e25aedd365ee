"""A pair of geoms exerts K x at its true surface, or is refused with its name and the remedy; geoms
of one side touch each other where the file says so.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hiltestbed.build import runnable
from hiltestbed.config.check import look_at
from hiltestbed.contact.surfaces.surface import hollow
from hiltestbed.errors import InputError
from hiltestbed.platform.build import plant_of
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.simulation import simulate
from tests.contact.test_any_tree import SCENARIO, cup

pytestmark = pytest.mark.usefixtures("in_this_process")

TETRAHEDRON = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype=float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
BOX = 'type="box" size="0.03 0.03 0.03" pos="0 0 -0.03"'
TORUS = (
    '<extension><plugin plugin="mujoco.sdf.torus"><instance name="t"><config key="radius1" '
    'value="0.1"/><config key="radius2" value="0.03"/></instance></plugin></extension><asset><mesh '
    'name="t"><plugin instance="t"/></mesh></asset>'
)
CUP, RING = 'type="mesh" mesh="cup"', 'type="sdf" mesh="t" pos="0 0 0.5"'
PLUGIN = '<plugin instance="t"/>'
FIELD = (
    '<asset><hfield name="field" nrow="2" ncol="2" size="1 1 0.1 0.1" elevation="0 1 0 1"/></asset>'
)
BLOCK = (
    '<asset><mesh name="m" vertex="-1 -1 0 1 -1 0 1 1 0 -1 1 0 -1 -1 1 1 -1 1 1 1 1 -1 1 1" '
    'scale=".2 .2 .05"/></asset>'
)


def mechanism(folder: Path, active: str, passive: str, assets: str = "", more: str = "") -> Path:
    (folder / "cup.obj").write_text(cup())
    (folder / "active.xml").write_text(
        f'<mujoco><asset><mesh name="cup" file="cup.obj"/></asset><worldbody>{active}'
        f'<site name="A"/></worldbody>{more}</mujoco>'
    )
    (folder / "passive.xml").write_text(
        f'<mujoco>{assets}<asset><mesh name="cup" file="cup.obj"/></asset><worldbody>'
        f'<geom name="touching" {passive}>{PLUGIN if passive == RING else ""}</geom>'
        '<site name="P"/></worldbody></mujoco>'
    )
    (folder / "mine.yaml").write_text(SCENARIO.format(0.0))
    return folder / "mine.yaml"


@pytest.mark.parametrize(
    ("active", "passive"),
    [
        (BOX, CUP),
        ('type="cylinder" size="0.02 0.03" pos="0 0 -0.03"', CUP),
        ('type="ellipsoid" size="0.02 0.03 0.03" pos="0 0 -0.03"', CUP),
        ('type="mesh" mesh="cup" pos="0 0 -0.3"', BOX),
        ('type="sphere" size="0.03"', RING),
        ('type="box" size="0.03 0.03 0.03"', RING),
        ('type="box" size="0.03 0.03 0.03"', 'type="hfield" hfield="field" pos="0 0 0.5"'),
    ],
)
def test_a_pair_without_an_exact_contact_is_refused(
    tmp_path: Path, active: str, passive: str
) -> None:
    assets = {RING: TORUS, CUP: "", BOX: ""}.get(passive, FIELD)
    file = mechanism(tmp_path, f'<geom name="touching" {active}/>', passive, assets)
    with pytest.raises(InputError, match=r"pair touching - touching has no exact contact: .*; "):
        runnable(load_scenario(file))


def test_a_convex_mesh_meets_a_box_at_its_surface(tmp_path: Path) -> None:
    """50 N at half a millimetre of 1e5 N/m; with 10 mm between them, nothing."""
    file = mechanism(tmp_path, f'<geom name="touching" {BOX}/>', 'type="mesh" mesh="m"', BLOCK)
    scenario = load_scenario(file, {"mechanism.pairs.0.damping": 0.0})
    assert forced(scenario, 5e-4) == pytest.approx(50.0, rel=1e-3)
    assert forced(scenario, -0.01) == 0.0


def forced(scenario: Scenario, depth: float) -> float:
    """Force along z [N] with A ``depth`` [m] beyond P."""
    plant = plant_of([scenario])
    plant.reset(np.array([[0.0, 0.0, depth, 0.0, 0.0, 0.0, 1.0]]), np.zeros((1, 6)))
    return float(plant.wrench_sub[0, -1, 2])


def test_how_far_a_mesh_is_inside_its_hull() -> None:
    """A face of a tetrahedron drawn inwards by 10 mm, its three parts' centres by a third of it."""
    assert hollow(TETRAHEDRON, FACES) is None
    centre = TETRAHEDRON[[1, 2, 3]].mean(axis=0)
    inwards = -np.ones(3) / np.sqrt(3.0)
    dented = np.vstack([TETRAHEDRON, centre + 0.01 * inwards])
    faces = np.vstack([FACES[[0, 1, 3]], [[1, 2, 4], [2, 3, 4], [3, 1, 4]]])
    assert hollow(dented, faces) == pytest.approx(0.01 / 3.0, rel=1e-3)
    assert hollow(TETRAHEDRON, FACES[:3]) == np.inf  # open


PLUNGER = (
    '<geom name="stop" type="box" size=".05 .05 .01" pos="0 0 -0.20"/><body name="plunger" '
    'pos="0 0 -.03" gravcomp="1"><joint name="s" type="slide" axis="0 0 1" damping="20"/><geom '
    'name="touching" type="sphere" size=".03" mass="1"/><geom name="foot" type="box" '
    'size=".02 .02 .05" pos="0 0 -.10" mass="1"/></body>'
)


def test_geoms_of_one_side_touch_where_the_file_has_a_pair(tmp_path: Path) -> None:
    """The foot is 10 mm from the stop: a free plunger takes no force, one that is stopped does."""
    wall = 'type="box" size=".2 .2 .05" pos="0 0 .05"'
    file = mechanism(tmp_path, PLUNGER, wall)
    changes = {"duration": 0.8, "mechanism.pairs.0.damping": 0.0, "approach.velocity.0": 0.0}
    assert any("stop - foot" in remark for remark in look_at(file).remarks)
    free = simulate([load_scenario(file, changes)]).figures[0].peak_force
    pair = '<contact><pair geom1="stop" geom2="foot" solref="0.01 1"/></contact>'
    mechanism(tmp_path, PLUNGER, wall, more=pair)
    assert not any("stop - foot" in remark for remark in look_at(file).remarks)
    stopped = simulate([load_scenario(file, changes)]).figures[0].peak_force
    assert stopped > 2.0 * free
