"""The records of real devices load as the one-axis records that their examples say they are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.measured import load_dataset

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("HILTESTBED_DATA", ROOT.parent / "shared" / "data"))
EXAMPLES = ROOT / "docs" / "examples"

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"measured data are not at {DATA} (set HILTESTBED_DATA)"
)


def test_servo_is_a_platform_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """0.15 rad of amplitude at 10 mm are 1.5 mm; 4096 counts a turn are steps of 2 pi/4096 x 10
    mm.
    """
    monkeypatch.setenv("HILTESTBED_DATA", str(DATA))
    dataset = load_dataset(EXAMPLES / "so101_servo" / "dataset.yaml")
    assert dataset.links() == ("platform",)
    for run in dataset.runs:
        assert run.record.columns() == ("pose_cmd.px", "pose_act.px")
        assert run.record.measured("pose_act.px").mean() > 0.999
        assert run.record.steps["pose_act.px"] == pytest.approx(2e-2 * np.pi / 4096, rel=1e-3)
        assert run.survey.noise["pose_act.px"].white >= run.record.steps["pose_act.px"] / np.sqrt(
            12
        )
    assert np.nanmax(dataset.runs[0].record.column("pose_cmd.px")) == pytest.approx(
        1.5e-3, rel=0.01
    )


def test_damper_is_a_contact_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """The nominal k x + c v + F0 is the least-squares fit of the first run."""
    monkeypatch.setenv("HILTESTBED_DATA", str(DATA))
    dataset = load_dataset(EXAMPLES / "friction_damper" / "dataset.yaml")
    assert dataset.links() == ("contact",)
    record, scenario = dataset.runs[0].record, dataset.runs[0].scenario
    x, force = record.column("pose_act.pz"), record.column("wrench_meas.fz")
    columns = np.stack([x, np.gradient(x, record.t), np.ones_like(x)], axis=1)
    k, c, _ = np.linalg.lstsq(columns, force)[0]
    assert k == pytest.approx(scenario.mechanism.contact.stiffness, rel=0.01)
    assert c == pytest.approx(scenario.mechanism.contact.damping, rel=0.01)
