"""The user's own rig: what is taken from the file, and what is refused with which words."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from hiltestbed.config.models import models_folder
from hiltestbed.errors import InputError
from hiltestbed.platform.facilities.facility import MOUNT_HOME, compiled
from hiltestbed.platform.facilities.stand import Stand
from tests.platform.halls import TABLE, UPRIGHT, apart, facility

# the shipped table, hung over its work
HUNG = (models_folder() / TABLE).read_text().replace("0.085", '0.085" quat="0 1 0 0')
B_DRIVE = '<position name="drive_b" joint="b" kp="2.4e5" kv="2.1e3" forcerange="-6e3 6e3"/>'
B_JOINT = '<joint name="b" axis="0 1 0" range="-0.5 0.5"/>'


@pytest.fixture
def rig(tmp_path):
    def write(text: str) -> Any:
        path = tmp_path / "rig.xml"
        path.write_text(text)
        return facility("mjcf", model=str(path))

    return write


def test_the_rig_is_turned_so_that_its_mount_looks_along_the_insertion(rig) -> None:
    facility = rig(HUNG)
    m = compiled(facility.spec())
    np.testing.assert_allclose(m.opt.gravity, [0.0, 0.0, 9.81], atol=1e-9)
    assert [axis.joint for axis in facility.axes] == [f"rig/{name}" for name in "xyzcba"]
    assert facility.axes[2].low == -0.4
    assert facility.complaints(UPRIGHT) == []


def test_a_keyframe_home_is_home(rig) -> None:
    key = '<keyframe><key name="home" qpos="0.3 -0.2 0.1 0.2 0 0"/></keyframe></mujoco>'
    facility = rig(HUNG.replace("</mujoco>", key))
    kinematics = facility.kinematics(compiled(facility.spec()))
    np.testing.assert_allclose(kinematics.joints_home, [0.3, -0.2, 0.1, 0.2, 0.0, 0.0])
    assert max(apart(kinematics.home_poses[0], MOUNT_HOME)) < 1e-9


def test_a_site_passive_is_where_the_passive_port_stands(rig) -> None:
    ground = '<site name="passive" pos="0.05 0 0.935" quat="0 1 0 0"/><body name="slide_x"'
    facility = rig(HUNG.replace('<body name="slide_x"', ground))
    m = compiled(facility.spec())
    data_home = facility.kinematics(m).home_poses[0]
    np.testing.assert_allclose(data_home[:3], [-0.05, 0.0, -0.60], atol=1e-9)
    assert m.body("passive_carrier").parentid[0] == 0


def test_joints_of_the_mechanisms_are_not_the_rigs(rig) -> None:
    """A compliant mount on the passive side, and a loose part of the user's own beside the rig,
    leave the kinematics alone.
    """
    loose = (
        '<body name="lamp" pos="2 0 0"><joint axis="1 0 0"/><inertial pos="0 0 -1" '
        'mass="1" diaginertia="0.1 0.1 0.1"/></body>'
    )
    facility = rig(HUNG.replace("</worldbody>", loose + "</worldbody>"))
    spec = facility.spec()
    body = spec.body("passive_carrier").add_body(
        name="passive_mechanism", mass=50.0, inertia=[1.0, 1.0, 1.0]
    )
    for k, axis in enumerate("xyz"):
        body.add_joint(
            name=f"mount_{axis}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)[k], stiffness=1e5
        )
    kinematics = facility.kinematics(compiled(spec))
    assert kinematics.complaints(kinematics.home_poses) == []
    assert not set(kinematics.tree.unknown) & {
        int(compiled(spec).joint(f"mount_{axis}").dofadr[0]) for axis in "xyz"
    }


def test_meshes_are_found_beside_the_file(rig, tmp_path) -> None:
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "part.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    text = HUNG.replace(
        'autolimits="true"/>',
        'autolimits="true" meshdir="shapes"/><asset><mesh name="part" file="part.obj"/></asset>',
    )
    facility = rig(
        text.replace('<site name="mount"', '<geom type="mesh" mesh="part"/><site name="mount"')
    )
    assert facility.spec().compile().nmesh == 1


def test_parallel_rigs_work_as_well(rig) -> None:
    """The shipped 3-3 PSS platform with position servos in place of its motors, loops and all,
    tracks within a servo's lag.
    """
    motors = (models_folder() / "pss33" / "pss33.xml").read_text()
    stand = Stand(rig(motors.replace("<motor ", '<position kp="1.3e7" kv="8e4" ')), feed=True)
    pose, twist = UPRIGHT[None].copy(), np.array([[0.05, 0.0, 0.0, 0.0, 0.0, 0.1]])
    pose[0, 0] = -0.02
    stand.reset(pose, twist)
    for k in range(1, 401):
        pose[0, 0] = -0.02 + 0.05 * k * stand.tick
        pose[0, 5], pose[0, 6] = np.sin(0.05 * k * stand.tick), np.cos(0.05 * k * stand.tick)
        stand.advance(pose, twist, np.zeros((1, 6)))
    assert max(apart(stand.pose[0], pose[0])) < 2e-4


THREE_SLIDES = """
<mujoco>
  <worldbody>
    <body name="slide">
      <joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
      <joint name="y" type="slide" axis="0 1 0" range="-1 1"/>
      <joint name="z" type="slide" axis="0 0 1" range="-1 1"/>
      <geom type="box" size="0.1 0.1 0.02" mass="20"/>
      <site name="mount"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="1e6" kv="1e4"/>
    <position joint="y" kp="1e6" kv="1e4"/>
    <position joint="z" kp="1e6" kv="1e4"/>
  </actuator>
</mujoco>"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HUNG.replace('"mount"', '"flange"'), r"has no site 'mount'.*sites: flange.*add one"),
        (
            HUNG.replace(B_DRIVE, "").replace(B_JOINT, ""),
            r"5 position actuators do not move 'mount' in six axes: no motion about y",
        ),
        (THREE_SLIDES, r"no motion about [xyz] or about [xyz] or about [xyz]"),
        (HUNG.replace(B_DRIVE, ""), r"'rig/b' is neither driven nor constrained"),
        (HUNG.replace(B_DRIVE, '<motor joint="b"/>'), r"not position servos do not count"),
        (HUNG.replace("</worldbody>", ""), r"is not a model that MuJoCo compiles"),
    ],
)
def test_what_does_not_do_is_refused_with_the_reason(rig, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        rig(text)


def test_a_missing_file_is_named(tmp_path) -> None:
    with pytest.raises(ValidationError, match=r"no such file .*nowhere.xml"):
        facility("mjcf", model=str(tmp_path / "nowhere.xml"))


def test_a_start_out_of_the_workspace_names_the_joint(rig) -> None:
    stand = Stand(rig(HUNG))
    pose = UPRIGHT[None].copy()
    pose[0, 2] = -0.9
    with pytest.raises(
        InputError, match=r"the start cannot be: joint rig/z would be at .*-0.4 to 0.4 m"
    ):
        stand.reset(pose, np.zeros((1, 6)))


def test_a_start_in_a_singularity_names_the_lost_motion(rig) -> None:
    """With the wrist's middle axis at a right angle its first and last axes fall together: no turn
    about the third direction.
    """
    facility = rig(HUNG.replace('range="-0.5 0.5"', 'range="-2 2"'))
    turned = np.array([0.0, 0.0, 0.0, 0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4)])
    said = r"the start cannot be: .*singular: no motion about [xz] at "
    with pytest.raises(InputError, match=said):
        Stand(facility).reset(turned[None], np.zeros((1, 6)))
