"""Reliable handling of Ctrl-C, and of every other signal that asks a program to end.

A KeyboardInterrupt inside a compiled import appears as an ImportError; inside a compiler's callback
it is printed and lost, or crashes the process. Ctrl-C is therefore recorded here: long tasks call
`check` regularly, an error that follows a Ctrl-C is attributed to it, and while LLVM is compiling
the exception is deferred. So it is inside an executor: raised where that takes a lock, it leaves
the lock taken, and the threads that wait for it never end.
"""

from __future__ import annotations

import atexit
import signal
import sys
from types import FrameType
from typing import Any

# from the terminal (Ctrl-C, Ctrl-\\, its window closed), a scheduler or a service manager
ENDING = ("SIGINT", "SIGQUIT", "SIGHUP", "SIGTERM")
# modules that call LLVM and are called back by it, and that hold locks
DEFERRING = ("llvmlite", "numba.core.codegen", "concurrent.futures")

_asked = False


def install() -> None:
    """Records Ctrl-C from now on; it still raises KeyboardInterrupt where that is safe.

    The other signals that ask a program to end do the same, unless the caller (nohup) has them
    ignored.
    """
    for number in _ending():
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _on_signal)
    atexit.unregister(_over)
    atexit.register(_over)
    before = sys.unraisablehook
    sys.unraisablehook = lambda raised: None if _asked else before(raised)


def track_shared_memory() -> None:
    """Start Python's process that removes the shared memory which others leave, so that what ends
    a group of processes does not end it.
    """
    if sys.platform == "win32":
        return
    from multiprocessing import resource_tracker  # 8 ms

    before = {number: signal.signal(number, signal.SIG_IGN) for number in _ending()}
    resource_tracker.ensure_running()
    for number, handler in before.items():
        signal.signal(number, handler)


def leave_to_parent() -> None:
    """Ignore, in a worker process, what the terminal sends to all processes of a group; SIGTERM is
    how the parent ends its workers.
    """
    for number in _ending():
        signal.signal(number, signal.SIG_DFL if number == signal.SIGTERM else signal.SIG_IGN)


def _ending() -> list[signal.Signals]:
    return [getattr(signal, name) for name in ENDING if hasattr(signal, name)]


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _asked
    _asked = True
    if number != signal.SIGINT:  # a second one must not interrupt what the first has begun
        signal.signal(number, signal.SIG_IGN)
    if not _deferring(frame):
        raise KeyboardInterrupt
    sys.setprofile(_on_return)


def _on_return(frame: FrameType, event: str, argument: Any) -> None:
    """Raises the deferred KeyboardInterrupt as soon as a module that defers it returns."""
    if event == "return" and _deferring(frame) and not _deferring(frame.f_back):
        sys.setprofile(None)
        raise KeyboardInterrupt


def _deferring(frame: FrameType | None) -> bool:
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith(DEFERRING):
            return True
        frame = frame.f_back
    return False


def _over() -> None:
    """Let the program end with its own exit status: after a Ctrl-C at exit, or one that left an
    ``exec``, even if it was caught, Python would end it by SIGINT; another ``exec`` clears that.
    """
    for number in _ending():
        signal.signal(number, signal.SIG_IGN)
    exec("")


def asked() -> bool:
    """Whether the program was asked to end."""
    return _asked


def check() -> None:
    """Raises KeyboardInterrupt if the program was asked to end."""
    if _asked:
        raise KeyboardInterrupt
