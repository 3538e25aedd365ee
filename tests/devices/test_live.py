"""`live` against `emulate` is `run`: the loop over the wire makes the run that the simulation
makes.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.compiled import bound
from hiltestbed.devices.rdt import RdtSettings
from hiltestbed.devices.recorder import discard
from hiltestbed.devices.session import Options, clients
from hiltestbed.run_folder.store import read_run, write_run
from hiltestbed.signals import CYCLE
from tests.devices.lockstep import RATES, SCENARIOS, played, scenario_of
from tests.devices.running import urls
from tests.running import run
from tests.slow import SLOW

PAIRS = [("rdt", "rsi"), ("udp", "udp"), ("shm", "shm"), ("rtde", "rtde")]


@pytest.mark.parametrize(("sensor", "platform"), PAIRS)
def test_a_bounce_over_the_wire_is_the_bounce_of_the_simulation(sensor: str, platform: str) -> None:
    """With a force that is 5 ms late and nothing done about it, which is what makes e sensitive:
    ln(e/e_run) far below 0.01.

    What the wire rounds is 1e-9 m (RSI) and 1e-6 N (RDT); the servo makes up to 1e-3 N of the
    rounded command.
    """
    scenario = scenario_of("03-bumper-delay-uncompensated", platform, duration=0.8)
    alone, live = run(scenario), played(scenario, platform, sensor=sensor).run
    assert live.summary["status"] == "completed"
    assert live.summary["live"]["missed"] == 0
    assert {events["lost"] for events in live.summary["live"]["events"].values()} == {0}
    assert alone.summary["cor"] > 1.0
    assert abs(math.log(live.summary["cor"] / alone.summary["cor"])) < 1e-4
    np.testing.assert_allclose(live.trace["pose_cmd"], alone.trace["pose_cmd"], atol=1e-7)
    np.testing.assert_allclose(live.trace["wrench_meas"], alone.trace["wrench_meas"], atol=1e-2)
    assert live.summary["energy_generated"] == pytest.approx(
        alone.summary["energy_generated"], rel=0.02
    )


@SLOW
def test_a_docking_over_the_wire_is_the_docking_of_the_simulation() -> None:
    """Six axes, friction, a lateral offset. e is read off a body that turns: when it is read, makes
    half a per cent.
    """
    scenario = scenario_of("11-rim-bounce", "rsi", duration=1.6)
    alone, live = run(scenario), played(scenario, "rsi").run
    assert live.summary["status"] == "completed"
    np.testing.assert_allclose(live.trace["pose_cmd"], alone.trace["pose_cmd"], atol=2e-6)
    assert live.summary["outcome"] == alone.summary["outcome"]
    assert abs(math.log(live.summary["cor"] / alone.summary["cor"])) < 0.01


def test_no_kernel_is_bound_anew_in_a_later_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Binding takes several times as long as the kernel: of 100 cycles and of 200 it takes place
    equally often.
    """
    counted, bind = [0, 0], bound.bound
    for i, duration in enumerate((0.1, 0.2)):

        def counting(*given: object, i: int = i) -> object:
            counted[i] += 1
            return bind(*given)

        monkeypatch.setattr(bound, "bound", counting)
        played(scenario_of("02-bumper", "udp", duration=duration), "udp")
    # whether a cycle more takes place before the run begins depends on the machine
    assert abs(counted[1] - counted[0]) < 30
    assert counted[1] > 0


def test_a_delay_that_nobody_told_the_loop_shows_as_it_does_in_the_simulation() -> None:
    """The rig's delay is in the rig: `run` with the same delay, and the compensation that believes
    in none, is the measure.
    """
    believed = scenario_of("03-bumper-delay-uncompensated", "udp", duration=0.8, sensor__delay=0.0)
    hidden = scenario_of("03-bumper-delay-uncompensated", "udp", duration=0.8, sensor__delay=0.0043)
    alone, live = run(hidden), played(believed, "udp", emulated=hidden).run
    assert abs(math.log(live.summary["cor"] / alone.summary["cor"])) < 0.01


def test_mounted_elsewhere_it_is_the_same_run() -> None:
    """Sensor turned and upside down, platform on a base and with a tool of its own: the loop's side
    undoes what the devices' side does.
    """
    mounted = {
        "devices.sensor.position": [0.1, -0.05, 0.3],
        "devices.sensor.attitude_deg": [20.0, -35.0, 110.0],
        "devices.sensor.sign": -1,
        "devices.platform.base": {"position": [1.2, 0.4, -0.8], "attitude_deg": [0.0, 90.0, 30.0]},
        "devices.platform.tool": {"position": [0.0, 0.02, 0.15], "attitude_deg": [5.0, 0.0, 45.0]},
    }
    turned = scenario_of("02-bumper", "rsi", duration=0.8, **mounted)
    one, other = run(turned), played(turned, "rsi").run
    assert other.summary["cor"] == pytest.approx(one.summary["cor"], rel=1e-4)
    np.testing.assert_allclose(other.trace["pose_act"], one.trace["pose_act"], atol=1e-7)


