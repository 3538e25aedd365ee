"""``shm://name``: shared memory between two processes of one machine, without copies through the network.

A device has a mailbox for what it says (wrench or pose) and a platform one more for what it is told. A mailbox is 128 bytes that one
process writes and one reads: a magic number, the writer's lock count (odd while it writes: a sequence lock, after W. C. Hemminger's of
the Linux kernel), the number of the message, its time, a flag (status or stop), seven numbers and the CRC-32 of all of it, by which a
reader on a machine that reorders stores, or of memory that something else has written to, tells that it did not get a whole message. The
device makes the mailboxes and removes them.
"""

from __future__ import annotations

import math
import sys
import time
import zlib
from multiprocessing import resource_tracker, shared_memory
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hiltestbed.devices.interface import (
    Array,
    Clock,
    DeviceError,
    Event,
    Keeper,
    PlatformClient,
    PlatformServer,
    Protocol,
    Sample,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.errors import Fault, InputError
from hiltestbed.validation import Positive

MAGIC = 0x48544D424F580001
SIZE = 128  # [byte]
WORDS, NUMBERS = 6, 8  # magic, lock, number of the message, flag, CRC, spare; time and seven values
TRIES = 8  # reads before the next poll tries again
NAP = 20e-6  # [s] between two looks while waiting
STOP = 1
Part = Literal["wrench", "state", "command"]

_own: set[str] = set()  # names that this process has made


class ShmSettings(DeviceSettings):
    """Options of ``shm://``; the host is the name."""

    kind: Literal["shm"] = "shm"
    host: str = Field(default="hiltestbed", pattern=r"^[a-z0-9][a-z0-9_.-]{0,99}$", description="name of the shared memory")
    rate: Positive = Field(default=1000.0, description="messages a second [Hz]")
    clock: Literal["device", "host"] = Field(default="device", description="who paces the cycle: the device's messages, or the loop")
    connect: Positive = Field(default=2.0, description="[s] to wait for the device")


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
        """Leave a message of at most seven values."""
        lock = (int(self._words[1]) | 1) if int(self._words[1]) & 1 == 0 else int(self._words[1]) + 2
        self._words[1] = lock & 0xFFFFFFFFFFFFFFFF
        self._words[2], self._words[3] = number, flag
        self._numbers[0] = time
        self._numbers[1 : 1 + len(values)] = values
        self._numbers[1 + len(values) :] = 0.0
        self._words[4] = self._crc(int(self._words[2]), int(self._words[3]), self._numbers)
        self._words[1] = (lock + 1) & 0xFFFFFFFFFFFFFFFF

    def read(self) -> bool | None:
        """True for a message other than the last; False for none; None for one that is not whole however often it is read."""
        if int(self._words[2]) == self.number:
            return False
        for _ in range(TRIES):
            before = int(self._words[1])
            number, flag, crc = int(self._words[2]), int(self._words[3]), int(self._words[4])
            copy = self._numbers.copy()
            if before & 1 or int(self._words[1]) != before:
                continue
            if crc != self._crc(number, flag, copy) or not np.isfinite(copy).all():
                continue
            if number == self.number:
                return False
            self.number, self.flag, self.time = number, flag, float(copy[0])
            self.values[:] = copy[1:8]
            return True
        return None

    def _crc(self, number: int, flag: int, numbers: Array) -> int:
        head = number.to_bytes(8, "little") + flag.to_bytes(8, "little")
        return zlib.crc32(numbers.tobytes(), zlib.crc32(head))

    def close(self) -> None:
        del self._words, self._numbers
        self._memory.close()
        if self._owner:
            _own.discard(self._memory.name)
            self._memory.unlink()


def _name(settings: ShmSettings, part: Part) -> str:
    return f"{settings.host}.{part}"


def make(settings: ShmSettings, part: Part) -> Mailbox:
    """A new mailbox. Raises InputError where the name is taken."""
    name = _name(settings, part)
    try:
        return Mailbox(shared_memory.SharedMemory(name, create=True, size=SIZE), owner=True)
    except FileExistsError:
        message = f"the shared memory {name} is there already; stop the other device, remove what one has left, or give another name"
        raise InputError(Fault(settings.where, None, None, "", message)) from None
    except OSError as error:
        message = f"the shared memory {name} cannot be made ({error.strerror})"
        raise InputError(Fault(settings.where, None, None, "", message)) from None


def attach(settings: ShmSettings, part: Part) -> Mailbox | None:
    """The mailbox that the device has made; None where it has not."""
    name = _name(settings, part)
    try:
        if sys.version_info >= (3, 13):
            memory = shared_memory.SharedMemory(name, track=False)
        else:  # up to 3.12 a reader, too, would have it removed at its own end
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


def _awaited(settings: ShmSettings, part: Part) -> Mailbox:
    until = time.monotonic() + settings.connect
    while (box := attach(settings, part)) is None:
        if time.monotonic() > until:
            name = _name(settings, part)
            raise DeviceError(f"{settings.where}: there is no shared memory {name} after {settings.connect:g} s; start the device first")
        time.sleep(0.01)
    return box


class _Inbox:
    """Reads one mailbox, and counts."""

    def __init__(self, counts) -> None:
        self.box: Mailbox | None = None
        self.counts = counts
        self.sequence = Sequence(counts, bits=63)

    def open(self, box: Mailbox) -> None:
        self.box = box
        box.number = 0
        self.sequence.restart()

    def close(self) -> None:
        if self.box is not None:
            self.box.close()
            self.box = None

    def poll(self) -> bool:
        if self.box is None:
            return False
        found = self.box.read()
        if found is None:
            self.counts[Event.MALFORMED] += 1
        return bool(found) and self.sequence.judge(self.box.number)

    def note(self, sample: Sample) -> bool:
        if self.box is None:
            return False
        sample.status = self.box.flag
        if self.box.flag:
            self.counts[Event.STATUS] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        sample.sequence, sample.device_time, sample.arrival = self.box.number, self.box.time, time.monotonic_ns()
        return True


def _wait(link: SensorClient | PlatformClient | PlatformServer, timeout: float) -> bool:
    """Look again and again: memory does not wake anyone."""
    until = time.monotonic() + timeout
    while not link.poll():
        if time.monotonic() >= until:
            return False
        time.sleep(NAP)
    return True


class ShmSensorClient(SensorClient):
    """Reads the wrench that another process leaves."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._inbox = _Inbox(self.counts)

    def open(self) -> None:
        self._inbox.open(_awaited(self.settings, "wrench"))
        _first(self, self.settings)

    def close(self) -> None:
        self._inbox.close()

    def poll(self) -> bool:
        if not self._inbox.poll() or not self._inbox.note(self.reading):
            return False
        self.reading.wrench[:] = self._inbox.box.values[:6]  # type: ignore[union-attr]
        return True

    def wait(self, timeout: float) -> bool:
        return _wait(self, timeout)


class ShmPlatformClient(PlatformClient):
    """Leaves a pose for another process, and reads the one that it has reached."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.clock = Clock(settings.clock)
        self.period = 1.0 / settings.rate
        self._inbox = _Inbox(self.counts)
        self._outbox: Mailbox | None = None
        self._pose: Array = self.state.pose.copy()
        self._sent = 0

    def open(self) -> None:
        self._inbox.open(_awaited(self.settings, "state"))
        self._outbox = _awaited(self.settings, "command")
        self._sent = 0
        _first(self, self.settings)
        self._pose[:] = self.state.pose
        self.hold()

    def close(self) -> None:
        self._inbox.close()
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        if not self._inbox.poll() or not self._inbox.note(self.state):
            return False
        self.state.pose[:] = self._inbox.box.values  # type: ignore[union-attr]
        return True

    def wait(self, timeout: float) -> bool:
        return _wait(self, timeout)

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._pose[:] = pose
        self.hold()

    def hold(self) -> None:
        self._send(0)

    def stop(self) -> None:
        self._send(STOP)

    def _send(self, stop: int) -> None:
        self._sent += 1
        self.held[:7], self.held[7] = self._pose, self._sent
        if self._outbox is not None:
            self._outbox.write(self._pose, self._sent, time.monotonic_ns() * 1e-9, stop)


def _first(client: ShmSensorClient | ShmPlatformClient, settings: ShmSettings) -> None:
    if not client.wait(settings.connect):
        client.close()
        raise DeviceError(f"{settings.where}: the device is there, but has sent nothing in {settings.connect:g} s; start its run")


class ShmSensorServer(SensorServer):
    """Leaves a wrench for another process."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._outbox: Mailbox | None = None
        self._number = 0

    def open(self) -> None:
        self._outbox = make(self.settings, "wrench")

    def close(self) -> None:
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        """A sensor is told nothing."""
        return False

    def publish(self, wrench: Array, device_time: float, status: int = 0) -> None:
        self._number += 1
        if self._outbox is not None:
            self._outbox.write(wrench, self._number, device_time, status)


class ShmPlatformServer(PlatformServer):
    """A platform in another process."""

    def __init__(self, settings: ShmSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = 1.0 / settings.rate
        self._inbox = _Inbox(self.counts)
        self._outbox: Mailbox | None = None
        self._number = 0

    def open(self) -> None:
        self._outbox = make(self.settings, "state")
        try:
            self._inbox.open(make(self.settings, "command"))
        except InputError:
            self.close()
            raise

    def close(self) -> None:
        self._inbox.close()
        if self._outbox is not None:
            self._outbox.close()
            self._outbox = None

    def poll(self) -> bool:
        if not self._inbox.poll() or self._inbox.box is None:
            return False
        if self._inbox.box.flag:
            self.stopped = "the client asked for a stop"
        if self.stopped is not None:
            return False
        self.counts[Event.RECEIVED] += 1
        self.command[:] = self._inbox.box.values
        self.commanded = True
        return True

    def wait(self, timeout: float) -> bool:
        return _wait(self, timeout)

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        if self._number == 0:
            self.command[:] = pose
        self._number += 1
        self.poll()
        if self._outbox is not None:
            self._outbox.write(pose, self._number, device_time, status)


class ShmKeeper(Keeper):
    """Leaves the last pose, or the stop flag, in the mailbox of commands."""

    def __init__(self, settings: ShmSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._outbox = attach(settings, "command")
        self._sent = 0

    def hold(self, held: Array) -> None:
        self._send(held, 0)

    def stop(self, held: Array) -> None:
        self._send(held, STOP)

    def _send(self, held: Array, stop: int) -> None:
        self._sent += 1
        if self._outbox is not None and math.isfinite(float(held.sum())):
            self._outbox.write(held[:7], int(held[7]) + self._sent, time.monotonic_ns() * 1e-9, stop)


PROTOCOL = Protocol(
    scheme="shm",
    summary="shared memory between two processes of one machine",
    settings=ShmSettings,
    sensor_client=ShmSensorClient,
    platform_client=ShmPlatformClient,
    sensor_server=ShmSensorServer,
    platform_server=ShmPlatformServer,
    keeper=ShmKeeper,
)
