"""Worker processes on this machine, which end with their parent."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from hiltestbed import plugins
from hiltestbed.process import interrupt

WATCH = 0.5  # [s] between two checks whether the parent is alive


def new_pool(workers: int) -> ProcessPoolExecutor:
    """A pool of ``workers`` fresh processes."""
    return ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(),)
    )


def end_pool(pool: ProcessPoolExecutor) -> None:
    """End the pool at once: a prompt return is worth more than the tasks in progress."""
    children = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for child in children:
        child.terminate()
    for child in children:
        child.join()


def _begin(parent: int) -> None:
    """A worker ignores Ctrl-C and what is handled like it by its parent, and ends when the parent
    has ended for any reason.
    """
    import signal

    for number in {signal.SIGINT, *interrupt.ENDINGS} - {signal.SIGTERM}:
        signal.signal(number, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    plugins.load()  # tasks contain objects of plugin classes
