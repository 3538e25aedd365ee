"""``rsi://``: robots of KUKA by RobotSensorInterface over UDP.

KUKA System Technology, "KUKA.RobotSensorInterface 3.2 for KUKA System Software 8.3" (KST RSI 3.2 V1), objects ETHERNET and POSCORR;
"KUKA.Ethernet RSI XML 1.1" (KST Ethernet RSI XML 1.1 V1) for the older controllers. The robot's controller opens: each cycle (4 ms in
IPO_FAST, 12 ms in IPO) it sends, to the address in its configuration file,

    <Rob Type="KUKA"><RIst X="" Y="" Z="" A="" B="" C=""/><RSol .../><Delay D=""/><IPOC>123</IPOC></Rob>

and expects, before the next cycle and with the same IPOC,

    <Sen Type="ImFree"><RKorr X="" Y="" Z="" A="" B="" C=""/><IPOC>123</IPOC></Sen>

RIst is the pose reached, RSol the one set [mm, deg, A B C about z, y', x'']. RKorr is the correction by POSCORR: an offset from the
pose where the correction began (absolute) or from the last one (relative), in the axes of the base or of the tool. IPOC is the
controller's clock [ms]. An answer that comes with another IPOC is late; Delay D counts them, and past the Timeout of the object ETHERNET
the controller ends the correction. With HOLDON = 1 the controller keeps the last correction where none came in time: in relative mode
the robot goes on with the last step, which is why absolute is the default here.

How A, B, C of a correction turn the tool, where more than one of them is not zero, is taken from the convention of frames: a turn about
the axes of the reference system. Check it with small moves on the robot before use.
"""

from __future__ import annotations

import math
import socket
import time
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.devices import plain_xml, poses, sockets
from hiltestbed.devices.interface import (
    LONGEST_DRAIN,
    Array,
    Clock,
    DeviceError,
    Event,
    Keeper,
    PlatformClient,
    PlatformServer,
    Protocol,
)
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.validation import Positive

LARGEST = 4096  # [byte] of a telegram
AXES = ("X", "Y", "Z", "A", "B", "C")
FARTHEST, LARGEST_ANGLE = 1.0e6, 1.0e3  # [mm], [deg] a telegram that says more is not one
MILLISECOND = 1e-3  # [s]
LONGEST_IPOC = 18  # digits


class RsiSettings(DeviceSettings):
    """Options of ``rsi://``. The address is where the robot's controller sends to: that of this machine, as the robot sees it."""

    default_port: ClassVar[int] = 59152

    kind: Literal["rsi"] = "rsi"
    period_ms: Literal[4, 12] = Field(default=4, description="[ms] of the controller's cycle: 4 IPO_FAST, 12 IPO")
    correction: Literal["absolute", "relative"] = Field(
        default="absolute", description="what RKorr is measured from: where it began, or the last"
    )
    reference: Literal["base", "tool"] = Field(default="base", description="axes of the correction: RefCorrSys of the object POSCORR")
    sentype: str = Field(
        "ImFree", min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_.-]+$", description="SENTYPE of the configuration file"
    )
    robot: str | None = Field(default=None, description="address of the controller; the first that sends a telegram where it is not given")
    connect: Positive = Field(default=30.0, description="[s] to wait for the controller to open")
    late_limit: int = Field(
        default=100, ge=0, description="late answers after which an emulated controller stops: Timeout of the object ETHERNET"
    )
    hold: bool = Field(default=True, description="whether an emulated controller keeps the last correction where none came: HOLDON")
    decimals: int = Field(default=6, ge=1, le=12, description="of the numbers in a telegram")


def number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}"


def frame_element(name: str, frame: Array, decimals: int) -> str:
    """``<name X="" ... C=""/>``."""
    inside = " ".join(f'{axis}="{number(value, decimals)}"' for axis, value in zip(AXES, frame.tolist(), strict=True))
    return f"<{name} {inside}/>"


def answer(settings: RsiSettings, correction: Array, ipoc: int) -> bytes:
    """The telegram to the controller; ``correction`` (6,) [mm, deg]."""
    inside = frame_element("RKorr", correction, settings.decimals)
    return f'<Sen Type="{settings.sentype}">{inside}<IPOC>{ipoc}</IPOC></Sen>'.encode("ascii")


def read_frame(message: plain_xml.Message, name: str) -> Array | None:
    """The six numbers of an element; None where they are not six plausible numbers."""
    attributes = message.attributes.get(name)
    if attributes is None:
        return None
    try:
        frame = np.array([float(attributes[axis]) for axis in AXES])
    except (KeyError, ValueError):
        return None
    limits = (FARTHEST,) * 3 + (LARGEST_ANGLE,) * 3
    return frame if all(abs(value) <= limit for value, limit in zip(frame.tolist(), limits, strict=True)) else None  # NaN fails too


