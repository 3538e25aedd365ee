"""Ctrl-C that is neither lost nor garbled.

Raised inside a compiled import it comes out as an ImportError, inside a compiler's callback it is printed and forgotten. So it is
remembered here: long work asks `check` now and then, and an error that follows it is taken for what it is.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType

_asked = False


def install() -> None:
    """Remembers Ctrl-C from now on; it still raises KeyboardInterrupt where it can."""
    signal.signal(signal.SIGINT, _on_signal)
    before = sys.unraisablehook
    sys.unraisablehook = lambda raised: None if _asked else before(raised)


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _asked
    _asked = True
    raise KeyboardInterrupt


def asked() -> bool:
    """Whether Ctrl-C was pressed."""
    return _asked


def check() -> None:
    """Raises KeyboardInterrupt when Ctrl-C was pressed."""
    if _asked:
        raise KeyboardInterrupt
