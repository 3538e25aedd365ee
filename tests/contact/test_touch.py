"""Stiffness and damping of a mechanism in its first touch: several walls, a probe on a spring, and
the physics rate that its lightest part needs.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed import Scenario, load_scenario, run
from hiltestbed.contact.directions import acting_along_z
from hiltestbed.contact.findings import remarks
from hiltestbed.contact.resolution import converged, error_bound
from hiltestbed.contact.touch import first_touch
from hiltestbed.report.run import run_report
from hiltestbed.scenario import scenario_from

pytestmark = pytest.mark.usefixtures("in_this_process")

K, C = 1e5, 300.0  # of each wall
SPRING, DAMPER, ROD = 8000.0, 250.0, 3.0  # of the probe's stroke; mass of its rod
RADIUS = 0.025


def funnel(angle_deg: float) -> str:
    """Four walls at an angle to the axis, whose faces meet in the origin of P."""
    a = math.radians(angle_deg)
    walls = ""
    for i, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        # 5 mm behind the face, and up along it
        out = 0.08 * math.sin(a) + 0.005 * math.cos(a)
        back = -0.08 * math.cos(a) + 0.005 * math.sin(a)
        size = "0.005 0.16 0.08" if x else "0.16 0.005 0.08"
        turn = f"0 {-x * angle_deg} 0" if x else f"{y * angle_deg} 0 0"
        walls += (
            f'<geom name="w{i}" type="box" size="{size}" '
            f'pos="{x * out} {y * out} {back}" euler="{turn}"/>'
        )
    return f'<mujoco><worldbody><body name="f">{walls}<site name="P"/></body></worldbody></mujoco>'


def probe(sprung: bool) -> str:
    tip = f'<geom name="tip" type="sphere" size="{RADIUS}" pos="0 0 {{}}"/>'
    joint = f'<joint type="slide" axis="0 0 1" stiffness="{SPRING}" damping="{DAMPER}" frictionloss="6"/>'
    inertia = '<inertial pos="0 0 0" mass="{}" diaginertia="0.02 0.02 0.01"/>'
    rod = f'<body name="rod" pos="0 0 0.4">{inertia.format(ROD)}{joint}{tip.format(0)}</body>'
    return (
        f'<mujoco><worldbody><body name="base">{inertia.format(12)}<site name="A" pos="0 0 0.425"/>'
        f"{rod if sprung else tip.format(0.4)}</body></worldbody></mujoco>"
    )


def scenario(folder: Path, angle: float, sprung: bool, **changes: Any) -> Scenario:
    (folder / "a.xml").write_text(probe(sprung))
    (folder / "p.xml").write_text(funnel(angle))
    pair = {"active": "tip", "passive": "w*", "stiffness": K, "damping": C, "friction": 0.1}
    files = {"active": str(folder / "a.xml"), "passive": str(folder / "p.xml")}
    data = {
        "name": "funnel",
        "duration": 2.5,
        "rate": 250.0,
        "spacecraft": {
            "chaser": {"mass": 800.0, "inertia": [300.0] * 3, "port": {"position": [0, 0, 1.0]}},
            "target": {"mass": 3000.0, "inertia": [1500.0] * 3, "port": {"position": [0, 0, -1.2]}},
        },
        "approach": {"gap": 0.05, "velocity": [0.0, 0.0, 0.05]},
        "mechanism": {"kind": "mjcf", **files, "pairs": [pair]},
        "rig": {"platform": {"tracking": "ideal"}},
        "compensation": {"force": {"kind": "none"}},
    }
    return scenario_from(data, changes)


@pytest.mark.parametrize("angle", [40.0, 30.0])
def test_walls_that_meet_at_once_are_parallel_springs(tmp_path: Path, angle: float) -> None:
    """Centred, the force is along z with 4 k sin^2 of the angle; beside the axis along the normal
    of one wall with k; in a corner between two, k (1 + n_1 n_2).
    """
    sine, cosine = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    both = 1.0 + sine * sine  # n = (cos, 0, sin) and (0, cos, sin)
    for offset, number, size, row in (
        ((0.0, 0.0), 4, 4.0 * sine * sine, (0.0, 0.0, 1.0)),
        ((0.01, 0.0), 1, 1.0, (cosine, 0.0, sine)),
        ((0.01, 0.01), 2, both, np.array([cosine, cosine, 2.0 * sine]) / math.sqrt(2.0 * both)),
    ):
        s = scenario(tmp_path, angle, False, **{"approach.offset": list(offset)})
        touch = first_touch(s.impact)
        assert touch.contacts == number
        np.testing.assert_allclose(touch.row[:3], row, atol=1e-6)
        assert touch.stiffness == pytest.approx(size * K, rel=1e-6)
        assert touch.damping == pytest.approx(size * C, rel=1e-6)
        assert acting_along_z(s.impact)[0] == pytest.approx(4.0 * K * sine * sine, rel=1e-6)


@pytest.mark.parametrize("angle", [40.0, 30.0])
def test_a_probe_on_a_spring_is_in_series_and_its_rod_needs_the_physics_rate(
    tmp_path: Path, angle: float
) -> None:
    """Series of both springs, at rest; the rod swings between them with w^2 = (k_1 + k_2)/m, which
    takes 100 steps in half a period, or its dampers stop it at c/m.
    """
    sine = math.sin(math.radians(angle))
    k, c = 4.0 * K * sine * sine, 4.0 * C * sine * sine
    s = scenario(tmp_path, angle, True)
    stiffness, damping = acting_along_z(s.impact)
    total = k + SPRING
    assert stiffness == pytest.approx(k * SPRING / total, rel=1e-6)
    assert damping == pytest.approx((c * SPRING**2 + DAMPER * k**2) / total**2, rel=1e-6)
    fastest = max(math.sqrt(total / ROD), (c + DAMPER) / ROD)
    needed = 100.0 * fastest / math.pi
    assert needed <= s.physics_rate < 2.0 * needed
    assert scenario(tmp_path, angle, True, physics_rate=1000.0).physics_rate == 1000.0
    assert error_bound(s.impact, s.physics_rate) == pytest.approx(
        fastest / (4.0 * math.pi * s.physics_rate), rel=1e-6
    )


def test_a_reference_that_half_the_step_changes_is_said(tmp_path: Path) -> None:
    coarse = run(scenario(tmp_path, 40.0, True, physics_rate=500.0))
    fine = run(scenario(tmp_path, 40.0, True))
    said = "the physics step of 2 ms is too long"
    assert any(said in text for text in coarse.summary["warnings"])
    assert not any("too long" in text for text in fine.summary["warnings"])
    change = coarse.summary["cor_reference"] / fine.summary["cor_reference"] - 1.0
    assert abs(change) > 0.01
    assert coarse.summary["identification_normal"]["stiffness_true"] == pytest.approx(
        acting_along_z(coarse.scenario.impact)[0]
    )
    assert converged(0.75, 0.7501)
    assert not converged(None, 0.75)


@pytest.mark.parametrize("offset", [[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]], ids=str)
def test_the_truth_is_that_of_as_many_contacts_as_act(tmp_path: Path, offset: list) -> None:
    """Against what is identified without noise and delay; beside the axis the tip slides from one
    wall to the next, and there is a figure only where one number of contacts acted.
    """
    found = run(
        scenario(
            tmp_path, 40.0, False, **{"approach.offset": offset, "rate": 2000.0, "duration": 1.3}
        )
    )
    normal = found.summary["identification_normal"]
    assert normal["samples"] > 50
    assert normal["stiffness_true"] is None or normal["stiffness"] == pytest.approx(
        normal["stiffness_true"], rel=0.01
    )
    assert offset != [0.0, 0.0] or normal["stiffness_true"] is not None


def test_the_report_says_why_nothing_was_identified(tmp_path: Path) -> None:
    """A contact of almost a second, of which the pose does not show the rod's stroke."""
    done = run(scenario(tmp_path, 40.0, True))
    assert done.summary["contact_duration"] > 0.5
    run_report(done).write(tmp_path / "run.html")
    page = (tmp_path / "run.html").read_text()
    assert "the pose does not show how far" in page
    assert "long enough" not in page


