"""``rsi://``: KUKA robots by RobotSensorInterface over UDP.

KUKA System Technology, "KUKA.RobotSensorInterface 3.2 for KUKA System Software 8.3" (KST RSI 3.2
V1), objects ETHERNET and POSCORR; "KUKA.Ethernet RSI XML 1.1" (KST Ethernet RSI XML 1.1 V1) for the
older controllers. The robot's controller initiates: each cycle (4 ms in IPO_FAST, 12 ms in IPO) it
sends, to the address in its configuration file,

    <Rob Type="KUKA"><RIst X="" Y="" Z="" A="" B="" C=""/> ... <Delay D=""/><IPOC>123</IPOC></Rob>

and expects, before the next cycle and with the same IPOC,

    <Sen Type="ImFree"><RKorr X="" Y="" Z="" A="" B="" C=""/><IPOC>123</IPOC></Sen>

RIst is the pose reached, RSol the set pose [mm, deg, A B C about z, y', x'']. RKorr is the
correction by POSCORR: an offset from the pose at which the correction began (absolute) or from the
last one (relative), in the axes of the base or of the tool. IPOC is the controller's clock [ms]. An
answer with another IPOC is late; Delay D counts such answers, and above the Timeout of the object
ETHERNET the controller ends the correction. With HOLDON = 1 the controller keeps the last
correction if none arrives in time: in relative mode the robot then repeats the last step, which is
why absolute is the default here.

If more than one of A, B, C of a correction is non-zero, the rotation of the tool is assumed to
follow the convention of frames: a rotation about the axes of the reference system. Check this with
small moves on the robot before use.
"""

from __future__ import annotations

import socket
from typing import ClassVar, Literal
from xml.etree import ElementTree

import numpy as np
from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices import plain_xml, poses, sockets
from hiltestbed.devices.interface import (
    FARTHEST,
    Array,
    DeviceError,
    Event,
    PlatformClient,
    PlatformServer,
    Protocol,
)
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.frames import pose_between, pose_compose, quat_mul, quat_mul_conj

LARGEST = 4096  # [byte] of a telegram
AXES = ("X", "Y", "Z", "A", "B", "C")
LARGEST_FRAME = np.repeat([1e3 * FARTHEST, 1e3], 3)  # [mm], [deg] plausible in a telegram
LONGEST_IPOC = 18  # digits


class RsiSettings(DeviceSettings):
    """Options of ``rsi://``. The address is the one to which the robot's controller sends: that of
    this machine in the robot's network.
    """

    default_port: ClassVar[int] = 59152

    period_ms: Literal[4, 12] = 4  # of the controller's cycle: IPO_FAST or IPO
    # reference of RKorr: the pose at which the correction began, or the last one
    correction: Literal["absolute", "relative"] = "absolute"
    reference: Literal["base", "tool"] = "base"  # axes of RKorr: RefCorrSys of the object POSCORR
    # SENTYPE of the configuration file
    sentype: str = Field(default="ImFree", max_length=40, pattern=r"^[A-Za-z0-9_.-]+$")
    robot: str | None = None  # address of the controller; None: the first that sends a telegram
    connect: Positive = 30.0  # [s] to wait for the controller's first telegram
    # late answers after which an emulated controller stops: Timeout of the object ETHERNET
    late_limit: int = Field(default=100, ge=0)
    hold: bool = True  # HOLDON: an emulated controller keeps the last correction if none arrives
    decimals: int = Field(default=6, ge=1, le=12)  # of the numbers in a telegram

    @property
    def period(self) -> float:
        return 1e-3 * self.period_ms

    @property
    def absolute(self) -> bool:
        return self.correction == "absolute"

    def offset(self, start: Array, pose: Array) -> Array:
        """The offset (7,) from ``start`` to ``pose``: in base axes, with the rotation about base
        axes through the moved point, or in the axes of ``start``.
        """
        out = np.empty(7)
        if self.reference == "tool":
            pose_between(start, pose, out)
        else:
            out[:3] = pose[:3] - start[:3]
            quat_mul_conj(pose[3:7], start[3:7], out[3:7])
        return out

    def add(self, start: Array, offset: Array) -> Array:
        """The pose (7,) at ``offset`` from ``start``; undoes :meth:`offset`."""
        out = np.empty(7)
        if self.reference == "tool":
            pose_compose(start, offset, out)
        else:
            out[:3] = start[:3] + offset[:3]
            quat_mul(offset[3:7], start[3:7], out[3:7])
        return out

    def frame(self, name: str, frame: Array) -> str:
        """The element with the frame (6,) [mm, deg]."""
        values = zip(AXES, frame.tolist(), strict=True)
        inside = " ".join(f'{axis}="{value:.{self.decimals}f}"' for axis, value in values)
        return f"<{name} {inside}/>"

    def answer(self, correction: Array, ipoc: int) -> bytes:
        """The telegram to the controller with the correction (6,) [mm, deg]."""
        inside = self.frame("RKorr", correction)
        return f'<Sen Type="{self.sentype}">{inside}<IPOC>{ipoc}</IPOC></Sen>'.encode("ascii")


