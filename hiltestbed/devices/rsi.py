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

import math
import socket
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from hiltestbed.config.validation import Positive
from hiltestbed.devices import poses, sockets
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
from hiltestbed.devices.rsi_telegram import (
    LARGEST,
    answer,
    frame_element,
    oddity,
    read_count,
    read_telegram,
)
from hiltestbed.devices.sequence import Sequence
from hiltestbed.devices.url import DeviceSettings

MILLISECOND = 1e-3  # [s]


class RsiSettings(DeviceSettings):
    """Options of ``rsi://``. The address is the one to which the robot's controller sends: that of
    this machine in the robot's network.
    """

    default_port: ClassVar[int] = 59152

    kind: Literal["rsi"] = "rsi"
    period_ms: Literal[4, 12] = Field(
        default=4, description="cycle time of the controller [ms]: 4 IPO_FAST, 12 IPO"
    )
    correction: Literal["absolute", "relative"] = Field(
        default="absolute",
        description="reference of RKorr: the pose at which the correction began, or the last one",
    )
    reference: Literal["base", "tool"] = Field(
        default="base", description="axes of the correction: RefCorrSys of the object POSCORR"
    )
    sentype: str = Field(
        "ImFree",
        min_length=1,
        max_length=40,
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="SENTYPE of the configuration file",
    )
    robot: str | None = Field(
        default=None,
        description="address of the controller; by default the first that sends a telegram",
    )
    connect: Positive = Field(
        default=30.0, description="time to wait for the controller's first telegram [s]"
    )
    late_limit: int = Field(
        default=100,
        ge=0,
        description="number of late answers after which an emulated controller stops: Timeout of "
        "the object ETHERNET",
    )
    hold: bool = Field(
        default=True,
        description="whether an emulated controller keeps the last correction if none arrives: "
        "HOLDON",
    )
    decimals: int = Field(
        default=6, ge=1, le=12, description="decimals of the numbers in a telegram"
    )


class RsiClient(sockets.Datagrams, PlatformClient):
    """Answers the controller's telegrams; the controller sets the clock, and every telegram from
    the first on requires an answer.

    Attributes:
        start: (7,) reference pose of absolute corrections: the robot's pose at the first telegram.
        delay: number of late answers that the controller has counted; -1 if it does not report it.
    """

    _largest = LARGEST

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period, self.step = settings.period_ms * MILLISECOND, settings.period_ms
        self.clock = Clock.DEVICE
        self.delay = -1
        self.start: Array = self.state.pose.copy()
        self._from: Array = self.start.copy()  # reference pose of the next correction
        self._relative = settings.correction == "relative"
        self._correction: Array = np.zeros(6)
        self._sequence = Sequence(self.counts, bits=64, step=settings.period_ms)
        self._robot: sockets.Address | None = None
        self._only: str | None = None
        self._answered, self._unanswered = True, 0
        base = settings.reference == "base"
        self._offset = poses.offset_in_base if base else poses.offset_in_tool
        self._odd: tuple[bytes, sockets.Address] | None = None  # the last malformed telegram
        # compile now, not in the first cycle
        poses.pose_from_kuka(poses.kuka_from_pose(self._offset(self.start, self.start)))

    def open(self) -> None:
        settings = self.settings
        if settings.robot is not None:
            self._only = sockets.resolve(settings.robot, 0, self.where)[0]
        own = sockets.resolve(settings.host, settings.port, self.where)
        self._socket = sockets.bound_udp(own, self.where)
        self._robot, self._answered, self._unanswered, self.delay = None, True, 0, -1
        self._odd = None
        self._sequence.restart()
        if not self.wait(settings.connect):
            self.close()
            raise DeviceError(f"{self.where}: {self._silence()}")
        self.start[:] = self._from[:] = self.state.pose
        self._correction[:] = 0.0
        self.counts[:] = 0  # telegrams queued before the connection was open do not count
        self.hold()

    def _silence(self) -> str:
        """Why there was no telegram of a robot."""
        if self._odd is not None:
            data, (address, port) = self._odd
            return f"telegrams arrive from {address}:{port}, but {oddity(data, 'Rob', 'RIst')}"
        others = int(self.counts[Event.SENDER])
        seen = f" ({others} datagrams of other senders than robot={self._only})" * (others > 0)
        return (
            f"no telegram of a robot in {self.settings.connect:g} s{seen}; check IP_NUMBER and "
            f"PORT in the controller's configuration file, and that its program has begun the "
            f"correction"
        )

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if self._only not in (None, sender[0]) or self._robot not in (None, sender):
            self.counts[Event.SENDER] += 1
            return False
        read = read_telegram(data, "Rob", "RIst")
        if read is None:
            self.counts[Event.MALFORMED] += 1
            self._odd = data, sender
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
        pose = poses.pose_from_kuka(frame)
        return self.state.take(pose, self.counts, ipoc, ipoc * MILLISECOND)

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
        self._correction[:] = poses.kuka_from_pose(self._offset(self._from, pose))
        if self._relative:
            self._from[:] = pose
        self._answer()

    def hold(self) -> None:
        if self._relative:
            self._correction[:] = 0.0
        self._answer()

    def stop(self) -> None:
        """Stop answering: after its Timeout the controller ends the correction and brakes."""
        self.close()

    def _answer(self) -> None:
        self.held[:6] = 0.0 if self._relative else self._correction
        if self._socket is None or self._robot is None:
            raise DeviceError(f"{self.where}: is not open")
        if not self._answered:  # one answer per telegram
            self._send_to(
                _answer_to(self.state.sequence, self._correction, self.settings), self._robot
            )
            self._answered = True


