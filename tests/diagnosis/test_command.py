"""`hiltestbed diagnose`: its folder, its one JSON object, and what it does with data that cannot be
used.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hiltestbed.cli import main
from hiltestbed.diagnosis.diagnose import diagnose
from hiltestbed.diagnosis.report.diagnosis import conclude
from hiltestbed.diagnosis.result import Finding
from hiltestbed.effects import EFFECTS
from hiltestbed.measured import load_dataset
from tests.slow import SLOW

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
    assert {k: v for k, v in printed.items() if k != "folder"} == json.loads(
        (out / "diagnosis.json").read_text()
    )
    assert sorted(f.name for f in out.iterdir()) == [
        "diagnosis.json",
        "extended.yaml",
        "recording.rrd",
        "report.html",
    ]


@pytest.mark.parametrize("content", [b"", b"PAR1 this is no parquet file", b"t,pose_cmd.pz\n"])
def test_bad_data_leave_nothing_behind(
    content: bytes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dataset = recorded(tmp_path, [])
    (tmp_path / "run_1.parquet").write_bytes(content)
    before = sorted(tmp_path.iterdir())
    assert command(monkeypatch, str(dataset), "--out", str(tmp_path / "out")) == 2
    assert "run_1.parquet" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_with_other_things_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert command(monkeypatch, str(tmp_path / "missing.yaml"), "--out", str(tmp_path)) == 2
    assert [f.name for f in tmp_path.iterdir()] == ["notes.txt"]


@SLOW
def test_progress_says_which_link_of_how_many_and_which_step_is_left(tmp_path: Path) -> None:
    """The links in their order, each begun before it is searched, then the closing steps in
    theirs.
    """
    told: list[str] = []
    diagnose(recorded(tmp_path, [{"kind": "contact.stiffness", "factor": 1.2}]), told.append)
    links = [re.match(r"link (\d) of (\d), ([a-z ]+): ", text) for text in told]
    begun = {m[1]: m[3] for m in links if m}
    assert begun == {
        "1": "compensation",
        "2": "numerical model",
        "3": "platform",
        "4": "contact and sensor",
    }
    assert [m[1] for m in links if m] == sorted(m[1] for m in links if m)
    assert {m[2] for m in links if m} == {"4"}
    steps = [m[1] for text in told if (m := re.match(r"closing step (\d) of 4: ", text))]
    assert steps == sorted(steps)
    assert set(steps) == {"1", "2", "3"}
    assert not links[-1]


def test_every_link_has_the_sizes_that_would_show_or_the_reason_why_not(tmp_path: Path) -> None:
    """A gain shows on the axis of the contact force, whichever axis is tried first; links without a
    channel say so.
    """
    file = recorded(tmp_path, [])
    _rewrite(
        tmp_path,
        lambda table: table.drop_columns(
            [n for n in table.column_names if n.startswith("wrench_comp")]
        ),
    )
    result = diagnose(file)
    sizes = {i.effect: i.smallest for i in result.finding.isolability}
    assert {EFFECTS[effect].link for effect in sizes} >= {"platform", "contact", "sensor"}
    assert set(result.finding.unsized) == {"compensation", "numerical model"}
    assert all("wrench_comp" in why for why in result.finding.unsized.values())
    assert sizes["sensor.gain"] is not None
    assert sizes["contact.stiffness"] is not None
    # a scale of fz and of k change the force alike, but for the damper: 2 zeta = c/sqrt(k mu) of
    # the force
    assert sizes["sensor.gain"] == pytest.approx(sizes["contact.stiffness"], rel=0.2)


def test_an_overridden_check_is_stated_with_what_is_assumed(tmp_path: Path) -> None:
    file = recorded(tmp_path, [])
    names = ("wrench_meas.fz", "wrench_comp.fz")
    _rewrite(
        tmp_path,
        lambda t: t.set_column(
            t.column_names.index(names[0]), names[0], pa.chunked_array([-t[names[0]].to_numpy()])
        ),
    )
    file.write_text(f"{file.read_text()}accept: [sign]\n")
    result = conclude(load_dataset(file), Finding("no_discrepancy", None))
    (stated,) = result.to_json()["overridden"]
    assert "accept: [sign]" in stated
    assert names[0] in stated
    assert names[1] not in stated
    assert "run_0.parquet, run_1.parquet" in stated
    assert "nothing is turned" in stated
    assert "accept: [sign]" in (result.write(tmp_path / "out") / "report.html").read_text()


def _rewrite(folder: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    for run in folder.glob("*.parquet"):
        pq.write_table(change(pq.read_table(run)), run)
