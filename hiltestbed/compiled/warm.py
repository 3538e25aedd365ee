"""The cores of the machine, and whether the inner loops have been compiled.

Numba caches compiled loops on disk; the first run after an install compiles them.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import time
from pathlib import Path
from typing import Any

from hiltestbed.compiled.jit import before_the_first_kernel
from hiltestbed.process.output import overwrite

PATIENCE = 1.0  # [s] of compiling, after which a message to the user is printed


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Threads that this process may use: its cores, or one if it is a worker process."""
    return 1 if multiprocessing.parent_process() is not None else cores()


def cache_folder() -> Path:
    """Folder in which Numba caches the kernel of the figures, which every run needs."""
    from hiltestbed.analysis.metrics import take_figures

    return Path(take_figures.dispatcher.stats.cache_path or "")


def compiled() -> bool:
    """Whether this installation has made a run before, so that its kernels are on disk."""
    return any(cache_folder().glob("metrics.take_figures-*.nbc"))


@functools.cache
def tell_of_compiling() -> None:
    """From now on, say once on standard error if compiling takes more than :data:`PATIENCE`."""
    before_the_first_kernel(listen)


def listen() -> Any:
    """Registers the listener for Numba's events that prints the message, and returns it."""
    from numba.core import event

    class CompileListener(event.Listener):
        spent = begun = 0.0
        depth, notified = 0, False  # one kernel compiles those that it calls

        def on_start(self, _: event.Event) -> None:
            self.begun = self.begun if self.depth else time.monotonic()
            self.depth += 1
            self._notify()

        def on_end(self, _: event.Event) -> None:
            self._notify()
            self.depth -= 1
            if not self.depth:
                self.spent += time.monotonic() - self.begun

        def _notify(self) -> None:
            if not self.notified and self.spent + time.monotonic() - self.begun > PATIENCE:
                self.notified = True
                overwrite(
                    "compiling inner loops not needed before: takes about a minute; they are kept",
                    "\n",
                )

    listener = CompileListener()
    event.register("numba:compile", listener)
    return listener