class Odd(Exception):
    """A datagram is not a telegram; says why, and what to do about it."""


def read_telegram(data: bytes, root: str, element: str) -> tuple[ElementTree.Element, Array, int]:
    """A telegram with ``root``, the frame (6,) in ``element`` and its IPOC. Raises Odd."""
    try:
        message = plain_xml.read(data, LARGEST)
    except plain_xml.NotPlain:
        raise Odd(
            f"they are not plain XML of at most {LARGEST} bytes ({data[:20]!r}...); check what "
            f"sends to this port"
        ) from None
    if message.tag != root:
        raise Odd(f"their root is <{message.tag}>, not <{root}>; check what sends to this port")
    found = plain_xml.find(message, element)
    if found is None:
        have = ", ".join(part.tag for part in message.iter() if part is not message) or "nothing"
        raise Odd(
            f"they are without {element} (they hold {have}); add the tag DEF_{element}, type "
            f"DOUBLE, to SEND/ELEMENTS in the controller's configuration file"
        )
    try:
        frame = np.array([float(found.attrib[axis]) for axis in AXES])
    except (KeyError, ValueError):
        frame = np.full(6, np.nan)
    if not (np.abs(frame) <= LARGEST_FRAME).all():  # false for NaN
        given = " ".join(f'{k}="{v}"' for k, v in found.attrib.items())
        raise Odd(
            f"{element} has no six plausible numbers {' '.join(AXES)} (got {given[:120]!r}); check "
            f"the tag DEF_{element} of SEND/ELEMENTS in the controller's configuration file"
        )
    text = message.findtext(".//IPOC")
    ipoc = _count(text)
    if ipoc is None:
        raise Odd(f"IPOC is no whole number (got {text!r}); check what sends them")
    return message, frame, ipoc


def _count(text: str | None) -> int | None:
    """The non-negative integer in a text; None if the text is not one."""
    text = (text or "").strip()
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= LONGEST_IPOC else None


class RsiClient(sockets.Datagrams, PlatformClient):
    """Answers the controller's telegrams; the controller sets the clock, and every telegram from
    the first on requires an answer.

    Attributes:
        start: (7,) reference pose of absolute corrections: the robot's pose at the first telegram.
        delay: number of late answers that the controller has counted; -1 if it does not report it.
    """

    settings: RsiSettings
    _largest = LARGEST

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings)
        self.step = settings.period_ms
        self.delay = -1
        self.start: Array = self.state.pose.copy()
        self._from: Array = self.start.copy()  # reference pose of the next correction
        self._correction: Array = np.zeros(6)
        self._sequence = Sequence(self.counts, bits=64, step=settings.period_ms)
        self._robot: sockets.Address | None = None
        self._only: str | None = None
        self._answered, self._unanswered = True, 0
        self._odd = ""  # of the last malformed telegram: where it came from, and why it is one
        settings.offset(self.start, self.start)  # compile now, not in the first cycle

    def open(self) -> None:
        settings = self.settings
        if settings.robot is not None:
            self._only = sockets.resolve(settings.robot, 0, self.where)[0]
        own = sockets.resolve(settings.host, settings.port, self.where)
        self._socket = sockets.bound(own, self.where)
        self._robot, self._answered, self._unanswered, self.delay = None, True, 0, -1
        self._odd = ""
        self._sequence.restart()
        if not self.wait(settings.connect):
            self.close()
            others = int(self.counts[Event.SENDER])
            seen = f" ({others} datagrams of other senders than robot={self._only})" * (others > 0)
            silent = (
                f"no telegram of a robot in {settings.connect:g} s{seen}; check IP_NUMBER and PORT "
                f"in the controller's configuration file, and that its program has begun the "
                f"correction"
            )
            raise DeviceError(f"{self.where}: {self._odd or silent}")
        self.start[:] = self._from[:] = self.state.pose
        self._correction[:] = 0.0
        self.counts[:] = 0  # telegrams queued before the connection was open do not count
        self.hold()

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if self._only not in (None, sender[0]) or self._robot not in (None, sender):
            self.counts[Event.SENDER] += 1
            return False
        try:
            message, frame, ipoc = read_telegram(data, "Rob", "RIst")
        except Odd as odd:
            self.counts[Event.MALFORMED] += 1
            self._odd = f"telegrams arrive from {sender[0]}:{sender[1]}, but {odd}"
            return False
        lost = int(self.counts[Event.LOST])
        if not self._sequence.judge(ipoc):
            return False
        self._unanswered += int(self.counts[Event.LOST]) - lost
        if not self._answered:  # its time has passed
            self._unanswered += 1
            self.counts[Event.LATE] += 1
        self._robot, self._answered = sender, False
        late = plain_xml.find(message, "Delay")
        self._compare(None if late is None else _count(late.get("D")))
        pose = poses.pose_from_kuka(frame)
        return self.state.take(pose, self.counts, ipoc, 1e-3 * ipoc)

    def _compare(self, delay: int | None) -> None:
        """Count the answers that the controller reports as late, beyond those known to be late."""
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
        self._correction[:] = poses.kuka_from_pose(self.settings.offset(self._from, pose))
        if not self.settings.absolute:
            self._from[:] = pose
        self._answer()

    def hold(self) -> None:
        if not self.settings.absolute:
            self._correction[:] = 0.0
        self._answer()

    def stop(self) -> None:
        """Stop answering: after its Timeout the controller ends the correction and brakes."""
        self.close()

    def _answer(self) -> None:
        self.held[:6] = self._correction if self.settings.absolute else 0.0
        if self._socket is None or self._robot is None:
            raise DeviceError(f"{self.where}: is not open")
        if not self._answered:  # one answer per telegram
            answer = self.settings.answer(self._correction, self.state.sequence)
            self._send_to(answer, self._robot)
            self._answered = True

    def adopt(self, fileno: int) -> None:
        self._socket = socket.socket(fileno=fileno)

    def keep(self, held: Array, stop: bool) -> None:
        if not stop and self.wait(self.period):
            self._correction[:] = held[:6]
            self._answer()


