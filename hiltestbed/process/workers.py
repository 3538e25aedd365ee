"""Worker processes on this machine, which end with their parent."""

from __future__ import annotations

import os
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.reduction import ForkingPickler
from queue import SimpleQueue
from typing import Any

from hiltestbed import plugins
from hiltestbed.process import interrupt

WATCH = 0.5  # [s] between two checks whether the parent is alive
_SPAWN = get_context("spawn")


class Workers(ThreadPoolExecutor):
    """Fresh processes, to each of which a thread here talks over a pipe.

    The queues of :class:`concurrent.futures.ProcessPoolExecutor` need named semaphores, which
    remain in the system when the program is killed; pipes end with their processes. A task whose
    process dies raises BrokenProcessPool.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self._idle: SimpleQueue[Connection] = SimpleQueue()
        self._children: list[SpawnProcess] = []
        try:
            for _ in range(workers):
                ours, theirs = _SPAWN.Pipe()
                child = _SPAWN.Process(target=_work, args=(theirs, os.getpid()))
                child.start()
                theirs.close()  # so that the pipe ends with the process
                self._idle.put(ours)
                self._children.append(child)
        except BaseException:
            self.shutdown()
            raise

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As a ProcessPoolExecutor: function, arguments and result are pickled."""
        return super().submit(self._ask, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes at once: a prompt return is worth more than the tasks in progress."""
        for child in self._children:
            child.terminate()
        for child in self._children:
            child.join()
        super().shutdown(wait=wait, cancel_futures=cancel_futures)

    def _ask(self, fn: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        link = self._idle.get()
        try:
            link.send((fn, args, kwargs))
            result, error = link.recv()
        except (EOFError, OSError):
            raise BrokenProcessPool("a worker process died") from None
        finally:
            self._idle.put(link)
        if error is not None:
            raise error
        return result


def _work(link: Connection, parent: int) -> None:
    """A worker leaves interruptions to its parent, and ends when that has ended for any reason."""
    interrupt.leave_to_parent()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    plugins.load()  # tasks contain objects of plugin classes
    while True:
        try:
            fn, args, kwargs = link.recv()
        except EOFError:
            return
        try:
            answer = ForkingPickler.dumps((fn(*args, **kwargs), None))
        except BaseException as error:  # whatever it is, it is raised in the parent
            error.add_note(traceback.format_exc())
            answer = ForkingPickler.dumps((None, error))
        try:
            link.send_bytes(answer)
        except BrokenPipeError:
            return
