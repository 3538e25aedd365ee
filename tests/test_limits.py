"""DockingLimits: loads and conditions of the first contact against closed forms, and what is said of them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.analysis.assessment import assess, figures_of
from hiltestbed.analysis.limits import compared, conditions
from hiltestbed.analysis.spring_damper import SpringDamper
from hiltestbed.campaign.schema import load_campaign
from hiltestbed.campaign.sweep import sweep
from hiltestbed.config.check import look_at
from hiltestbed.errors import InputError
from hiltestbed.report.run import run_report
from hiltestbed.run_folder.folders import parquet_table
from hiltestbed.scenario import scenario_from
from hiltestbed.scenario.limits import STANDARDS, UNIT, DockingLimits, LoadLimits, in_si
from tests.running import run, shipped

IDEAL = {"rig.platform.tracking": "ideal", "duration": 0.8}


def test_swing_and_roll_of_an_attitude() -> None:
    """The rotation that tilts z by 3 deg after a roll of -5 deg, whatever the tilt's direction."""
    for direction in (0.0, 1.0, 2.5):
        axis = np.array([math.cos(direction), math.sin(direction), 0.0])
        tilt = Rotation.from_rotvec(math.radians(3.0) * axis)
        attitude = (tilt * Rotation.from_rotvec([0.0, 0.0, math.radians(-5.0)])).as_quat()
        state = np.array([0.03, -0.04, 0.0, *attitude, 0.3, 0.4, 0.1, 0.06, 0.08, -0.2])
        for sign in (1.0, -1.0):  # both quaternions of a rotation
            state[3:7] = sign * attitude
            assert conditions(state) == pytest.approx(
                {
                    "closing_speed": 0.1,
                    "lateral_speed": 0.5,
                    "pitch_yaw_rate": 0.1,
                    "roll_rate": 0.2,
                    "lateral_offset": 0.05,
                    "pitch_yaw": math.radians(3.0),
                    "roll": math.radians(5.0),
                }
            )


def test_loads_of_a_bounce_are_those_of_the_closed_form() -> None:
    """Compression of a spring and damper; nothing else in a centred touch without friction."""
    scenario = shipped("02-bumper", {**IDEAL, "limits.standard": "idss"})
    summary = run(scenario).summary
    law = scenario.mechanism.contact
    mass = 1.0 / sum(1.0 / b.mass for b in (scenario.spacecraft.chaser, scenario.spacecraft.target))
    speed = scenario.approach.velocity[2]
    peak = SpringDamper(law.stiffness, law.damping, mass).peak_force(speed)
    loads = summary["interface"]["soft_capture"]
    assert loads["compression"] == pytest.approx(peak, rel=2e-3)
    assert loads["compression"] == summary["peak_force"]
    assert max(loads[name] for name in loads if name != "compression") < 1e-6 * peak
    assert summary["interface"]["hard_capture"] is None
    assert summary["interface"]["approach"]["closing_speed"] == pytest.approx(speed, rel=1e-6)


def test_an_offset_touch_bends_by_its_lever() -> None:
    offset = 0.02
    summary = run(shipped("02-bumper", {**IDEAL, "approach.offset": [0.0, offset]})).summary
    loads = summary["interface"]["soft_capture"]
    assert loads["bending"] == pytest.approx(offset * loads["compression"], rel=0.01)
    assert summary["interface"]["approach"]["lateral_offset"] == pytest.approx(offset, rel=1e-6)
    assert summary["limits"] == []
    assert summary["limits_share"] is None


def test_a_mechanism_latched_from_the_start_is_hard_captured() -> None:
    interface = run(shipped("13-ring-down", {"duration": 0.2})).summary["interface"]
    assert interface["approach"] is interface["soft_capture"] is None
    assert interface["hard_capture"]["tension"] > 0.0


def test_the_standard_and_what_replaces_it() -> None:
    """Every limit of the standard is one of the scenario's keys; a value given replaces it; a lowest
    speed is passed from above.
    """
    given = DockingLimits(
        standard="idss", soft_capture=LoadLimits(compression="1 kN", shear="50 lbf")
    )
    each = given.each()
    whole = {(p, n) for p, limits in STANDARDS["idss"].items() for n in limits}
    assert set(each) == whole | {("soft_capture", "shear")}
    assert each["soft_capture", "compression"] == 1000.0
    assert each["soft_capture", "shear"] == pytest.approx(222.411, abs=1e-3)
    assert each["approach", "pitch_yaw"] == pytest.approx(math.radians(4.0))
    for speed, low, high in ((0.04, 1.2, 0.4), (0.05, 1.0, 0.5), (0.1, 0.0, 1.0)):
        found = {"approach": {"closing_speed": speed}}
        shares = {r["quantity"]: r["share"] for r in compared(given, found)}
        assert shares["approach.closing_speed_min"] == pytest.approx(low)
        assert shares["approach.closing_speed_max"] == pytest.approx(high)
        assert shares["soft_capture.tension"] is None


