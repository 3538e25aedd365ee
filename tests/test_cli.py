"""The command line: what stands on standard output, what on standard error, and the exit status."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hiltestbed.bench.result import BenchResult
from hiltestbed.cli.options import complete
from hiltestbed.report.page import Report
from hiltestbed.scenario import load_scenario
from tests.scripts import CLI, program

TEXT = """\
name: head-on
duration: 0.6
rate: 1000
spacecraft:
  chaser: {mass: 500.0, inertia: [200.0, 180.0, 150.0]}
  target: {mass: 2000.0, inertia: [900.0, 900.0, 700.0]}
approach: {gap: 0.002, velocity: [0, 0, 0.03]}
mechanism: {contact: {stiffness: 1e5, damping: 100.0}}
rig: {platform: {tracking: ideal}}
"""
CAMPAIGN = "scenario: s.yaml\nvary: {sensor.delay: {values: [0.0, 0.01]}}\ndesign: {kind: grid}\n"
DATASET = "scenario: s.yaml\nruns: [{file: run.csv, set: {sensor.delay: 0.01}}]\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(TEXT)
    Path("c.yaml").write_text(CAMPAIGN)
    Path("d.yaml").write_text(DATASET)
    Path("run.csv").write_text("t\n0\n")
    return tmp_path


def test_run_writes_the_folder_and_prints_a_table(folder: Path, call) -> None:
    status, out, _ = call("run", "s.yaml", "--no-rerun", "--out", "r")
    assert status == 0
    for words in (
        "coefficient of restitution",
        "energy made by the rig",
        "neutral",
        "peak force",
        "contact time",
        "times real time",
        "run folder: r",
    ):
        assert words in out
    assert "warning" not in out
    summary = json.loads(Path("r/summary.json").read_text())
    assert f"{summary['cor']:.4g}" in out
    assert load_scenario("r/scenario.yaml").name == "head-on"
    assert Path("r/trace.parquet").is_file()
    assert not Path("r/figures").exists()


def test_run_json_is_one_object_in_a_new_folder_and_nothing_else(folder: Path, call) -> None:
    for path, speed in (("runs/head-on", 0.02), ("runs/head-on-2", 0.03)):
        change = f"approach.velocity.2={speed}"
        status, out, _ = call("run", "s.yaml", "--no-rerun", "--json", "--set", change)
        summary = json.loads(out)
        assert (status, summary["status"], summary["folder"]) == (0, "completed", path)
        assert load_scenario(Path(path) / "scenario.yaml").approach.velocity[2] == speed
    status, out, _ = call("run", "s.yaml", "--json", "--set", "sensor.delay=-1", "--set", "rate=x")
    told = json.loads(out)
    assert (status, told["exit_status"]) == (2, 2)
    assert {fault["key"] for fault in told["faults"]} == {"sensor.delay", "rate"}


def test_a_run_that_diverges_ends_with_status_3(folder: Path, call) -> None:
    """A bumper that is too stiff for the rate (w h = 30, semi-implicit Euler needs < 2) throws the
    model out of the numbers.
    """
    faster = ("--set", "mechanism.contact.stiffness=3.6e11", "--set", "approach.velocity.2=0.2")
    for limit in ("stroke", "speed", "limb_angle_deg", "force", "torque"):
        faster += ("--set", f"safety.{limit}=null")
    status, out, err = call("run", "s.yaml", "--no-rerun", "--json", "--out", "r", *faster)
    summary = json.loads(out)
    assert (status, summary["status"]) == (3, "diverged")
    assert summary["stop_reason"] in err
    assert "r" in err


def test_bad_input_ends_with_status_2_file_line_and_what_is_allowed(folder: Path, call) -> None:
    words = "did you mean 'velocity'"
    Path("bad.yaml").write_text(TEXT.replace("velocity", "velocty"))
    status, out, err = call("run", "bad.yaml")
    assert (status, out) == (2, "")
    assert err.startswith("bad.yaml:7:")
    assert words in err
    assert not Path("runs").exists()
    status, out, _ = call("check", "s.yaml", "bad.yaml")
    assert status == 2
    assert words in out
    assert "s.yaml: scenario: no faults" in out


@pytest.mark.parametrize(
    "arguments",
    [
        "run none.yaml",
        "run .",
        "run s.yaml --set sensor.delay",
        "run s.yaml --set =3",
        "run s.yaml --set sensor.dely=3",
        "run s.yaml --out s.yaml",
        "run s.yaml --out .",
        "run s.yaml --out s.yaml/below",
        "run c.yaml",
        "run c.yaml --case 2",
        "run c.yaml --case -1",
        "run s.yaml --case 0",
        "sweep s.yaml",
        "sweep none.yaml",
        "sweep c.yaml --out .",
        "sweep c.yaml --workers 0",
        "sweep c.yaml --chunk 0",
        "sweep c.yaml --workers 2 --scheduler tcp://127.0.0.1:9",
        "sweep c.yaml --set 'design={kind: sobol, cases: 1000000000}'",
        "sweep c.yaml --set 'vary={sensor.dealy: {values: [1]}}'",
        "run d.yaml",
        "run",
        "run s.yaml --bogus",
        "check",
        "schema novel",
        "dance",
        "compare a",
        "compare a gone",
        "new ../my-rig",
    ],
)
def test_a_wrong_call_ends_with_status_2_and_says_why(folder: Path, call, arguments: str) -> None:
    status, out, err = call(*shlex.split(arguments))
    assert (status, out) == (2, "")
    assert err.strip()


def test_a_folder_that_cannot_be_written_is_said(folder: Path, call) -> None:
    if os.geteuid() == 0:
        status, _, err = call("run", "s.yaml", "--no-rerun", "--out", "/proc/none/r")
    else:
        Path("locked").mkdir(mode=0o500)
        status, _, err = call("run", "s.yaml", "--no-rerun", "--out", "locked/r")
    assert status == 2
    assert "--out" in err


def test_check_and_run_know_the_kind_of_a_file_by_its_keys(folder: Path, call) -> None:
    status, out, _ = call("check", "s.yaml", "c.yaml", "d.yaml")
    lines, names = out.splitlines(), ("s.yaml", "c.yaml")
    told = {name: [line for line in lines if line.startswith(name)] for name in names}
    assert status == 2  # the data of the dataset are opened, and hold one row
    assert told["s.yaml"][0] == "s.yaml: scenario: no faults"
    assert any(line.startswith("s.yaml: stable: net damping") for line in told["s.yaml"])
    assert told["c.yaml"][0] == "c.yaml: campaign: no faults"
    assert all(any(" of memory, " in line for line in told[name]) for name in names)
    assert "run.csv" in out
    Path("axis.yaml").write_text("axis: drive\nnominal: {mass: 1.0}\nruns: [{file: run.csv}]\n")
    status, _, err = call("run", "axis.yaml")
    assert status == 2
    assert "is an axis" in err
    assert "hiltestbed diagnose FILE" in " ".join(err.split())


def test_check_follows_a_campaign_and_a_dataset_into_their_scenario(folder: Path, call) -> None:
    Path("c.yaml").write_text(CAMPAIGN.replace("sensor.delay", "sensor.dealy"))
    Path("d.yaml").write_text(DATASET.replace("run.csv", "gone.csv").replace("0.01", "-1"))
    status, out, _ = call("check", "c.yaml", "d.yaml", "--json")
    told = json.loads(out)
    keys = [[fault["key"] for fault in file["faults"]] for file in told["files"]]
    assert status == 2
    assert keys == [["vary.sensor.dealy"], ["runs.0.file", "runs.0.set.sensor.delay"]]


def test_sweep_fills_a_folder_and_one_case_repeats_in_full(folder: Path, call) -> None:
    status, out, _ = call("sweep", "c.yaml", "--out", "swept", "--workers", "1", "--json")
    told = json.loads(out)
    assert (status, told["status"], told["counts"]) == (0, "complete", {"completed": 2})
    status, out, _ = call("run", "c.yaml", "--case", "1", "--no-rerun", "--out", "one")
    assert status == 0
    assert load_scenario("one/scenario.yaml").sensor.delay == 0.01
    assert "2 cases, complete" in call("sweep", "c.yaml", "--out", "swept")[1], (
        "there is nothing left to do"
    )


def test_shipped_scenarios_and_campaigns_are_found_by_name(folder: Path, call) -> None:
    for folder_of, name in (("scenarios", "02-bumper"), ("scenarios/campaigns", "delay-stiffness")):
        assert call("check", name, f"{folder_of}/{name}.yaml")[0] == 0
    assert call("check", "scenarios/../../../etc/passwd")[0] == 2
    assert complete("02") == ["02-bumper"]
    assert complete("s.") == ["s.yaml"]
    assert "delay-stiffness" in complete("d")


@pytest.mark.parametrize("kind", ["scenario", "campaign", "dataset"])
def test_schema_refuses_unknown_keys(folder: Path, call, kind: str) -> None:
    status, out, _ = call("schema", kind)
    assert status == 0
    assert json.loads(out)["additionalProperties"] is False


def test_figures_are_written_beside_the_report_when_asked_for(folder: Path, call) -> None:
    assert call("run", "s.yaml", "--out", "r", "--no-rerun", "--figures")[0] == 0
    drawn = Path("r/report.html").read_text().count("<img ")
    png, svg = (
        sorted(f.stem for f in Path("r/figures").glob(f"*.{kind}")) for kind in ("png", "svg")
    )
    assert png == svg
    assert len(png) == drawn > 0
    for name in png:
        assert Path(f"r/figures/{name}.png").read_bytes().startswith(b"\x89PNG")
        assert ElementTree.parse(f"r/figures/{name}.svg").getroot().tag.endswith("svg")


def test_help_imports_nothing_heavy_and_version_is_told() -> None:
    """What --help costs is what it imports; the simulation's packages take a second."""
    heavy = ["mujoco", "pinocchio", "numba", "scipy", "rerun", "pyarrow", "numpy"]
    heavy += ["pydantic", "matplotlib", "distributed"]
    code = (
        "import sys; sys.argv[1:] = ['--help']\nimport hiltestbed.cli\ntry: "
        "hiltestbed.cli.main()\nexcept SystemExit: pass\n"
    )
    code += f"print([m for m in {heavy} if m in sys.modules], file=sys.stderr)"
    done = program("-c", code, check=True)
    assert "check" in done.stdout
    assert done.stderr.strip() == "[]"
    assert program(*CLI, "--version").stdout.startswith("hiltestbed ")


