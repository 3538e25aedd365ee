"""A robot controller of KUKA's RobotSensorInterface, written from its description and sharing
nothing.

The controller sends <Rob Type="KUKA"> with RIst [mm, deg] and IPOC, the sensor system answers <Sen
Type="ImFree"> with RKorr and the same IPOC before the next cycle. A, B, C turn about z, y', x''.
Rotations by SciPy, XML by ElementTree.
"""

from __future__ import annotations

import socket
import threading
import time
import xml.etree.ElementTree as ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

PERIOD = 0.004  # [s]


class IndependentRobot:
    """The controller: sends cycle after cycle from a thread and moves to start + correction, turned
    about the base axes.

    The next cycle begins when the answer has come, or after ``patience`` [s]: a robot that a busy
    machine can keep up with.
    """

    def __init__(self, port: int, relative=False, patience=PERIOD) -> None:
        self.towards = ("127.0.0.1", port)
        self.start_position = np.array([0.5, -0.2, 1.1])
        self.start_rotation = Rotation.from_euler("ZYX", [20.0, -35.0, 60.0], degrees=True)
        self.position, self.rotation = self.start_position.copy(), self.start_rotation
        self.relative, self.patience = relative, patience
        self.ipoc, self.late = 4_208_000_000, 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def telegram(self) -> bytes:
        frame = [*(1e3 * self.position), *self.rotation.as_euler("ZYX", degrees=True)]
        inside = " ".join(f'{n}="{v:.6f}"' for n, v in zip("XYZABC", frame, strict=True))
        body = (
            f'<RIst {inside}/><RSol {inside}/><Delay D="{self.late}"/><Tech C11="0.0" '
            f'C12="0.0"/><DiL>0</DiL>'
        )
        return f'<Rob TYPE="KUKA">\r\n{body}\r\n<IPOC>{self.ipoc}</IPOC></Rob>'.encode()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.ipoc += round(1e3 * PERIOD)
            self.socket.sendto(self.telegram(), self.towards)
            begun, answered = time.monotonic(), False
            while (left := begun + self.patience - time.monotonic()) > 0.0 and not answered:
                self.socket.settimeout(left)
                try:
                    answered = self._take(self.socket.recv(4096))
                except OSError:
                    continue
            time.sleep(max(begun + PERIOD - time.monotonic(), 0.0))

    def _take(self, data: bytes) -> bool:
        root = ElementTree.fromstring(data)
        assert root.tag == "Sen"
        assert root.get("Type") == "ImFree"
        korr = root.find("RKorr")
        frame = [float(korr.attrib[name]) for name in "XYZABC"]
        if int(root.findtext("IPOC", "")) != self.ipoc:
            self.late += 1
            return False
        shift = 1e-3 * np.array(frame[:3])
        turn = Rotation.from_euler("ZYX", frame[3:], degrees=True)
        if self.relative:
            self.position, self.rotation = self.position + shift, turn * self.rotation
        else:
            self.position, self.rotation = self.start_position + shift, turn * self.start_rotation
        return True

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.socket.close()