def test_an_approach_on_which_nothing_meets_is_said(tmp_path: Path) -> None:
    """A probe whose site A stands at its base has passed the plate at the start."""
    for name, base in (("tip", 0.265), ("base", 0.0)):
        (tmp_path / f"{name}.xml").write_text(
            '<mujoco><worldbody><body name="probe"><geom name="tip" type="sphere" size=".015" '
            f'pos="0 0 .25" mass="1.5"/><site name="A" pos="0 0 {base}"/></body></worldbody></mujoco>'
        )
    (tmp_path / "plate.xml").write_text(
        '<mujoco><worldbody><body name="plate"><geom name="plate" type="cylinder" '
        'size=".15 .01" pos="0 0 .01" mass="4"/><site name="P"/></body></worldbody></mujoco>'
    )
    found = {}
    for name in ("tip", "base"):
        contact = {"active": "tip", "passive": "plate", "stiffness": 1e6, "damping": 1e3}
        own = {
            "kind": "mjcf",
            "active": str(tmp_path / f"{name}.xml"),
            "passive": str(tmp_path / "plate.xml"),
            "pairs": [contact],
        }
        scenario = load_scenario("02-bumper", set={"mechanism": own, "approach.gap": 0.02})
        found[name] = any("nothing touches" in remark for remark in remarks(scenario))
    assert found == {"tip": False, "base": True}
