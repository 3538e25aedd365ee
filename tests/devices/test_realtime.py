"""The clock of a cycle, what the process is granted, and the recording. No time is
asserted that a busy machine could miss.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.devices.bench import _stolen, measure
from hiltestbed.devices.pace import CycleClock
from hiltestbed.devices.realtime import prepared
from hiltestbed.devices.recorder import Recorder
from hiltestbed.errors import HiltestbedError, InputError
from tests.devices.running import until


def test_cycles_are_due_at_whole_periods_from_the_start_and_none_begins_early() -> None:
    # a period that is no whole number of nanoseconds: nothing may add up
    clock = CycleClock(300.0, 60)
    clock.start()
    numbers = np.cumsum([1 + clock.wait() for _ in range(60)])
    start = clock.due[0] - round(numbers[0] * 1e9 / 300.0)
    np.testing.assert_array_equal(clock.due - start, np.rint(numbers * 1e9 / 300.0).astype(int))
    assert (clock.began >= clock.due).all()
    np.testing.assert_allclose(clock.latency(), (clock.began - clock.due) * 1e-9)


def test_a_cycle_that_takes_too_long_is_not_made_up_for() -> None:
    clock = CycleClock(500.0, 10)
    clock.start()
    clock.wait()
    time.sleep(0.011)  # five periods and a half
    assert clock.left() < 0.0
    left_out = clock.wait()
    assert left_out >= 4
    assert clock.skipped == left_out
    assert clock.due[1] - clock.due[0] == pytest.approx((1 + left_out) * 2e6, abs=1)


PREPARED = """
import gc, os, sys
from hiltestbed.devices.realtime import prepared
cpu = min(os.sched_getaffinity(0))

def settings():
    scheduling = os.sched_getaffinity(0), os.sched_getscheduler(0)
    return *scheduling, sys.getswitchinterval(), gc.isenabled(), gc.get_freeze_count()

before = settings()
with prepared(cpu=cpu, priority=1) as given:
    asked = {"garbage collector off", "memory locked", f"processor {cpu}", "SCHED_FIFO 1"}
    assert asked <= set(given.granted) | set(given.refused)
    assert all(given.refused.values())
    assert not gc.isenabled()
    assert gc.get_freeze_count() > 0
    if "SCHED_FIFO 1" in given.granted:
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
    if f"processor {cpu}" in given.granted:
        assert os.sched_getaffinity(0) == {cpu}
assert settings() == before
"""


def test_what_is_asked_of_the_system_is_granted_or_refused_and_undone() -> None:
    """In a process of its own, which is small: all of its memory is locked."""
    subprocess.run([sys.executable, "-c", PREPARED], check=True)


REFUSED = {
    r"cannot be paced \(got 0 Hz for 5 cycles\); allowed are 0.1 to 1e5 Hz": lambda: CycleClock(
        0, 5
    ),
    r"cpu: is not one that this process may run on \(got 9999\); allowed: 0": lambda: prepared(
        cpu=9999
    ).__enter__(),
    r"priority: is out of range \(got 0\); allowed is 1 to 99": lambda: prepared(
        priority=0
    ).__enter__(),
    r"cannot be made \(got 0.5 Hz for 1 s\); allowed are 1 to 20000 Hz and up to a day": lambda: (
        measure(0.5, 1.0)
    ),
}


@pytest.mark.parametrize("said", REFUSED)
def test_what_cannot_be_done_is_said(said: str) -> None:
    with pytest.raises(InputError, match=said):
        REFUSED[said]()


def test_a_recording_holds_every_row_however_slow_its_process_is(tmp_path: Path) -> None:
    """More rows at once than a pipe holds, while the process does not run."""
    recorder = Recorder(tmp_path / "rows.f64")
    rows = np.random.default_rng(0).normal(size=(50_000, 4))
    os.kill(recorder._process._process.pid, signal.SIGSTOP)
    for row in rows:
        recorder.push(row)
    os.kill(recorder._process._process.pid, signal.SIGCONT)
    recorder.finish()
    np.testing.assert_array_equal(np.fromfile(tmp_path / "rows.f64").reshape(-1, 4), rows)


def test_a_recording_survives_the_loop(tmp_path: Path) -> None:
    """The loop's process ends at once, without a word, after Ctrl-C in its terminal: what it had
    pushed is in the file.
    """
    path = tmp_path / "rows.f64"
    program = f"""
import os, signal, numpy as np
from pathlib import Path
from hiltestbed.devices.recorder import Recorder
signal.signal(signal.SIGINT, lambda *_: None)
recorder = Recorder(Path({str(path)!r}))
os.killpg(0, signal.SIGINT)
for k in range(50):
    recorder.push(np.array([k, -k], dtype=float))
os._exit(9)
"""
    order = [sys.executable, "-c", program]
    died = subprocess.run(order, stderr=subprocess.DEVNULL, check=False, start_new_session=True)
    assert died.returncode == 9
    until(lambda: path.stat().st_size == 50 * 2 * 8)
    np.testing.assert_array_equal(np.fromfile(path).reshape(-1, 2)[:, 0], np.arange(50.0))


def test_a_recording_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(
        HiltestbedError, match=r"did not start; check that the folder can be written to"
    ):
        Recorder(tmp_path / "no folder" / "rows.f64")


def test_the_measurement_accounts_for_every_cycle() -> None:
    result = measure(400.0, 0.25, device=True, priority=None)
    assert result["cycles"] == 100
    assert 0 <= result["missed"] <= 100
    for times in (result["wake_up"], result["round_trip"]):
        levels = list(times["percentiles"].values())
        assert levels == sorted(levels)
        assert levels[-1] <= times["worst"]
        assert sum(times["histogram"]) <= 100
    assert sum(result["wake_up"]["histogram"]) == 100
    assert result["rate"] == 400.0
    assert result["stolen"] is None or 0.0 <= result["stolen"] <= 1.0


def test_what_a_hypervisor_takes_away_is_told() -> None:
    """user, nice, system, idle, iowait, irq, softirq, steal: 3 of 200 ticks went to others; a
    system without the line says nothing.
    """
    before, after = [10, 0, 5, 100, 0, 0, 0, 7], [60, 0, 12, 240, 0, 0, 0, 10]
    assert _stolen(before, after) == pytest.approx(3.0 / 200.0)
    assert _stolen(None, None) is None
