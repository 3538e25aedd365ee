"""A mailbox in shared memory: the newest message of one process for another, complete or not at
all.

128 bytes that one process writes and one reads: a magic number, a sequence lock (the count is odd
while the writer is active; as in the Linux kernel), the number of the message, its time, a flag,
seven numbers and their CRC-32. The CRC detects incomplete messages on machines that reorder stores,
and foreign writes.
"""

from __future__ import annotations

import math
import sys
import zlib
from multiprocessing import resource_tracker, shared_memory

import numpy as np
from numpy.typing import NDArray

from hiltestbed.devices.interface import Array
from hiltestbed.errors import Fault, InputError

MAGIC = 0x48544D424F580001
SIZE = 128  # [byte]
WORDS, NUMBERS = 6, 8  # magic, lock, number of the message, flag, CRC, spare; time and seven values
TRIES = 8  # reads before the next poll tries again

_own: set[str] = set()  # names created by this process


class Mailbox:
    """One writer, one reader.

    Attributes:
        values: (7,) of the message last read. number, time, flag: of the same.
    """

    def __init__(self, memory: shared_memory.SharedMemory, owner: bool) -> None:
        self._memory, self._owner = memory, owner
        self._words: NDArray[np.uint64] = np.ndarray(WORDS, np.uint64, memory.buf)
        self._numbers: Array = np.ndarray(NUMBERS, np.float64, memory.buf, 8 * WORDS)
        self.values: Array = np.zeros(7)
        self.number, self.time, self.flag = 0, math.nan, 0
        if owner:
            _own.add(memory.name)
            self._words[:] = 0
            self._words[0] = MAGIC

    @property
    def valid(self) -> bool:
        return int(self._words[0]) == MAGIC

    def write(self, values: Array, number: int, time: float, flag: int) -> None:
        """Write a message of at most seven values."""
        lock = (
            (int(self._words[1]) | 1) if int(self._words[1]) & 1 == 0 else int(self._words[1]) + 2
        )
        self._words[1] = lock & 0xFFFFFFFFFFFFFFFF
        self._words[2], self._words[3] = number, flag
        self._numbers[0] = time
        self._numbers[1 : 1 + len(values)] = values
        self._numbers[1 + len(values) :] = 0.0
        self._words[4] = self._crc(int(self._words[2]), int(self._words[3]), self._numbers)
        self._words[1] = (lock + 1) & 0xFFFFFFFFFFFFFFFF

    def read(self) -> bool | None:
        """True for a new message; False for none, or while the writer is active; None for a damaged
        one.
        """
        if int(self._words[2]) == self.number:
            return False
        damaged = False
        for _ in range(TRIES):
            before = int(self._words[1])
            number, flag, crc = int(self._words[2]), int(self._words[3]), int(self._words[4])
            copy = self._numbers.copy()
            # no write was active: complete, unless the CRC differs
            damaged = before & 1 == 0 and int(self._words[1]) == before
            if not damaged:
                continue
            if crc != self._crc(number, flag, copy) or not np.isfinite(copy).all():
                continue
            if number == self.number:
                return False
            self.number, self.flag, self.time = number, flag, float(copy[0])
            self.values[:] = copy[1:8]
            return True
        return None if damaged else False

    def _crc(self, number: int, flag: int, numbers: Array) -> int:
        head = number.to_bytes(8, "little") + flag.to_bytes(8, "little")
        return zlib.crc32(numbers.tobytes(), zlib.crc32(head))

    def close(self) -> None:
        del self._words, self._numbers
        self._memory.close()
        if self._owner:
            _own.discard(self._memory.name)
            self._memory.unlink()


def make(name: str, where: str) -> Mailbox:
    """Create a mailbox; ``where``: the device, for the message. Raises InputError if the name is
    taken.
    """
    try:
        return Mailbox(shared_memory.SharedMemory(name, create=True, size=SIZE), owner=True)
    except FileExistsError:
        message = (
            f"the shared memory {name} is there already; stop the other device, "
            f"remove what one has left, or give another name"
        )
        raise InputError(Fault(where, None, None, "", message)) from None
    except OSError as error:
        message = f"the shared memory {name} cannot be made ({error.strerror})"
        raise InputError(Fault(where, None, None, "", message)) from None


def attach(name: str) -> Mailbox | None:
    """Attach to the mailbox that the device has created; None if there is none."""
    try:
        if sys.version_info >= (3, 13):
            memory = shared_memory.SharedMemory(name, track=False)
        else:  # up to Python 3.12 the attaching process, too, would remove it at its exit
            memory = shared_memory.SharedMemory(name)
            if name not in _own:
                resource_tracker.unregister(f"/{name}", "shared_memory")
    except OSError:
        return None
    if memory.size < SIZE:
        memory.close()
        return None
    box = Mailbox(memory, owner=False)
    if not box.valid:
        box.close()
        return None
    return box
