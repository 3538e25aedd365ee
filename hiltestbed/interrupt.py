"""Ctrl-C that is neither lost nor garbled.

Raised inside a compiled import it comes out as an ImportError, inside a compiler's callback it is printed and forgotten, or takes the
process down. So it is remembered here: long work asks `check` now and then, an error that follows it is taken for what it is, and while
LLVM is at work it is put off until that is done.
"""

from __future__ import annotations

import atexit
import signal
import sys
from types import FrameType
from typing import Any

COMPILERS = ("llvmlite", "numba.core.codegen")  # what calls LLVM and is called back by it

_asked = False


def install() -> None:
    """Remembers Ctrl-C from now on; it still raises KeyboardInterrupt where it can."""
    signal.signal(signal.SIGINT, _on_signal)
    atexit.unregister(_over)
    atexit.register(_over)
    before = sys.unraisablehook
    sys.unraisablehook = lambda raised: None if _asked else before(raised)


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _asked
    _asked = True
    if not _compiling(frame):
        raise KeyboardInterrupt
    sys.setprofile(_on_return)


def _on_return(frame: FrameType, event: str, argument: Any) -> None:
    """Raises what was put off, as soon as a compiler returns to who called it."""
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
    """The program ends with the status that it has: Python's own end would give Ctrl-C back to the system, which ends it by the signal.

    It does so at a Ctrl-C that comes now, and where one has passed through the text of an ``exec``, whoever caught it afterwards: the next
    text forgets that.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    exec("")


def asked() -> bool:
    """Whether Ctrl-C was pressed."""
    return _asked


def check() -> None:
    """Raises KeyboardInterrupt when Ctrl-C was pressed."""
    if _asked:
        raise KeyboardInterrupt
