"""What the machine brings: its cores, and whether the inner loops are compiled already.

Numba keeps compiled loops on disk; the first run after an install makes them.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import sys
import time
from pathlib import Path
from typing import Any

PATIENCE = 1.0  # [s] of compiling, after which the user is told what he waits for


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Threads that this process may use at a time: its cores, but one where it is a worker beside others."""
    return 1 if multiprocessing.parent_process() is not None else cores()


def cache_folder() -> Path:
    """Where numba keeps the compiled kernel of the figures, which every run needs."""
    from hiltestbed.metrics import _update

    return Path(_update.stats.cache_path or "")


def compiled() -> bool:
    """Whether a run has been made with this installation, so that its kernels are on disk."""
    return any(cache_folder().glob("metrics._update-*.nbc"))


@functools.cache
def tell_of_compiling() -> Any:
    """From now on say on standard error, once, that inner loops are being compiled, should that take longer than :data:`PATIENCE`; the
    listener that Numba tells of it."""
    from numba.core import event

    class Told(event.Listener):
        spent = begun = 0.0
        depth, told = 0, False  # one kernel compiles those that it calls

        def on_start(self, _: event.Event) -> None:
            self.begun = self.begun if self.depth else time.monotonic()
            self.depth += 1
            self._tell()

        def on_end(self, _: event.Event) -> None:
            self._tell()
            self.depth -= 1
            if not self.depth:
                self.spent += time.monotonic() - self.begun

        def _tell(self) -> None:
            if not self.told and self.spent + time.monotonic() - self.begun > PATIENCE:
                self.told = True
                clear = "\r\x1b[K" if sys.stderr.isatty() else ""
                sys.stderr.write(f"{clear}compiling inner loops that are new here: a minute or so, and kept for later\n")
                sys.stderr.flush()

    listener = Told()
    event.register("numba:compile", listener)
    return listener
