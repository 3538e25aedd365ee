"""`hiltestbed diagnose`: its folder, its one JSON object, and what it does with data that cannot be used."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from hiltestbed.cli import main
from hiltestbed.diagnosis.diagnose import diagnose

from .recorded import recorded


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["hiltestbed", "diagnose", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_a_healthy_rig_is_told_so_in_one_json_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert command(monkeypatch, str(recorded(tmp_path, [])), "--out", str(out), "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["verdict"] == "no_discrepancy"
    assert printed["causes"] == []
    assert printed["extended_scenario"] is None
    assert all(r["white"] for r in printed["residuals"] if r["channel"].startswith("wrench_meas"))
    assert {k: v for k, v in printed.items() if k != "folder"} == json.loads((out / "diagnosis.json").read_text())
    assert sorted(f.name for f in out.iterdir()) == ["diagnosis.json", "extended.yaml", "recording.rrd", "report.html"]


@pytest.mark.parametrize("content", [b"", b"PAR1 this is no parquet file", b"t,pose_cmd.pz\n"])
def test_bad_data_leave_nothing_behind(
    content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = recorded(tmp_path, [])
    (tmp_path / "run_1.parquet").write_bytes(content)
    before = sorted(tmp_path.iterdir())
    assert command(monkeypatch, str(dataset), "--out", str(tmp_path / "out")) == 2
    assert "run_1.parquet" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_with_other_things_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert command(monkeypatch, str(tmp_path / "missing.yaml"), "--out", str(tmp_path)) == 2
    assert [f.name for f in tmp_path.iterdir()] == ["notes.txt"]


def test_progress_says_which_link_of_how_many_and_which_step_is_left(tmp_path: Path) -> None:
    """The links in their order, each begun before it is searched, then the closing steps in theirs."""
    told: list[str] = []
    diagnose(recorded(tmp_path, [{"kind": "contact.stiffness", "factor": 1.2}]), told.append)
    links = [re.match(r"link (\d) of (\d), ([a-z ]+): ", text) for text in told]
    begun = {m[1]: m[3] for m in links if m}
    assert begun == {"1": "platform", "2": "compensation", "3": "contact and sensor", "4": "numerical model"}
    assert [m[1] for m in links if m] == sorted(m[1] for m in links if m)
    assert {m[2] for m in links if m} == {"4"}
    steps = [m[1] for text in told if (m := re.match(r"closing step (\d) of 4: ", text))]
    assert steps == sorted(steps)
    assert set(steps) == {"1", "2", "3"}
    assert not links[-1]
