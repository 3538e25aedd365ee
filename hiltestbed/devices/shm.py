"""``shm://name``: shared memory between two processes of one machine, without the network stack.

A device writes a mailbox with its wrench or pose; a platform reads a second one with the command.
The device creates and removes them. A mailbox holds the newest message of one process for another,
complete or not at all: 128 bytes that one process writes and one reads, a magic number, a sequence
lock (the count is odd while the writer is active; as in the Linux kernel), the number of the
message, its time, a flag, seven numbers and their CRC-32. The CRC detects incomplete messages on
machines that reorder stores, and foreign writes.
"""

from __future__ import annotations

import math
import sys
import time
import zlib
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hiltestbed.devices.interface import (
    Array,
    Client,
    DeviceError,
    Event,
    Link,
    Protocol,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.sequence import NumberedClient, NumberedServer, Sequence
from hiltestbed.devices.url import PacedSettings, refused
from hiltestbed.errors import InputError

MAGIC = 0x48544D424F580001
SIZE = 128  # [byte]
WORDS, NUMBERS = 6, 8  # magic, lock, number of the message, flag, CRC, spare; time and seven values
TRIES = 8  # reads before the next poll tries again
NAP = 20e-6  # [s] between two polls while waiting
Part = Literal["wrench", "state", "command"]

_own: set[str] = set()  # names created by this process


class Mailbox:
    """One writer, one reader; ``values`` (7,), number, time and flag of the message last read."""

    def __init__(self, memory: SharedMemory, owner: bool) -> None:
        self._memory, self._owner = memory, owner
        self._words: NDArray[np.uint64] = np.ndarray(WORDS, np.uint64, memory.buf)
        self._numbers: Array = np.ndarray(NUMBERS, np.float64, memory.buf, 8 * WORDS)
        self.values: Array = np.zeros(7)
        self.number, self.time, self.flag = 0, math.nan, 0
        if owner:
            _own.add(memory.name)
            self._words[:] = 0
            self._words[0] = MAGIC

    def write(self, values: Array, number: int, time: float, flag: int) -> None:
        """Write a message of at most seven values."""
        lock = int(self._words[1])
        lock += 2 if lock & 1 else 1
        self._words[1] = lock & 0xFFFFFFFFFFFFFFFF
        self._words[2], self._words[3] = number, flag
        self._numbers[0] = time
        self._numbers[1 : 1 + len(values)] = values
        self._numbers[1 + len(values) :] = 0.0
        self._words[4] = self._crc(int(self._words[2]), int(self._words[3]), self._numbers)
        self._words[1] = (lock + 1) & 0xFFFFFFFFFFFFFFFF

    def read(self) -> bool | None:
        """True for a new message; False for none, or one being written; None for a damaged one."""
        if int(self._words[2]) == self.number:
            return False
        damaged = False
        for _ in range(TRIES):
            lock, number, flag, crc = map(int, self._words[1:5])
            copy = self._numbers.copy()
            complete = lock % 2 == 0 and int(self._words[1]) == lock  # no write was active
            whole = crc == self._crc(number, flag, copy) and np.isfinite(copy).all()
            if complete and whole:
                self.number, self.flag, self.time = number, flag, float(copy[0])
                self.values[:] = copy[1:]
                return True
            damaged = complete
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
    """Create a mailbox of the device ``where``. Raises InputError if the name is taken."""
    try:
        return Mailbox(SharedMemory(name, create=True, size=SIZE), owner=True)
    except FileExistsError:
        message = (
            f"the shared memory {name} is there already; stop the other device, "
            f"remove what one has left, or give another name"
        )
    except OSError as error:
        message = f"the shared memory {name} cannot be made ({error.strerror})"
    raise refused(where, message)


def attach(name: str) -> Mailbox | None:
    """Attach to the mailbox that the device has created; None if there is none."""
    try:
        if sys.version_info >= (3, 13):
            memory = SharedMemory(name, track=False)
        else:  # where the process that attaches, too, would remove it at its exit
            memory = SharedMemory(name)
            if name not in _own:
                resource_tracker.unregister(f"/{name}", "shared_memory")
    except OSError:
        return None
    if memory.size < SIZE or np.ndarray(1, np.uint64, memory.buf)[0] != MAGIC:
        memory.close()
        return None
    return Mailbox(memory, owner=False)


class ShmSettings(PacedSettings):
    """Options of ``shm://``; the host part of the URL is the name."""

    host: str = Field(default="hiltestbed", pattern=r"^[a-z0-9][a-z0-9_.-]{0,99}$")


class _Mailboxes(Link):
    """A link by one mailbox to read, or to write, or both."""

    settings: ShmSettings
    _inbox: Mailbox | None = None
    _outbox: Mailbox | None = None

    def close(self) -> None:
        for box in (self._inbox, self._outbox):
            if box is not None:
                box.close()
        self._inbox = self._outbox = None

    def wait(self, timeout: float, expected: float = math.inf) -> bool:
        """Poll until there is a message: shared memory has no wake-up."""
        until = time.monotonic() + timeout
        while not self.poll():
            if time.monotonic() >= until:
                return False
            time.sleep(NAP)
        return True

    def poll(self) -> bool:
        box = self._inbox
        found = False if box is None else box.read()
        if found is None:
            self.counts[Event.MALFORMED] += 1
        new = box is not None and found and self._sequence.judge(box.number)
        return self._accept(box) if box is not None and new else False

    def _accept(self, box: Mailbox) -> bool:
        """Take in a new message. A sensor's device receives none."""
        return False

    def _read_from(self, box: Mailbox) -> None:
        self._inbox = box
        # no limit: a mailbox keeps only the newest message
        self._sequence = Sequence(self.counts, bits=63, longest_gap=1 << 61)

    def _made(self, part: Part) -> Mailbox:
        return make(f"{self.settings.host}.{part}", self.where)

    def _write(self, values: Array, number: int, device_time: float, flag: int = 0) -> None:
        if self._outbox is not None:
            self._outbox.write(values, number, device_time, flag)


class _ShmClient(_Mailboxes, Client):
    def _accept(self, box: Mailbox) -> bool:
        values = box.values[: len(self.sample.values)]
        return self.sample.take(values, self.counts, box.number, box.time, box.flag)

    def _open(self, inbox: Part, outbox: Part | None = None) -> None:
        """Attach to the device's mailboxes and wait for its first message."""
        self._read_from(self._awaited(inbox))
        self._outbox = self._awaited(outbox) if outbox is not None else None
        if not self.wait(self.settings.connect):
            self.close()
            raise DeviceError(
                f"{self.where}: the device is there, but has sent nothing in "
                f"{self.settings.connect:g} s; start its run"
            )

    def _awaited(self, part: Part) -> Mailbox:
        until, name = time.monotonic() + self.settings.connect, f"{self.settings.host}.{part}"
        while (box := attach(name)) is None:
            if time.monotonic() > until:
                raise DeviceError(
                    f"{self.where}: there is no shared memory {name} after "
                    f"{self.settings.connect:g} s; start the device first"
                )
            time.sleep(0.01)
        return box


class ShmSensorClient(_ShmClient, SensorClient):
    """Reads the wrench that another process writes."""

    def open(self) -> None:
        self._open("wrench")


class ShmPlatformClient(_ShmClient, NumberedClient):
    """Writes the commanded pose for another process and reads the pose reached."""

    def open(self) -> None:
        self._open("state", "command")
        self._begin()

    def adopt(self, fileno: int) -> None:
        self._outbox = attach(f"{self.settings.host}.command")

    def _post(self, pose: Array, number: int, now: float, stop: int) -> None:
        self._write(pose, number, now, stop)


class ShmSensorServer(_Mailboxes, SensorServer):
    """Writes a wrench for another process."""

    _number = 0

    def open(self) -> None:
        self._outbox = self._made("wrench")

    def publish(self, wrench: Array, device_time: float) -> None:
        self._number += 1
        self._write(wrench, self._number, device_time)


class ShmPlatformServer(_Mailboxes, NumberedServer):
    """A platform for a loop in another process."""

    def open(self) -> None:
        self._outbox = self._made("state")
        try:
            self._read_from(self._made("command"))
        except InputError:
            self.close()
            raise

    def _accept(self, box: Mailbox) -> bool:
        return self._commanded(box.values, box.flag)

    def _report(self, pose: Array, number: int, device_time: float) -> None:
        self._write(pose, number, device_time)


PROTOCOL = Protocol(
    scheme="shm",
    summary="shared memory between two processes of one machine",
    settings=ShmSettings,
    sensor_client=ShmSensorClient,
    platform_client=ShmPlatformClient,
    sensor_server=ShmSensorServer,
    platform_server=ShmPlatformServer,
)