def read_count(text: str | None) -> int | None:
    """A whole number not below zero; None where the text is none."""
    text = (text or "").strip()
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= LONGEST_IPOC else None


class RsiClient(PlatformClient):
    """Answers the controller's telegrams; the controller sets the clock, and from the first telegram on each wants its answer.

    Attributes:
        start: (7,) the pose that absolute corrections are measured from: where the robot was found.
        delay: late answers that the controller has counted; -1 where it does not say.
    """

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = settings.period_ms * MILLISECOND
        self.clock = Clock.DEVICE
        self.start: Array = self.state.pose.copy()
        self.delay = -1
        self._from: Array = self.state.pose.copy()  # the pose that the next correction is measured from
        self._correction: Array = np.zeros(6)
        self._sequence = Sequence(self.counts, bits=64, step=settings.period_ms)
        self._robot: sockets.Address | None = None
        self._only: str | None = None
        self._answered, self._unanswered = True, 0
        self._offset = poses.offset_in_base if settings.reference == "base" else poses.offset_in_tool
        self._socket: socket.socket | None = None
        poses.pose_from_kuka(poses.kuka_from_pose(self._offset(self.start, self.start)))  # compiles: in the cycle there is no time for it

    def open(self) -> None:
        settings = self.settings
        if settings.robot is not None:
            self._only = sockets.resolve(settings.robot, 0, self.where)[0]
        self._socket = sockets.bound_udp(sockets.resolve(settings.host, settings.port, self.where), self.where)
        self._robot, self._answered, self._unanswered, self.delay = None, True, 0, -1
        self._sequence.restart()
        if not self.wait(settings.connect):
            self.close()
            raise DeviceError(
                f"{self.where}: no telegram of a robot in {settings.connect:g} s; check IP_NUMBER and PORT in the controller's "
                "configuration file, and that its program has begun the correction"
            )
        self.start[:] = self._from[:] = self.state.pose
        self._correction[:] = 0.0
        self.counts[:] = 0  # telegrams that had piled up before are nobody's fault
        self.hold()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def fileno(self) -> int:
        return self._socket.fileno() if self._socket is not None else -1

    def poll(self) -> bool:
        if self._socket is None:
            return False
        new = False
        for _ in range(LONGEST_DRAIN):
            try:
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except BlockingIOError:
                break
            except OSError:
                self.counts[Event.GONE] += 1
                break
            new = self._take(data, sender) or new
        return new

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if (self._only is not None and sender[0] != self._only) or (self._robot is not None and sender != self._robot):
            self.counts[Event.SENDER] += 1
            return False
        read = _telegram(data, "Rob", "RIst")
        if read is None:
            self.counts[Event.MALFORMED] += 1
            return False
        message, frame, ipoc = read
        lost = int(self.counts[Event.LOST])
        if not self._sequence.judge(ipoc):
            return False
        self._unanswered += int(self.counts[Event.LOST]) - lost
        if not self._answered:  # its time has passed
            self._unanswered += 1
            self.counts[Event.LATE] += 1
        self._robot, self._answered = sender, False
        self._compare(read_count(message.attributes.get("Delay", {}).get("D")))
        self.counts[Event.RECEIVED] += 1
        self.state.pose[:] = poses.pose_from_kuka(frame)
        self.state.sequence = ipoc
        self.state.device_time = ipoc * MILLISECOND
        self.state.arrival = time.monotonic_ns()
        return True

    def _compare(self, delay: int | None) -> None:
        """What the controller counts as late, beyond the telegrams that are known to have gone unanswered."""
        if delay is None:
            return
        if self.delay < 0:  # what was late before this connection
            self._unanswered = delay
        self.delay = delay
        if delay > self._unanswered:
            self.counts[Event.LATE] += delay - self._unanswered
            self._unanswered = delay

    def command(self, pose: Array) -> None:
        self._check(pose)
        self._correction[:] = poses.kuka_from_pose(self._offset(self._from, pose))
        if self.settings.correction == "relative":
            self._from[:] = pose
        self._send()

    def hold(self) -> None:
        if self.settings.correction == "relative":
            self._correction[:] = 0.0
        self._send()

    def stop(self) -> None:
        """Answer no more: past its Timeout the controller ends the correction and brakes."""
        self.close()

    def _send(self) -> None:
        self.held[:6] = self._correction if self.settings.correction == "absolute" else 0.0
        if self._socket is None or self._robot is None:
            raise DeviceError(f"{self.where}: is not open")
        if self._answered:  # one answer a telegram
            return
        try:
            self._socket.sendto(answer(self.settings, self._correction, self.state.sequence), self._robot)
        except OSError:
            self.counts[Event.GONE] += 1
        self._answered = True


