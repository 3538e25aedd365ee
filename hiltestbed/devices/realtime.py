"""Real-time preparation of the calling thread and of the interpreter, and what was granted.

Inside :func:`prepared` the garbage collector is disabled and existing objects are frozen, memory is
locked, the timer slack is minimal and, where permitted, the calling thread is pinned to one
processor and scheduled with SCHED_FIFO. All of it is undone afterwards. Entering
takes some 0.1 s (the last collection): do it before connections are opened.
"""

from __future__ import annotations

import ctypes
import gc
import os
import select
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from hiltestbed.errors import InputError

# of SCHED_FIFO, 1 to 99: above ordinary processes, below the kernel's interrupt threads (50)
PRIORITY = 49
_SET_TIMER_SLACK = 29  # prctl: PR_SET_TIMERSLACK
_GET_TIMER_SLACK = 30
_LOCK_ALL = 1 | 2  # mlockall: MCL_CURRENT | MCL_FUTURE
SWITCH = 1e-4  # [s] after which a waiting thread may take the interpreter lock
PATIENCE = 20.0  # [s] to wait for another process to start, and to end


@dataclass
class Granted:
    """What was granted, and what was refused with the reason."""

    granted: list[str] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)


@contextmanager
def prepared(cpu: int | None = None, priority: int | None = PRIORITY) -> Iterator[Granted]:
    """Prepare the calling thread for a steady cycle on a processor, with a priority of SCHED_FIFO,
    1 to 99; None leaves either to the kernel. Raises InputError for one that does not exist.
    """
    if priority is not None and not 1 <= priority <= 99:
        raise InputError(f"priority: is out of range (got {priority}); allowed is 1 to 99")
    if cpu is not None and hasattr(os, "sched_getaffinity") and cpu not in os.sched_getaffinity(0):
        free = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        raise InputError(
            f"cpu: is not one that this process may run on (got {cpu}); allowed: {free}"
        )
    result = Granted()
    with ExitStack() as undo:
        _memory_and_slack(result, undo)
        _schedule(cpu, priority, result, undo)
        _quiet_interpreter(result, undo)
        yield result


def ordinary() -> None:
    """Undo what a process inherits from a prepared parent: its processor and its scheduling."""
    if sys.platform == "linux":
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Companion:
    """A process that runs ``module`` of this package beside the loop. What the loop sends arrives
    at its standard input, which ends when the loop ends, however it does; the loop never waits for
    it. What it prints says how far it is.
    """

    def __init__(self, module: str, *arguments: object, pass_fds: Sequence[int] = ()) -> None:
        """``pass_fds``: files that it shares, by their numbers."""
        # a session of its own: Ctrl-C in the loop's terminal must reach only the loop
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"hiltestbed.devices.{module}", *map(str, arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
            pass_fds=pass_fds,
        )
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin
        assert stdout
        self._in, self._out = stdin.fileno(), stdout.fileno()
        os.set_blocking(self._in, False)
        self._said = b""

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def send(self, data: bytes | bytearray) -> int:
        """The number of bytes that it could take now; a message of up to 512 is taken as a whole or
        not at all (POSIX, PIPE_BUF).
        """
        try:
            return os.write(self._in, data)
        except OSError:  # it is behind, or has ended
            return 0

    def has_said(self, word: bytes, timeout: float = 0.0) -> bool:
        """Whether it has printed ``word``; waits up to ``timeout`` [s] for what it prints next."""
        if word not in self._said and select.select([self._out], [], [], timeout)[0]:
            self._said += os.read(self._out, 64)
        return word in self._said

    def end(self, rest: bytes = b"") -> int:
        """Send the ``rest`` and end its input; the status with which it ends, or is killed if it
        does not. May be called twice.
        """
        try:
            self._process.communicate(rest, PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
        return self._process.returncode


def say(word: bytes) -> bool:
    """In a companion: print ``word``; False if the loop's process is gone."""
    try:
        return os.write(1, word) > 0
    except BrokenPipeError:
        return False


def _quiet_interpreter(result: Granted, undo: ExitStack) -> None:
    undo.callback(sys.setswitchinterval, sys.getswitchinterval())
    sys.setswitchinterval(SWITCH)
    if gc.isenabled():
        undo.callback(gc.enable)
    gc.collect()
    gc.freeze()
    gc.disable()
    undo.callback(gc.unfreeze)
    result.granted.append("garbage collector off")


def _memory_and_slack(result: Granted, undo: ExitStack) -> None:
    if sys.platform != "linux":
        result.refused["memory locked"] = result.refused["timer slack"] = "not on this system"
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_LOCK_ALL) == 0:
        result.granted.append("memory locked")
        undo.callback(libc.munlockall)
    else:
        result.refused["memory locked"] = os.strerror(ctypes.get_errno())
    before = libc.prctl(_GET_TIMER_SLACK, 0, 0, 0, 0)
    if before >= 0 and libc.prctl(_SET_TIMER_SLACK, 1, 0, 0, 0) == 0:
        result.granted.append("timer slack 1 ns")
        undo.callback(libc.prctl, _SET_TIMER_SLACK, before, 0, 0, 0)
    else:
        result.refused["timer slack"] = os.strerror(ctypes.get_errno())


def _schedule(cpu: int | None, priority: int | None, result: Granted, undo: ExitStack) -> None:
    """Pin the thread to a processor and give it a priority, each if it is not None."""
    if not hasattr(os, "sched_setscheduler"):
        asked = {f"processor {cpu}": cpu, f"SCHED_FIFO {priority}": priority}
        given = {name for name, value in asked.items() if value is not None}
        result.refused |= dict.fromkeys(given, "not on this system")
        return
    if cpu is not None:
        undo.callback(os.sched_setaffinity, 0, os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cpu})
        result.granted.append(f"processor {cpu}")
    if priority is None:
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        hint = "run as root, or give the user rtprio in /etc/security/limits.conf"
        result.refused[f"SCHED_FIFO {priority}"] = f"{error.strerror}; {hint}"
        return
    undo.callback(os.sched_setscheduler, 0, *before)
    result.granted.append(f"SCHED_FIFO {priority}")