def _answer_to(ipoc: int, correction: Array, settings: RsiSettings) -> bytes:
    return answer(settings.sentype, correction, ipoc, settings.decimals)


class RsiServer(sockets.Datagrams, PlatformServer):
    """An emulated controller: :meth:`publish` begins a cycle, :meth:`poll` receives its answer
    until the next cycle.

    Attributes:
        late: number of late or missing answers.
    """

    FIRST_IPOC = 1_000_000
    _largest = LARGEST

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = settings.period_ms * MILLISECOND
        self.late = 0
        self._absolute = settings.correction == "absolute"
        self._towards: sockets.Address = (settings.host, settings.port)
        self._ipoc = self.FIRST_IPOC
        self._started, self._answered = False, True
        self._start: Array = self.command.copy()
        self._step: Array = self.command.copy()
        self._add = poses.add_in_base if settings.reference == "base" else poses.add_in_tool
        # compile now, not in the first cycle
        poses.pose_from_kuka(poses.kuka_from_pose(self._add(self._start, self._step)))

    def open(self) -> None:
        self._towards = sockets.resolve(self.settings.host, self.settings.port, self.where)
        self._socket = sockets.sending_udp(self._towards, self.where)

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
        reached, wanted = (
            frame_element(name, poses.kuka_from_pose(value), self.settings.decimals)
            for name, value in (("RIst", pose), ("RSol", self.command))
        )
        clock = f'<Delay D="{self.late}"/><IPOC>{self._ipoc}</IPOC>'
        text = f'<Rob Type="KUKA">{reached}{wanted}{clock}</Rob>'
        self._send_to(text.encode("ascii"), self._towards)

    def _missed(self) -> None:
        """Handle a cycle without an answer."""
        self.late += 1
        self.counts[Event.LATE] += 1
        if self.settings.hold and not self._absolute:
            self.command[:] = self._add(self.command, self._step)
        elif self._absolute and not self.settings.hold:
            self.command[:] = self._start
        if self.late > self.settings.late_limit:
            self.stopped = (
                f"{self.late} answers came late or not at all (Timeout "
                f"{self.settings.late_limit}); the controller ends the correction"
            )

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if sender != self._towards:
            self.counts[Event.SENDER] += 1
            return False
        read = read_telegram(data, "Sen", "RKorr")
        if read is None or read[2] > self._ipoc:
            self.counts[Event.MALFORMED] += 1
            return False
        _, frame, ipoc = read
        if ipoc < self._ipoc or self._answered:
            self.counts[Event.REORDERED if ipoc < self._ipoc else Event.REPEATED] += 1
            return False
        self.counts[Event.RECEIVED] += 1
        self._answered = self.commanded = True
        self._step[:] = poses.pose_from_kuka(frame)
        self.command[:] = self._add(self._start if self._absolute else self.command, self._step)
        return True


class RsiKeeper(Keeper):
    """Answers each telegram with the held correction, on the socket duplicated from the loop."""

    def __init__(self, settings: RsiSettings, fileno: int) -> None:
        super().__init__(settings, fileno)
        self._settings = settings
        self._socket = socket.socket(fileno=fileno)

    def hold(self, held: Array) -> None:
        if not sockets.readable(self._socket, self._settings.period_ms * MILLISECOND):
            return
        newest: tuple[int, sockets.Address] | None = None
        for _ in range(LONGEST_DRAIN):
            try:
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except OSError:
                break
            read = read_telegram(data, "Rob", "RIst")
            if read is not None:
                newest = max(newest or (-1, sender), (read[2], sender))
        if newest is not None and math.isfinite(float(held.sum())):
            self._socket.sendto(_answer_to(newest[0], held[:6], self._settings), newest[1])

    def stop(self, held: Array) -> None:
        """Send nothing: after its Timeout the controller ends the correction."""


PROTOCOL = Protocol(
    scheme="rsi",
    summary="KUKA robots by RobotSensorInterface, UDP and XML",
    settings=RsiSettings,
    platform_client=RsiClient,
    platform_server=RsiServer,
    keeper=RsiKeeper,
)
