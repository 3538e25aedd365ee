"""Ctrl-C at the moments at which Python loses or garbles it; what the program itself leaves is in
the tests of its commands.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.scripts import program


def ended(code: str, *arguments: str) -> tuple[int, str, str]:
    """Status, output and errors of a program of this text."""
    done = program("-c", code, *arguments)
    return done.returncode, done.stdout, done.stderr


LATE = """
import os, signal, sys
from hiltestbed.process import interrupt
class Late:
    def __del__(self, kill=os.kill, process=os.getpid()): kill(process, 2)
sys.held = Late()  # until the modules are taken down, which is the last thing
interrupt.install()
sys.exit(3)
"""

THROUGH_TEXT = """
import os, sys
from hiltestbed.process import interrupt
interrupt.install()
try:
    exec("os.kill(os.getpid(), 2)")
except KeyboardInterrupt:
    sys.exit(1)
"""


def test_ctrl_c_that_passed_through_an_exec_leaves_the_status_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "through_text.py").write_text(THROUGH_TEXT)
    done = program("-m", "through_text", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (1, "")


IN_AN_EXECUTOR = """
import signal
from concurrent.futures import Future
from hiltestbed.process import interrupt
interrupt.install()
def work(future):
    signal.raise_signal(signal.SIGINT)
    print("whole")
future = Future()
future.set_result(None)
try:
    future.add_done_callback(work)
    print("after it")
except KeyboardInterrupt:
    print("interrupted")
"""

COMPILING = """
import os, time
from hiltestbed.process import interrupt
interrupt.install()
compiler = {"__name__": "llvmlite.binding.executionengine", "os": os, "time": time}
exec("def work():\\n    os.kill(os.getpid(), 2)\\n    time.sleep(0.3)\\n    print('compiled', flush=True)", compiler)
try:
    compiler["work"]()
    time.sleep(90.0)
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize(
    ("text", "status", "told"),
    [
        (LATE, 3, ""),
        (IN_AN_EXECUTOR, 0, "whole\ninterrupted\n"),
        (COMPILING, 0, "compiled\ninterrupted\n"),
    ],
    ids=["in the last instant", "in the locks of an executor", "in LLVM"],
)
def test_ctrl_c_waits_for_what_it_would_garble(text: str, status: int, told: str) -> None:
    assert ended(text) == (status, told, "")


EARLY = """
import os, sys
module, swallowed, *sys.argv[1:] = sys.argv[1:]
class Early:
    def find_spec(self, name, *rest):
        if name == module:
            try:
                os.kill(os.getpid(), 2)
            except KeyboardInterrupt as asked:
                if not int(swallowed):
                    raise
                raise ValueError("as Pydantic makes of it") from asked
sys.meta_path.insert(0, Early())
from hiltestbed.cli import main
main()
"""


@pytest.mark.parametrize(
    "order", [("hiltestbed.cli.program", "0"), ("hiltestbed.config.check", "1", "schema")]
)
def test_ctrl_c_while_the_program_is_being_loaded_ends_it_in_a_word(order: tuple[str, ...]) -> None:
    """Itself, or what a command imports, where a library makes another error of it."""
    assert ended(EARLY, *order) == (1, "", "interrupted\n")


HOLDING = """
import os, signal, sys, time
from hiltestbed.devices.shm import make
from hiltestbed.process import interrupt
if __name__ == "__main__":
    interrupt.install()
    interrupt.track_shared_memory()
    name = f"hiltestbed-test-{os.getpid()}"
    box = make(name, "shm")
    try:
        try:
            print(name, flush=True)
            time.sleep(60.0)
        finally:
            box.close()
    except KeyboardInterrupt:
        sys.exit(3)
"""


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="shared memory is elsewhere")
@pytest.mark.parametrize(("number", "group"), [(signal.SIGTERM, False), (signal.SIGHUP, True)])
def test_no_ending_leaves_shared_memory(
    number: signal.Signals, group: bool, tmp_path: Path
) -> None:
    """Whether it reaches the program alone, or, from a terminal, all of its processes at once."""
    program = tmp_path / "holding.py"
    program.write_text(HOLDING)
    with subprocess.Popen(
        [sys.executable, str(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # a test run that was started with nohup or in the background ignores some of them
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    ) as running:
        name = running.stdout.readline().strip()
        assert name in os.listdir("/dev/shm")
        (os.killpg if group else os.kill)(running.pid, number)
        told = running.communicate(timeout=60)[1]
    assert (running.returncode, told) == (3, "")
    assert name not in os.listdir("/dev/shm")


ASKED = """
import os, signal, sys, time
from hiltestbed.process import interrupt
number = getattr(signal, sys.argv[1])
signal.signal(number, signal.SIG_IGN if "ignored" in sys.argv else signal.SIG_DFL)
interrupt.install()
try:
    os.kill(os.getpid(), number)
    time.sleep(0.01)
    print("went on")
except KeyboardInterrupt:
    print("interrupted", interrupt.asked())
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_whatever_asks_the_program_to_end_does_as_ctrl_c(name: str) -> None:
    for more, expected in (((), "interrupted True\n"), (("ignored",), "went on\n")):
        if more and name == "SIGINT":  # a background job of a shell without job control
            continue
        assert ended(ASKED, name, *more) == (0, expected, "")