def test_a_reader_that_hangs_up_gets_no_traceback(folder: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    told = {"stdout": write, "stderr": subprocess.PIPE, "capture_output": False}
    done = program(*CLI, "schema", **told)
    os.close(write)
    assert (done.returncode, "Traceback" in done.stderr) == (1, False)


def test_ended_early_leaves_no_folder_and_no_traceback(folder: Path, call) -> None:
    """And is done when it is called again."""
    long = "--set duration=200 --set approach.velocity=[0,0,0]"
    order = [sys.executable, *CLI, *f"run s.yaml --no-rerun --out r {long}".split()]
    process = subprocess.Popen(order, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    end = time.monotonic() + 60.0
    # past the command's own imports
    while "libmujoco" not in Path(f"/proc/{process.pid}/maps").read_text():
        assert time.monotonic() < end
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert b"Traceback" not in err
    assert not Path("r").exists()
    assert call(*["run", "s.yaml", "--no-rerun", "--out", "r", "--set", "duration=0.1"])[0] == 0


def test_new_writes_a_scenario_that_runs_and_says_what_each_key_means(folder: Path, call) -> None:
    status, out, _ = call("new", "my-rig")
    assert status == 0
    assert "hiltestbed run my-rig.yaml" in out
    text = Path("my-rig.yaml").read_text()
    keys = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    assert text.count("# ") >= len(keys)
    assert load_scenario("my-rig.yaml").name == "my-rig"
    assert call("check", "my-rig.yaml")[0] == 0
    assert call("new", "my-rig")[0] == 2, "nothing is overwritten"


def test_an_unknown_name_is_answered_with_those_that_are_shipped(folder: Path, call) -> None:
    status, _, err = call("run", "02-bumpr")
    assert status == 2
    assert "did you mean '02-bumper'?" in err
    assert "14-rendezvous" in err
    assert "dispersion" in call("sweep", "delay")[2]


def test_compare_puts_runs_side_by_side(folder: Path, call) -> None:
    late = "--set sensor.delay=0.01 --set compensation.force.kind=none"
    for name, changes, gains in (("a", "", False), ("b", late, True)):
        status, out, _ = call(*f"run s.yaml --no-rerun --out {name} {changes}".split())
        assert status == 0
        assert ("faster than the approach" in out) is gains
    status, out, _ = call("compare", "a", "b", "--json", "--out", "both.html")
    told = json.loads(out)
    assert status == 0
    assert told["differences"]["sensor.delay"] == [0.0, 0.01]
    assert told["figures"]["stability.direction"] == ["along z", "along z"]
    assert "data:image/png" in Path("both.html").read_text()
    assert "sensor.delay" in call("compare", "a", "b")[1]


def test_a_benchmark_that_leaves_out_the_users_own_fails_after_it_has_written(
    folder: Path, call, monkeypatch
) -> None:
    result = BenchResult("cor", [], {}, Report("CoR"), [("best", "0.001")], {"mine": "too steep"})
    monkeypatch.setattr("hiltestbed.bench.cor.cor", lambda **_: result)
    status, out, err = call("bench", "cor", "--out", "b")
    assert status == 1
    assert "0.001" in out
    assert "mine ended with: too steep" in err
    assert Path("b/bench.json").is_file()


def test_doctor_finds_what_is_needed(folder: Path, call) -> None:
    status, out, _ = call("doctor", "--json")
    told = json.loads(out)
    assert (status, told["healthy"]) == (0, True)
    assert {"mujoco", "cores", "compiled kernels", "plugins"} <= {
        finding["what"] for finding in told["findings"]
    }
    assert "mujoco" in call("doctor")[1]


def test_check_takes_the_overrides_of_run(folder: Path, call) -> None:
    """The same key, the same validation, and the verdict of what is overridden."""
    assert call("check", "s.yaml")[0] == 0
    status, out, _ = call("check", "s.yaml", "--set", "sensor.delay=-1.0")
    assert status == 2
    assert "sensor.delay: is out of range (got -1.0)" in out
    changes = "--set mechanism.contact.stiffness=2e5 --set rig.platform.bandwidth=20.0"
    status, out, _ = call(*f"check s.yaml --json {changes}".split())
    found = json.loads(out)["files"][0]
    assert found["stability"]["stiffness"] == 2e5
    assert any("rig.platform.bandwidth: has no effect" in remark for remark in found["remarks"])
