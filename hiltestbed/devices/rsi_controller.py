"""The controller's side of KUKA's RobotSensorInterface, for an emulated robot. Sources:
:mod:`hiltestbed.devices.rsi`.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.devices import poses, sockets
from hiltestbed.devices.interface import LONGEST_DRAIN, Array, Event, PlatformServer
from hiltestbed.devices.rsi_telegram import LARGEST, frame_element, read_telegram

if TYPE_CHECKING:
    from hiltestbed.devices.rsi import RsiSettings

MILLISECOND = 1e-3  # [s]


class RsiServer(PlatformServer):
    """An emulated controller: :meth:`publish` begins a cycle, :meth:`poll` receives its answer
    until the next cycle.

    Attributes:
        late: number of late or missing answers.
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
        # compile now, not in the first cycle
        poses.pose_from_kuka(poses.kuka_from_pose(self._add(self._start, self._step)))

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
        text = (
            f'<Rob Type="KUKA">{reached}{wanted}<Delay '
            f'D="{self.late}"/><IPOC>{self._ipoc}</IPOC></Rob>'
        )
        try:
            self._socket.sendto(text.encode("ascii"), self._towards)
        except OSError:
            self.counts[Event.GONE] += 1

    def _missed(self) -> None:
        """Handle a cycle without an answer."""
        self.late += 1
        self.counts[Event.LATE] += 1
        if self.settings.correction == "relative" and self.settings.hold:
            self.command[:] = self._add(self.command, self._step)
        elif self.settings.correction == "absolute" and not self.settings.hold:
            self.command[:] = self._start
        if self.late > self.settings.late_limit:
            self.stopped = (
                f"{self.late} answers came late or not at all (Timeout "
                f"{self.settings.late_limit}); the controller ends the correction"
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
        read = read_telegram(data, "Sen", "RKorr")
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