def test_nothing_moves_before_it_is_armed() -> None:
    scenario = scenario_of("02-bumper", "udp", duration=0.3)
    outcome = played(scenario, "udp", armed=False)
    start = outcome.emulator.rig.pose
    np.testing.assert_allclose(start[:3], [0.0, 0.0, -scenario.approach.gap], atol=1e-6)
    np.testing.assert_allclose(outcome.emulator.platform.command, start, atol=1e-6)


def test_the_run_folder_is_one_like_any_other_and_its_rows_are_on_disk_as_they_come(
    tmp_path: Path,
) -> None:
    """What a process that dies would leave behind is what one that lives writes at its end."""
    rows = tmp_path / "run.rows.f64"
    live = played(scenario_of("02-bumper", "udp", duration=0.5), "udp", record=rows).run
    columns = json.loads(rows.with_suffix(".json").read_text())["columns"]
    recorded = np.fromfile(rows).reshape(-1, len(columns))
    assert len(recorded) == len(live.trace.t) == 500
    for name in ("t", "pose_cmd.pz", "wrench_meas.fz", "contact"):
        np.testing.assert_array_equal(recorded[:, columns.index(name)], live.trace[name])
    discard(rows)
    assert not list(tmp_path.iterdir())
    write_run(live, tmp_path / "run")
    assert (tmp_path / "run" / "recording.rrd").stat().st_size > 10_000
    again = read_run(tmp_path / "run")
    assert again.trace[CYCLE.name].shape == (500, 4)
    assert np.all(again.trace[CYCLE.name][1:, :2] > 0.0)
    assert again.summary["live"]["events"]["platform"]["lost"] == 0
    assert np.isnan(again.trace["wrench_true"]).all()


@SLOW
def test_two_processes_in_real_time(tmp_path: Path) -> None:
    """By the commands themselves; misses are counted, and e is that of the simulation where few
    have been missed.
    """
    lenient = (
        "{misses_in_a_row: 1000, misses_in_window: 1000, disturbances_in_window: 1000, stale: 5.0}"
    )
    given = {"rate": RATES["udp"], "physics_rate": 4000.0}
    given |= {"devices.watchdog": "null", "devices.communication": lenient}
    program = [sys.executable, "-m", "hiltestbed.cli"]
    sets = [part for key, value in given.items() for part in ("--set", f"{key}={value}")]
    case = [str(SCENARIOS / "reference-bumper.yaml"), *sets, "--json"]
    pairs = zip(urls("rdt"), urls("udp"), strict=True)
    ours, theirs = (["--sensor", sensor, "--platform", moved] for sensor, moved in pairs)
    live = [*program, "live", *case, *ours, "--arm", "--out", str(tmp_path / "run"), "--for", "1.5"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([*program, "emulate", *case, *theirs], **pipes) as device:
        device.stderr.readline()
        loop = subprocess.run(live, capture_output=True, text=True, timeout=60, check=False)
        device.terminate()
        told = json.loads(device.communicate()[0])
    assert loop.returncode == 0, loop.stderr
    summary = json.loads(loop.stdout)
    expected = run(read_run(tmp_path / "run").scenario).summary["cor"]
    missed = max(summary["live"]["missed"], told["missed"])
    if missed > 10:
        pytest.skip(f"the machine is too busy to say: {missed} missed")
    assert abs(math.log(summary["cor"] / expected)) < 0.01


def test_a_sensor_that_tells_its_rate_is_asked_for_it() -> None:
    """A sensor at 4 kHz behind a platform at 1 kHz: its own rate stands on its page, and is not
    taken for the loop's.
    """
    scenario, platform = scenario_of("02-bumper", "udp"), "udp://127.0.0.1:5005?listen=5006"
    by_hand = "rdt://127.0.0.1?counts_per_force=1e6&counts_per_torque=1e6"
    rates = {"rdt://127.0.0.1": None, by_hand: 1000.0, f"{by_hand}&rate=4000": 4000.0}
    for url, rate in rates.items():
        sensor, _ = clients(scenario, Options(url, platform))
        assert isinstance(sensor.settings, RdtSettings)
        assert sensor.settings.rate == rate
