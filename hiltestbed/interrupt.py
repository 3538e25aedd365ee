"""Ctrl-C that is neither lost nor garbled.

Raised inside a compiled import it comes out as an ImportError, inside a compiler's callback it is printed and forgotten. So it is
remembered here: long work asks `check` now and then, and an error that follows it is taken for what it is.
"""

from __future__ import annotations

import atexit
import signal
import sys
from types import FrameType

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
    raise KeyboardInterrupt


def _over() -> None:
    """The program ends with the status that it has: Python's own end would give Ctrl-C back to the system, which ends it by the signal."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def asked() -> bool:
    """Whether Ctrl-C was pressed."""
    return _asked


def check() -> None:
    """Raises KeyboardInterrupt when Ctrl-C was pressed."""
    if _asked:
        raise KeyboardInterrupt
