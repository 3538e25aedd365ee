"""A lock-free single-producer, single-consumer ring of rows in shared memory.

The numbers of rows pushed and taken are two aligned words, each written by one side only, after the
rows that it refers to. x86-64 keeps the order of stores; for machines that do not, each row also
begins and ends with its own number, and a row is taken only if both match. A full ring drops the
row and counts it.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from multiprocessing import resource_tracker, shared_memory

import numpy as np
from numpy.typing import NDArray

from hiltestbed.errors import InputError

LINE = 64  # [byte] of a cache line: the two counts are on separate lines
HEAD = 3 * LINE  # pushed, taken, dimensions
LARGEST = 1 << 30  # [byte]
READY = "ready"  # printed by a process once it has attached

Array = NDArray[np.float64]


def shared(name: str, own: bool = False) -> shared_memory.SharedMemory:
    """Memory that another process has created, or this one (``own``). Raises OSError."""
    if sys.version_info >= (3, 13):
        return shared_memory.SharedMemory(name, track=False)
    memory = shared_memory.SharedMemory(name)
    if not own:  # up to Python 3.12 the attaching process, too, would remove it at its exit
        resource_tracker.unregister(f"/{name}", "shared_memory")
    return memory


class Ring:
    """Rows of ``columns`` numbers; ``dropped`` counts those that found the ring full."""

    def __init__(self, columns: int, rows: int, name: str | None = None) -> None:
        """Create a ring for ``rows`` rows. Raises InputError if that is too large."""
        size = HEAD + rows * (columns + 2) * 8
        if columns < 1 or rows < 2 or size > LARGEST:
            raise InputError(
                f"ring: cannot hold {rows} rows of {columns} numbers; allowed are 2 rows and "
                f"more, and up to {LARGEST >> 20} MiB"
            )
        self._memory = shared_memory.SharedMemory(name, create=True, size=size)
        self._owner = True
        self._open(columns, rows)
        self._pushed[0] = self._taken[0] = 0
        self._about[:3] = columns, rows, 0

    @classmethod
    def attach(cls, name: str) -> Ring:
        """Attach to a ring that another process has created. Raises FileNotFoundError."""
        ring = cls.__new__(cls)
        ring._memory, ring._owner = shared(name), False
        about = np.ndarray(3, np.int64, ring._memory.buf, 2 * LINE)
        columns, rows = int(about[0]), int(about[1])
        del about
        ring._open(columns, rows)
        return ring

    def _open(self, columns: int, rows: int) -> None:
        buffer = self._memory.buf
        self.columns, self.rows = columns, rows
        self._pushed = np.ndarray(1, np.int64, buffer, 0)
        self._taken = np.ndarray(1, np.int64, buffer, LINE)
        self._about = np.ndarray(3, np.int64, buffer, 2 * LINE)  # columns, rows, finished
        self._rows = np.ndarray((rows, columns + 2), np.float64, buffer, HEAD)
        self.dropped = 0

    @property
    def name(self) -> str:
        return self._memory.name

    @property
    def finished(self) -> bool:
        """Whether the producer has finished."""
        return bool(self._about[2])

    def finish(self) -> None:
        self._about[2] = 1

    def push(self, row: Array) -> bool:
        """Append a copy of ``row`` (columns,); False if the ring is full."""
        number = int(self._pushed[0])
        if number - int(self._taken[0]) >= self.rows:
            self.dropped += 1
            return False
        slot = self._rows[number % self.rows]
        slot[0] = number
        slot[1:-1] = row
        slot[-1] = number
        self._pushed[0] = number + 1
        return True

    def take(self) -> Array:
        """Take the rows (k, columns) pushed since the last call."""
        first, end = int(self._taken[0]), int(self._pushed[0])
        numbers = np.arange(first, end)
        rows = self._rows[numbers % self.rows]
        whole = (rows[:, 0] == numbers) & (rows[:, -1] == numbers)
        count = len(rows) if whole.all() else int(np.argmin(whole))
        self._taken[0] = first + count
        return rows[:count, 1:-1]

    def close(self) -> None:
        del self._pushed, self._taken, self._about, self._rows
        self._memory.close()
        if self._owner:
            self._memory.unlink()


@contextlib.contextmanager
def attached(*names: str) -> Iterator[list[Ring]]:
    """The rings that the parent has created, after printing :data:`READY` on standard output.

    Empty if the parent has died while this process started: its rings, or its end of the pipe, no
    longer exist.
    """
    with contextlib.ExitStack() as stack:
        try:
            rings = [Ring.attach(name) for name in names]
            for ring in rings:
                stack.callback(ring.close)
            sys.stdout.write(READY + "\n")
            sys.stdout.flush()
        except (FileNotFoundError, BrokenPipeError):
            sys.stdout = None  # closing it at exit would try to write the buffer again
            rings = []
        yield rings
