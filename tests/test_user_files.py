"""The files of the user's that a scenario names: found beside it, kept with a run as they were, and
part of every hash.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.campaign.schema import load_campaign
from hiltestbed.campaign.store import Store, refuse_another
from hiltestbed.config.mjcf import packed
from hiltestbed.config.models import model_of, models_folder
from hiltestbed.config.part import compiled, named
from hiltestbed.errors import InputError
from hiltestbed.run_folder.store import write_run
from hiltestbed.scenario import load_scenario, scenario_sha256
from hiltestbed.simulation import simulate
from tests.running import run
from tests.slow import slow

MESH = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
PORT = '<site name="A" pos="0 0 0.1234567890123"/>'
PART = (
    '<body pos="0 0 0.03"><joint type="slide" axis="0 0 1" stiffness="12345.67890123"/>'
    '<geom name="ball" size="0.030000000123" mass="1.000000000123"/></body>'
)
SCENARIO = """name: mine
duration: 0.05
rate: 1000
spacecraft:
  chaser: {mass: 300.0, inertia: [60, 60, 60]}
  target: {mass: 900.0, inertia: [300, 300, 300]}
approach: {gap: 0.001, velocity: [0, 0, 0.08]}
rig: {platform: {tracking: ideal}}
mechanism:
  kind: mjcf
  active: parts/active.xml
  passive: parts/passive.xml
  pairs: [{active: ball, passive: wall, stiffness: 5.0e4}]
