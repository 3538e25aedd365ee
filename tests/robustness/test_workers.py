"""When a worker of the random trials hangs."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from hiltestbed.bench.robustness.run import _Clock

WORK = "import time\nend = time.process_time() + {}\nwhile time.process_time() < end: pass\nprint(flush=True)\ntime.sleep(60)"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the wall clock alone tells")
@pytest.mark.parametrize(("works", "patience", "hangs"), [(0.0, 0.3, True), (0.5, 0.3, True), (0.3, 0.5, False)])
def test_who_sleeps_or_works_too_long_hangs_and_who_waits_for_a_core_does_not(works: float, patience: float, hangs: bool) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()\n" + WORK.format(works)], stdin=-1, stdout=-1, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        time.sleep(0.3)  # Python's own start is over, and is not counted
        clock = _Clock(process.pid)
        process.stdin.write("\n")
        process.stdin.flush()
        process.stdout.readline()
        assert not clock.silent(1e3)
        while time.monotonic() - clock._wall < 1.05 * patience:
            time.sleep(0.01)
        assert clock.silent(patience) is hangs
        process.kill()
