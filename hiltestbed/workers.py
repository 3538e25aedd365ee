"""Processes of this machine that work for another one: they end with it, and at once when they are told to."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from hiltestbed import plugins

WATCH = 0.5  # [s] between two looks at whether the parent is there


def new_pool(workers: int) -> ProcessPoolExecutor:
    """A pool of ``workers`` fresh processes."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(),))


def end_pool(pool: ProcessPoolExecutor) -> None:
    """End the pool now: what is under way is worth less than a prompt return."""
    children = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for child in children:
        child.terminate()
    for child in children:
        child.join()


def _begin(parent: int) -> None:
    """A worker leaves Ctrl-C to its parent, and ends when the parent is gone, however it went."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    plugins.load()  # what is handed over may be of their classes
