"""A platform under its own servo is no departure: what the drives yield to the force is replayed, not named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hiltestbed.diagnosis.driven import followed, unfollowed

from hiltestbed import load_scenario, run
from hiltestbed.diagnosis.find import find
from hiltestbed.diagnosis.links import advanced
from hiltestbed.measured import load_dataset
from hiltestbed.recording import write_run

SCENARIO = Path(__file__).parents[2] / "scenarios" / "reference-bumper.yaml"
NOISE = 0.2  # [N]


def test_the_replayed_drives_go_where_the_drives_went() -> None:
    """Told the recorded command under the recorded force, 5 ms late and with its noise: the noise is what is left, 0.2 N on 4e7 N/m."""
    result = run(load_scenario(SCENARIO, set={"duration": 1.0, "sensor.noise": NOISE}))
    assert result.trace is not None
    command, pose = result.trace["pose_cmd"], result.trace["pose_act"]
    ticks = result.scenario.sensor.delay * result.scenario.rate
    path = followed(result.scenario, command, advanced(result.trace["wrench_meas"], ticks))
    assert path is not None
    yielded = np.abs(pose[1:, 2] - command[:-1, 2]).max()
    assert yielded > 4e-6
    assert np.abs(path[:, 2] - pose[:, 2]).max() < 2e-3 * yielded


@pytest.mark.parametrize("hidden", [None, {"kind": "platform.backlash", "width": 1e-4}])
def test_of_a_driven_platform_only_what_is_hidden_is_named(tmp_path: Path, hidden: dict | None) -> None:
    (tmp_path / "nominal.yaml").write_bytes(SCENARIO.read_bytes())
    entries = []
    for seed, speed in enumerate((0.02, 0.04, 0.06)):
        approach = {"approach.velocity": [0.0, 0.0, speed]}
        given = approach | {"duration": 0.9, "sensor.noise": NOISE, "sensor.torque_noise": 0.02, "seed": seed}
        write_run(
            run(load_scenario(SCENARIO, set=given | ({"effects": [hidden]} if hidden else {}))), tmp_path / f"run_{seed}", rerun=False
        )
        entries.append(f"  - {{file: run_{seed}/trace.parquet, set: {{approach.velocity: [0, 0, {speed}], duration: 0.9}}}}")
    (tmp_path / "dataset.yaml").write_text("\n".join(["scenario: nominal.yaml", "runs:", *entries, ""]), encoding="utf-8")
    finding = find(load_dataset(tmp_path / "dataset.yaml"))
    if hidden is None:
        assert finding.verdict == "no_discrepancy"
    else:
        assert finding.verdict == "named"
        assert [c.effect for c in finding.causes] == [hidden["kind"]]
        ends = finding.causes[0].parameters["width"].ci95
        assert ends is not None
        assert ends[0] <= hidden["width"] <= ends[1]


def test_a_command_that_the_record_does_not_hold_is_not_guessed() -> None:
    class Run:
        scenario = load_scenario(SCENARIO, set={"compensation.motion": {"kind": "inverse_model"}})

    reason = unfollowed([Run()])  # type: ignore[list-item]
    assert reason is not None
    assert "inverse_model" in reason
    Run.scenario = load_scenario(SCENARIO.parent / "13-ring-down.yaml")
    reason = unfollowed([Run()])  # type: ignore[list-item]
    assert reason is not None
    assert "mount" in reason


def test_a_command_that_the_drives_cannot_follow_is_not_taken_for_their_yield() -> None:
    scenario = load_scenario(SCENARIO)
    command = np.tile([0.0, 0.0, -0.01, 0.0, 0.0, 0.0, 1.0], (50, 1))
    command[10:, 2] = 1e6  # [m]
    assert followed(scenario, command, np.zeros((50, 6))) is None
