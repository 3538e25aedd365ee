"""What stands beside the MJCF of the shipped mechanisms, and what is said of faults in it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from hiltestbed.contact.description import read
from hiltestbed.errors import InputError
from tests.models.rig import MODELS

SHIPPED = ["idss_ring", "probe_drogue", "marman_gripper", "kinematic_coupling"]


@pytest.mark.parametrize("name", SHIPPED)
def test_whatever_moves_has_mass(name: str) -> None:
    for side in ("active", "passive"):
        model = mujoco.MjModel.from_xml_path(str(MODELS / name / f"{side}.xml"))
        assert (model.body_mass[1:] > 0.0).all()
        assert (model.body_inertia[1:] > 0.0).all()


@pytest.mark.parametrize("name", SHIPPED)
def test_moving_parts_do_not_sag_on_the_ground(name: str) -> None:
    """On a rig under gravity what moves is unloaded, as a balance does it."""
    model = mujoco.MjModel.from_xml_path(str(MODELS / name / "active.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert abs(model.opt.gravity[2]) > 9.0
    assert abs(data.qpos).max(initial=0.0) < 1e-9


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("contact: []", "contact"),
        ("contact: [{active: a, passive: p, stiffness: -1}]", "stiffness"),
        ("contact: [{active: a, passive: p, stiffness: 1, stifness: 2}]", "stifness"),
        (
            "contact: [{active: a, passive: p, stiffness: 1}]\nphases: [{name: x, when: {pairs: "
            "[[a, b]], within: 1, speed: 1, count: 2}}]",
            "count",
        ),
        (
            "contact: [{active: a, passive: p, stiffness: 1}]\nphases: [{name: x, when: {pairs: "
            "[[a, b]], within: 1, speed: 1},"
            " close: {kind: weld, active: a, passive: b, stiffness: 1, damping: 0}}]",
            "radius",
        ),
        ("contact: [", "not YAML"),
    ],
)
def test_faults_are_said(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "mechanism.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read(path)


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "mechanism.yaml")
