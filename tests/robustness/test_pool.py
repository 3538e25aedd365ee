"""Worker processes: nothing of theirs outlives them, and what they cannot do is said."""

from __future__ import annotations

import os
import signal
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from hiltestbed.process.workers import Workers

SHARED = Path("/dev/shm")


def semaphores() -> set[str]:
    """Named ones; the shared memory beside them may be of any other process."""
    return {name for name in os.listdir(SHARED) if name.startswith("sem.")}


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise ValueError("as it is")


def refuse_to_travel() -> object:
    return lambda: None


@pytest.mark.skipif(sys.platform != "linux", reason="looks at the kernel's tables")
def test_workers_answer_and_leave_nothing() -> None:
    before = semaphores()
    pool = Workers(2)
    try:
        one, two = pool.submit(divmod, 17, 5), pool.submit(fail)
        assert one.result() == (3, 2)
        with pytest.raises(ValueError, match="as it is"):
            two.result()
        with pytest.raises((AttributeError, TypeError)):
            pool.submit(refuse_to_travel).result()
        assert semaphores() <= before  # whoever is killed now
        with pytest.raises(BrokenProcessPool):
            pool.submit(die).result()
        busy = pool.submit(time.sleep, 600.0)
    finally:
        begin = time.monotonic()
        pool.shutdown(cancel_futures=True)
    # it was given to a worker, or not yet
    assert busy.cancelled() or isinstance(busy.exception(), BrokenProcessPool)
    assert time.monotonic() - begin < 60.0
    assert not any(child.is_alive() for child in pool._children)


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP", "SIGQUIT"])
def test_what_a_terminal_sends_to_all_is_for_the_parent(name: str) -> None:
    pool = Workers(1)
    try:
        number = pool.submit(os.getpid).result()
        os.kill(number, getattr(signal, name))
        assert pool.submit(os.getpid).result() == number
    finally:
        pool.shutdown()
