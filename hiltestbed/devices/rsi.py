"""``rsi://``: KUKA robots by RobotSensorInterface over UDP.

KUKA System Technology, "KUKA.RobotSensorInterface 3.2 for KUKA System Software 8.3" (KST RSI 3.2
V1), objects ETHERNET and POSCORR; "KUKA.Ethernet RSI XML 1.1" (KST Ethernet RSI XML 1.1 V1) for the
older controllers. The robot's controller initiates: each cycle (4 ms in IPO_FAST, 12 ms in IPO) it
sends, to the address in its configuration file,

    <Rob Type="KUKA"><RIst X="" Y="" Z="" A="" B="" C=""/><RSol .../><Delay
    D=""/><IPOC>123</IPOC></Rob>

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
    Protocol,
)
from hiltestbed.devices.rsi_controller import RsiServer
from hiltestbed.devices.rsi_telegram import LARGEST, answer, oddity, read_count, read_telegram
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


class RsiClient(PlatformClient):
    """Answers the controller's telegrams; the controller sets the clock, and every telegram from
    the first on requires an answer.

    Attributes:
        start: (7,) reference pose of absolute corrections: the robot's pose at the first telegram.
        delay: number of late answers that the controller has counted; -1 if it does not report it.
    """

    def __init__(self, settings: RsiSettings) -> None:
        super().__init__(settings.where)
        self.settings = settings
        self.period = settings.period_ms * MILLISECOND
        self.step = settings.period_ms
        self.clock = Clock.DEVICE
        self.start: Array = self.state.pose.copy()
        self.delay = -1
        self._from: Array = self.state.pose.copy()  # reference pose of the next correction
        self._correction: Array = np.zeros(6)
        self._sequence = Sequence(self.counts, bits=64, step=settings.period_ms)
        self._robot: sockets.Address | None = None
        self._only: str | None = None
        self._answered, self._unanswered = True, 0
        self._offset = (
            poses.offset_in_base if settings.reference == "base" else poses.offset_in_tool
        )
        self._odd: tuple[bytes, sockets.Address] | None = None  # the last malformed telegram
        self._socket: socket.socket | None = None
        # compile now, not in the first cycle
        poses.pose_from_kuka(poses.kuka_from_pose(self._offset(self.start, self.start)))

    def open(self) -> None:
        settings = self.settings
        if settings.robot is not None:
            self._only = sockets.resolve(settings.robot, 0, self.where)[0]
        self._socket = sockets.bound_udp(
            sockets.resolve(settings.host, settings.port, self.where), self.where
        )
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

    def _silence(self) -> str:
        """Why there was no telegram of a robot."""
        if self._odd is None:
            others = int(self.counts[Event.SENDER])
            seen = f" ({others} datagrams of other senders than robot={self._only})" * (others > 0)
            return (
                f"no telegram of a robot in {self.settings.connect:g} s{seen}; check IP_NUMBER and "
                f"PORT in the controller's configuration file, and that its program has begun the "
                f"correction"
            )
        data, (address, port) = self._odd
        return f"telegrams arrive from {address}:{port}, but {oddity(data, 'Rob', 'RIst')}"

    def _take(self, data: bytes, sender: sockets.Address) -> bool:
        if (self._only is not None and sender[0] != self._only) or (
            self._robot is not None and sender != self._robot
        ):
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
        """Count the answers that the controller reports as late, beyond the telegrams known to be
        unanswered.
        """
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
        """Stop answering: after its Timeout the controller ends the correction and brakes."""
        self.close()

    def _send(self) -> None:
        self.held[:6] = self._correction if self.settings.correction == "absolute" else 0.0
        if self._socket is None or self._robot is None:
            raise DeviceError(f"{self.where}: is not open")
        if self._answered:  # one answer per telegram
            return
        try:
            self._socket.sendto(
                answer(
                    self.settings.sentype,
                    self._correction,
                    self.state.sequence,
                    self.settings.decimals,
                ),
                self._robot,
            )
        except OSError:
            self.counts[Event.GONE] += 1
        self._answered = True


class RsiKeeper(Keeper):
    """Answers each telegram with the held correction, on the socket duplicated from the loop."""

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
            read = read_telegram(data, "Rob", "RIst")
            if read is not None:
                newest = max(newest or (-1, sender), (read[2], sender))
        if newest is not None and math.isfinite(float(held.sum())):
            self._socket.sendto(
                answer(self._settings.sentype, held[:6], newest[0], self._settings.decimals),
                newest[1],
            )

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