class RsiServer(sockets.Datagrams, PlatformServer):
    """An emulated controller: :meth:`publish` begins a cycle, :meth:`poll` receives its answer
    until the next cycle; ``late`` counts late and missing answers.
    """

    FIRST_IPOC = 1_000_000
    settings: RsiSettings
    _largest = LARGEST

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings)
        self.late = 0
        self._towards: sockets.Address = (settings.host, settings.port)
        self._ipoc = self.FIRST_IPOC
        self._answered = True
        self._first: Array = self.command.copy()
        self._step: Array = self.command.copy()
        settings.add(self._first, self._step)  # compile now, not in the first cycle

    def open(self) -> None:
        self._towards = sockets.resolve(self.settings.host, self.settings.port, self.where)
        with sockets.connected_udp(self._towards, self.where) as probe:  # tells the interface
            self._socket = sockets.bound((probe.getsockname()[0], 0), self.where)

    def publish(self, pose: Array, device_time: float) -> None:
        if self._socket is None or self.stopped is not None:
            return
        self.poll()
        if not self._started:
            self._first[:] = pose
        elif not self._answered and self.commanded:
            self._missed()
        self._start(pose)
        self._ipoc += self.settings.period_ms
        self._answered = False
        reached, wanted = (
            self.settings.frame(name, poses.kuka_from_pose(value))
            for name, value in (("RIst", pose), ("RSol", self.command))
        )
        clock = f'<Delay D="{self.late}"/><IPOC>{self._ipoc}</IPOC>'
        text = f'<Rob Type="KUKA">{reached}{wanted}{clock}</Rob>'
        self._send_to(text.encode("ascii"), self._towards)

    def _missed(self) -> None:
        """Handle a cycle without an answer."""
        self.late += 1
        self.counts[Event.LATE] += 1
        if self.settings.hold and not self.settings.absolute:
            self.command[:] = self.settings.add(self.command, self._step)
        elif self.settings.absolute and not self.settings.hold:
            self.command[:] = self._first
        if self.late > self.settings.late_limit:
            self.stopped = (
                f"{self.late} answers came late or not at all (Timeout "
                f"{self.settings.late_limit}); the controller ends the correction"
            )

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if sender != self._towards:
            self.counts[Event.SENDER] += 1
            return False
        try:
            _, frame, ipoc = read_telegram(data, "Sen", "RKorr")
            if ipoc > self._ipoc:
                raise Odd
        except Odd:
            self.counts[Event.MALFORMED] += 1
            return False
        if ipoc < self._ipoc or self._answered:
            self.counts[Event.REORDERED if ipoc < self._ipoc else Event.REPEATED] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        self._answered = self.commanded = True
        self._step[:] = poses.pose_from_kuka(frame)
        base = self._first if self.settings.absolute else self.command
        self.command[:] = self.settings.add(base, self._step)
        return True


PROTOCOL = Protocol(
    scheme="rsi",
    summary="KUKA robots by RobotSensorInterface, UDP and XML",
    settings=RsiSettings,
    platform_client=RsiClient,
    platform_server=RsiServer,
)