def _telegram(data: bytes, root: str, element: str) -> tuple[plain_xml.Message, Array, int] | None:
    """A telegram with ``root``, the frame in ``element`` and its IPOC; None for anything else."""
    try:
        message = plain_xml.read(data, LARGEST)
    except plain_xml.NotPlain:
        return None
    frame, ipoc = read_frame(message, element), read_count(message.text.get("IPOC"))
    return None if message.root != root or frame is None or ipoc is None else (message, frame, ipoc)


class RsiServer(PlatformServer):
    """An emulated controller: :meth:`publish` opens a cycle, what :meth:`poll` takes in until the next one answers it.

    Attributes:
        late: answers that came late or not at all.
    """

    FIRST_IPOC = 1_000_000

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = settings.period_ms * MILLISECOND
        self.late = 0
        self._towards: sockets.Address = (settings.host, settings.port)
        self._ipoc = self.FIRST_IPOC
        self._started, self._answered = False, True
        self._start: Array = self.command.copy()
        self._step: Array = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self._add = poses.add_in_base if settings.reference == "base" else poses.add_in_tool
        self._socket: socket.socket | None = None

    def open(self) -> None:
        self._towards = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._socket = sockets.sending_udp(self._towards, self.where)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def publish(self, pose: Array, device_time: float, status: int = 0) -> None:
        if self._socket is None or self.stopped is not None:
            return
        self.poll()
        if not self._started:
            self.command[:] = self._start[:] = pose
            self._started = True
        elif not self._answered and self.commanded:
            self._missed()
        if status:
            self.stopped = f"the controller reports {status:#x}"
            return
        self._ipoc += self.settings.period_ms
        self._answered = False
        reached = frame_element("RIst", poses.kuka_from_pose(pose), self.settings.decimals)
        wanted = frame_element("RSol", poses.kuka_from_pose(self.command), self.settings.decimals)
        text = f'<Rob Type="KUKA">{reached}{wanted}<Delay D="{self.late}"/><IPOC>{self._ipoc}</IPOC></Rob>'
        try:
            self._socket.sendto(text.encode("ascii"), self._towards)
        except OSError:
            self.counts[Event.GONE] += 1

    def _missed(self) -> None:
        """No answer in the cycle that has passed."""
        self.late += 1
        self.counts[Event.LATE] += 1
        if self.settings.correction == "relative" and self.settings.hold:
            self.command[:] = self._add(self.command, self._step)
        elif self.settings.correction == "absolute" and not self.settings.hold:
            self.command[:] = self._start
        if self.late > self.settings.late_limit:
            self.stopped = (
                f"{self.late} answers came late or not at all (Timeout {self.settings.late_limit}); the controller ends the correction"
            )

    def fileno(self) -> int:
        return self._socket.fileno() if self._socket is not None else -1

    def poll(self) -> bool:
        if self._socket is None:
            return False
        new = False
        for _ in range(LONGEST_DRAIN):
            try:
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except BlockingIOError:
                break
            except OSError:  # nobody listens there yet
                self.counts[Event.GONE] += 1
                continue
            new = self._take(data, sender) or new
        return new

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if sender != self._towards:
            self.counts[Event.SENDER] += 1
            return False
        read = _telegram(data, "Sen", "RKorr")
        if read is None or read[2] > self._ipoc:
            self.counts[Event.MALFORMED] += 1
            return False
        _, frame, ipoc = read
        if ipoc < self._ipoc:
            self.counts[Event.REORDERED] += 1
            return False
        if self._answered:
            self.counts[Event.REPEATED] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        self._answered = self.commanded = True
        self._step[:] = poses.pose_from_kuka(frame)
        absolute = self.settings.correction == "absolute"
        self.command[:] = self._add(self._start if absolute else self.command, self._step)
        return True


class RsiKeeper(Keeper):
    """Answers each telegram with the correction held, from the socket that the loop has left."""

    def __init__(self, settings: RsiSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._settings = settings
        self._socket = sockets.adopted(fileno)

    def hold(self, held: Array) -> None:
        if not sockets.readable(self._socket, self._settings.period_ms * MILLISECOND):
            return
        newest: tuple[int, sockets.Address] | None = None
        for _ in range(LONGEST_DRAIN):
            try:
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except OSError:
                break
            read = _telegram(data, "Rob", "RIst")
            if read is not None:
                newest = read[2], sender
        if newest is not None and math.isfinite(float(held.sum())):
            self._socket.sendto(answer(self._settings, held[:6], newest[0]), newest[1])

    def stop(self, held: Array) -> None:
        """Silence: past its Timeout the controller ends the correction."""


PROTOCOL = Protocol(
    scheme="rsi",
    summary="KUKA robots by RobotSensorInterface, UDP and XML",
    settings=RsiSettings,
    platform_client=RsiClient,
    platform_server=RsiServer,
    keeper=RsiKeeper,
)