"""
RIG = "{kind: mjcf, model: rig.xml, tracking: ideal}"
CAMPAIGN = "scenario: mine.yaml\nvary: {approach.velocity.2: {values: [0.08, 0.09]}}\n"
# how the active side names its mesh: compiler, file in the MJCF, file below parts
WAYS = {
    "beside": ("", "tip.obj", "tip.obj"),
    "meshdir": ('<compiler meshdir="a/b"/>', "tip.obj", "a/b/tip.obj"),
    "assetdir": ('<compiler assetdir="a" texturedir="b"/>', "tip.obj", "a/tip.obj"),
    "subfolder": ('<compiler meshdir="a"/>', "b/tip.obj", "a/b/tip.obj"),
    "above": ("", "../tip.obj", "../tip.obj"),
    "absolute": ("", "{0}/parts/far/tip.obj", "far/tip.obj"),
    "stripped": ('<compiler strippath="true" meshdir="a"/>', "gone/tip.obj", "a/tip.obj"),
    "included": ("", "sub/tip.obj", "sub/tip.obj"),
}


def written(folder: Path, way: str = "beside") -> Path:
    """A scenario whose active side names a mesh in one of WAYS; beside it another of equal name."""
    compiler, given, place = WAYS[way]
    parts = folder / "parts"
    (parts / "other").mkdir(parents=True)
    (parts / place).parent.mkdir(parents=True, exist_ok=True)
    (parts / place).write_text(MESH.format(0.01))
    (parts / "other" / "tip.obj").write_text(MESH.format(0.02))
    asset = f'<asset><mesh file="{given.format(folder)}"/></asset>'
    if way == "included":
        (parts / "inc").mkdir()
        (parts / "inc" / "assets.xml").write_text(f"<mujocoinclude>{asset}</mujocoinclude>")
        asset = '<include file="inc/assets.xml"/>'
    other = f'<asset><mesh name="other" file="{parts}/other/tip.obj"/></asset>'
    tip = '<geom type="mesh" mesh="tip" contype="0"/>'
    if way == "stripped":  # then the other one cannot be named
        other = ""
    (parts / "active.xml").write_text(
        f"<mujoco>{compiler}{asset}{other}<worldbody>{tip}{PART}{PORT}</worldbody></mujoco>"
    )
    (parts / "passive.xml").write_text(
        '<mujoco><worldbody><geom name="wall" type="box" size=".2 .2 .01" pos="0 0 .01"/>'
        '<site name="P"/></worldbody></mujoco>'
    )
    table = (models_folder() / "xyz_table" / "xyz_table.xml").read_text()
    (folder / "rig.xml").write_text(table)
    (folder / "mine.yaml").write_text(SCENARIO)
    (folder / "campaign.yaml").write_text(CAMPAIGN + "design: {kind: grid}\n")
    return folder / "mine.yaml"


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("way", WAYS)
def test_a_run_folder_runs_again(tmp_path: Path, way: str) -> None:
    """The same trace and the same hash, wherever the folder is and whatever became of the files."""
    source = tmp_path / "source"
    first = run(load_scenario(written(source, way)))
    write_run(first, tmp_path / "run", rerun=False, report=False)
    source.rename(tmp_path / "gone")
    (tmp_path / "run").rename(tmp_path / "elsewhere")
    again = load_scenario(tmp_path / "elsewhere" / "scenario.yaml")
    assert scenario_sha256(again) == first.summary["scenario_sha256"]
    trace = simulate([again], trace=True).trace
    np.testing.assert_array_equal(trace.run(0)["wrench_true"], first.trace["wrench_true"])


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("parts/active.xml", "12345.67890123", "12345.67890124"),
        ("parts/inc/assets.xml", "file=", 'scale="2 2 2" file='),
        ("parts/sub/tip.obj", "0.01", "0.0100001"),
        ("parts/other/tip.obj", "0.02", "0.0200001"),
        ("rig.xml", "5.2e6", "2e5"),
    ],
)
def test_every_file_is_in_the_hashes(tmp_path: Path, file: str, old: str, new: str) -> None:
    """A scenario is another one after any edit, and a campaign is not continued after it."""
    path = written(tmp_path, "included")
    path.write_text(SCENARIO.replace("{tracking: ideal}", RIG))
    before = scenario_sha256(load_scenario(path))
    with Store.opened(tmp_path / "out", load_campaign(tmp_path / "campaign.yaml")):
        pass
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    assert scenario_sha256(load_scenario(path)) != before
    with pytest.raises(InputError, match=r"another content of \S+: \S+\.xml"):
        refuse_another(tmp_path / "out", load_campaign(tmp_path / "campaign.yaml"))
    kept = load_campaign(tmp_path / "out" / "campaign.yaml")
    assert scenario_sha256(kept.nominal) == before


def test_neither_a_comment_nor_a_place_is_part_of_a_model(tmp_path: Path) -> None:
    """Nor the folder of a mesh, if its content and name stay."""
    file = written(tmp_path, "subfolder").parent / "parts" / "active.xml"
    first, text = packed(file).sha256, file.read_text()
    file.write_text(text.replace("<worldbody>", "<!-- a comment --><worldbody>"))
    assert packed(file).sha256 == first
    (tmp_path / "parts" / "a" / "b").rename(tmp_path / "parts" / "c")
    file.write_text(text.replace('meshdir="a"', 'meshdir="c"').replace("b/tip", "tip"))
    assert packed(file).sha256 == first


COMPILERS = (
    'angle="radian" eulerseq="zyx"',
    'settotalmass="30"',
    'boundmass="5" boundinertia="0.3"',
    'inertiafromgeom="true"',
    'inertiagrouprange="1 2"',
    'autolimits="false" balanceinertia="true" fitaabb="true"',
    'fusestatic="true" discardvisual="true"',
)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_part_keeps_what_its_compiler_settings_mean(tmp_path: Path, compiler: str) -> None:
    import mujoco

    file = tmp_path / "part.xml"
    file.write_text(
        f'<mujoco><compiler {compiler}/><worldbody><body name="a" pos="0 0 1"><joint name="j" '
        'type="hinge" range="-0.4 0.5" limited="true"/><joint name="k" range="0 1" type="slide" '
        'limited="false"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom name="g" '
        'type="box" size=".1 .2 .3" euler="0.1 0.2 0.3" group="1"/><body name="b" '
        'euler="0.3 0.2 0.1"><geom name="h" size="0.1" group="2"/></body></body></worldbody></mujoco>'
    )
    own, spec = compiled(file), mujoco.MjSpec()
    carrier = spec.worldbody.add_body(name="carrier")
    spec.attach(named(file), prefix="p_", frame=carrier.add_frame(pos=[1.0, 0.0, 0.0]))
    whole = spec.compile()
    for name in ("a", "b"):
        for what in ("mass", "inertia", "ipos", "iquat", "quat"):
            here, there = getattr(own.body(name), what), getattr(whole.body(f"p_{name}"), what)
            np.testing.assert_allclose(there, here, rtol=1e-12, atol=1e-15)
    for name in ("j", "k"):
        np.testing.assert_array_equal(whole.joint(f"p_{name}").range, own.joint(name).range)
        assert whole.jnt_limited[whole.joint(f"p_{name}").id] == own.jnt_limited[own.joint(name).id]
    for name in ("g", "h"):
        np.testing.assert_allclose(whole.geom(f"p_{name}").quat, own.geom(name).quat, atol=1e-15)


WITHOUT_INERTIA = '<inertial pos="0 0 0" mass="1" diaginertia="nan 1 1"/>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<include file="pipe"/>', "no regular file"),
        ('<asset><mesh name="m" file="/dev/zero"/></asset>', "no regular file"),
        ('<include file="part.xml"/>', "included once"),
        ('<asset><mesh file="gone.obj"/></asset>', r"mesh .* 'gone.obj': no such file"),
        ("<worldbody><body></worldbody>", r"part.xml:1:\d+: .* no MJCF"),
        ('<worldbody><geom siz="1"/></worldbody>', "unrecognized attribute: 'siz'"),
        (
            '<worldbody><geom name="g" size="1" pos="nan 0 0"/></worldbody>',
            "pos of geom 'g' is .*nan",
        ),
        (f"<worldbody><body><joint/>{WITHOUT_INERTIA}</body></worldbody>", "inertia"),
        slow(
            '<worldbody><replicate count="100000000"><geom size="1"/></replicate></worldbody>',
            r"within \d+ s of processor time",
        ),
    ],
)
def test_a_strangers_model_is_refused_in_words(tmp_path: Path, text: str, said: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "part.xml").write_text(f"<mujoco>{text}</mujoco>")
    with pytest.raises(InputError, match=said):
        model_of(tmp_path / "part.xml")