def test_the_verdict_is_in_figures_warnings_report_and_check(tmp_path: Path) -> None:
    own = {**IDEAL, "limits": {"soft_capture": {"compression": "0.1 kN"}}}
    scenario = shipped("02-bumper", own)
    done = run(scenario)
    summary = done.summary
    share = summary["peak_force"] / 100.0
    assert summary["limits_share"] == pytest.approx(share)
    assert summary["limits_worst"] == "soft_capture.compression"
    said = "allowed is at most 100 N"
    assert any(said in text for text in assess(summary).warnings)
    assert ("limits", "exceeded") in [row[:2] for row in figures_of(summary)]
    run_report(done).write(tmp_path / "report.html")
    assert "Against the limits" in (tmp_path / "report.html").read_text(encoding="utf-8")
    remarks = look_at(Path("scenarios/02-bumper.yaml"), own).remarks
    assert any(said in text for text in remarks)
    own["limits"] = {"soft_capture": {"compression": "1 kN"}}
    remarks = look_at(Path("scenarios/02-bumper.yaml"), own).remarks
    assert any(text.startswith("limits: those of the approach") for text in remarks)


def test_a_campaign_counts_the_cases_beyond_the_limits(tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    scenario = (Path(__file__).parents[1] / "scenarios" / "02-bumper.yaml").resolve()
    file.write_text(
        f"scenario: {scenario}\nset: {{rig.platform.tracking: ideal, duration: 0.8, "
        "limits: {approach: {closing_speed_max: 0.04 m/s}}}\n"
        "vary: {approach.velocity.2: {values: [0.02, 0.03, 0.05]}}\ndesign: {kind: grid}\n",
        encoding="utf-8",
    )
    sweep(load_campaign(file), out=tmp_path / "out")
    table = parquet_table(tmp_path / "out" / "cases.parquet", ["limits_share", "limits_worst"])
    assert table["limits_share"].to_pylist() == pytest.approx([0.5, 0.75, 1.25], rel=1e-6)
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Of 3 cases 1 went beyond the limits, most: 1 by approach.closing_speed_max." in text


@pytest.mark.parametrize(
    ("limits", "key", "said"),
    [
        ({"soft_capture": {"tension": 3900}}, "soft_capture.tension", "such as 1 N; units: N, daN"),
        ({"soft_capture": {"tension": "3900"}}, "soft_capture.tension", "a number with its unit"),
        ({"soft_capture": {"tension": "1.2.3 N"}}, "soft_capture.tension", "number with its unit"),
        ({"hard_capture": {"bending": "3900 N"}}, "hard_capture.bending", "such as 1 N m"),
        ({"soft_capture": {"tension": "-1 kN"}}, "soft_capture.tension", "tension pulls"),
        ({"soft_capture": {"axial": "1 kN"}}, "soft_capture.axial", "allowed: compression, ten"),
        ({"standard": "apas"}, "standard", "allowed: idss"),
    ],
)
def test_a_limit_without_unit_or_direction_is_refused_in_words(
    limits: dict, key: str, said: str
) -> None:
    with pytest.raises(InputError) as refused:
        shipped("02-bumper", {"limits": limits})
    text = str(refused.value)
    assert f"limits.{key}: " in text
    assert said in text
    assert "got" in text or "unknown key" in text


def test_a_limit_survives_a_resolved_scenario() -> None:
    scenario = shipped("02-bumper", {"limits": {"approach": {"roll": "4 deg"}}})
    again = scenario_from(scenario.model_dump(mode="json"))
    assert again.limits == scenario.limits
    assert set(UNIT) >= {name for _, name in DockingLimits(standard="idss").each()}
    assert in_si("1e3 mm", "m") == 1.0


def test_loads_before_and_after_hard_capture_are_those_of_the_trace() -> None:
    done = run(shipped("27-kinematic-coupling"))
    since = {phase["name"]: phase["at"] for phase in done.summary["phases"]}["hard_capture"]
    w = done.trace["wrench_true"]
    loads = {
        "compression": w[:, 2],
        "tension": -w[:, 2],
        "shear": np.hypot(w[:, 0], w[:, 1]),
        "bending": np.hypot(w[:, 3], w[:, 4]),
        "torsion": np.abs(w[:, 5]),
    }
    hard = done.trace.t >= since - 1e-9
    for part, rows in (("soft_capture", ~hard), ("hard_capture", hard)):
        truth = {name: max(0.0, float(values[rows].max())) for name, values in loads.items()}
        assert done.summary["interface"][part] == pytest.approx(truth, rel=1e-12)
