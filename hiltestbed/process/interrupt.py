"""Reliable handling of Ctrl-C.

A KeyboardInterrupt inside a compiled import appears as an ImportError; inside a compiler's callback
it is printed and lost, or crashes the process. Ctrl-C is therefore recorded here: long tasks call
`check` regularly, an error that follows a Ctrl-C is attributed to it, and while LLVM is compiling
the exception is deferred.
"""

from __future__ import annotations

import atexit
import signal
import sys
from types import FrameType
from typing import Any

COMPILERS = ("llvmlite", "numba.core.codegen")  # modules that call LLVM and are called back by it

# the signals that end a program besides Ctrl-C: a request, a terminal that closes, its Ctrl-\
ENDINGS = [n for n in signal.Signals if n.name in ("SIGTERM", "SIGHUP", "SIGQUIT")]

_asked = False


def install() -> None:
    """Records Ctrl-C from now on; it still raises KeyboardInterrupt where that is safe."""
    signal.signal(signal.SIGINT, _on_signal)
    atexit.unregister(_over)
    atexit.register(_over)
    before = sys.unraisablehook
    sys.unraisablehook = lambda raised: None if _asked else before(raised)


def like_ctrl_c() -> None:
    """Handle the other signals that end a program like Ctrl-C from now on, so that it gives back
    the shared memory and the semaphores that it holds; a hang-up that is ignored (nohup) stays so.
    """
    taken = [n for n in ENDINGS if n.name != "SIGHUP" or signal.getsignal(n) is not signal.SIG_IGN]
    # Python's process that removes what others leave must not be ended by what ends its group
    for number in taken:
        signal.signal(number, signal.SIG_IGN)
    if sys.platform != "win32":
        from multiprocessing import resource_tracker  # 8 ms

        resource_tracker.ensure_running()

    def end(number: int, frame: FrameType | None) -> None:
        for other in taken:  # a second one must not interrupt what the first has begun
            signal.signal(other, signal.SIG_IGN)
        _on_signal(number, frame)

    for number in taken:
        signal.signal(number, end)


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _asked
    _asked = True
    if not _compiling(frame):
        raise KeyboardInterrupt
    sys.setprofile(_on_return)


def _on_return(frame: FrameType, event: str, argument: Any) -> None:
    """Raises the deferred KeyboardInterrupt as soon as a compiler returns to its caller."""
    if event == "return" and _compiling(frame) and not _compiling(frame.f_back):
        sys.setprofile(None)
        raise KeyboardInterrupt


def _compiling(frame: FrameType | None) -> bool:
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith(COMPILERS):
            return True
        frame = frame.f_back
    return False


def _over() -> None:
    """Let the program end with its own exit status: otherwise Python may end it by the signal
    SIGINT.

    Python does so after a Ctrl-C at exit (ignored from here on), and if a KeyboardInterrupt has
    left an ``exec``, even if it was caught afterwards; another ``exec`` clears that flag.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    exec("")


def asked() -> bool:
    """Whether Ctrl-C was pressed."""
    return _asked


def check() -> None:
    """Raises KeyboardInterrupt if Ctrl-C was pressed."""
    if _asked:
        raise KeyboardInterrupt
