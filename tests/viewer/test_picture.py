"""`hiltestbed view --png`, and the strokes of a mechanism that it draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from hiltestbed.run_folder.result import Run
from hiltestbed.run_folder.store import read_run, write_run
from hiltestbed.scenario import load_scenario
from tests.running import run

CHANGES = {"approach.gap": 0.06, "duration": 0.6, "rig.platform.tracking": "ideal"}


@pytest.fixture(scope="module")
def touched() -> Run:
    return run(load_scenario("16-probe-drogue", CHANGES))


def test_the_stroke_of_a_probe_is_a_column(touched: Run, tmp_path: Path) -> None:
    write_run(touched, tmp_path / "run", rerun=False, report=False)
    read = read_run(tmp_path / "run").trace
    stroke = read["joint.active_stroke"]
    np.testing.assert_array_equal(stroke, touched.trace["joint.active_stroke"])
    assert read.about()["joint.active_stroke"]["unit"] == "m"
    first = int(np.argmax(read.contact))
    assert np.abs(stroke[:first]).max() < 1e-6
    # the drogue pushes the probe back, by no more than the ports have approached since the touch
    approached = read["pose_act.pz"][-1] - read["pose_act.pz"][first - 1]
    assert -approached - 1e-4 < stroke[-1] < -1e-4


def test_a_picture_needs_no_display(
    touched: Run,
    call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    folder = write_run(touched, tmp_path / "run", rerun=False, report=False)
    status, out, _ = call("view", str(folder), "--png", str(tmp_path / "run.png"))
    assert (status, out.strip()) == (0, str(tmp_path / "run.png"))
    picture = imread(tmp_path / "run.png")
    assert picture.shape[:2] == (880, 1320)
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 1000  # shaded solids
    status, _, err = call("view", str(folder), "--png", str(tmp_path / "run.jpg"))
    assert status == 2
    assert "no PNG file" in err
