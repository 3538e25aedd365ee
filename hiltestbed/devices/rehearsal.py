"""A short run with dummy devices, before real ones are opened, which compiles all kernels that are
not compiled yet.
"""

from __future__ import annotations

import time

from hiltestbed.devices.interface import PlatformClient, SensorClient
from hiltestbed.devices.pace import AtOnce
from hiltestbed.devices.section import Devices, MotionLimits
from hiltestbed.devices.session import Options, Session
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario

TICKS = 64
_UNWATCHED = Devices(limits=MotionLimits(**dict.fromkeys(MotionLimits.model_fields)), watchdog=None)


class _PushedSensor(SensorClient):
    """A sensor that reads forces of some newtons."""

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def poll(self) -> bool:
        self.reading.sequence += 1
        self.reading.wrench[:] = 10.0 * (self.reading.sequence % 3 - 1)
        self.reading.arrival = time.monotonic_ns()
        return True


class _Follower(PlatformClient):
    """A platform that reaches every command exactly."""

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def poll(self) -> bool:
        self.state.sequence += 1
        self.state.arrival = time.monotonic_ns()
        return True

    def command(self, pose: Array) -> None:
        self._check(pose)
        self.state.pose[:] = pose

    def hold(self) -> None:
        pass


def rehearse(scenario: Scenario) -> None:
    """Make a complete run of :data:`TICKS` ticks."""
    short = scenario.model_copy(update={"duration": TICKS / scenario.rate, "devices": _UNWATCHED})
    session = Session(
        short,
        Options(
            "",
            "",
            armed=True,
            pace=lambda *_: AtOnce(),
            connect=lambda *_: (_PushedSensor("rehearsal"), _Follower("rehearsal")),
        ),
    )
    session.devices.sensor.poll()
    session.devices.platform.poll()
    session.observe()
    session.run()
