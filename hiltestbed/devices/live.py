"""The loop with real devices, for the command `live`, after a rehearsal without them. The sequence
of a run is in :mod:`hiltestbed.devices.session`.
"""

from __future__ import annotations

import time

from hiltestbed.devices.emulate import WARM_UP
from hiltestbed.devices.interface import PlatformClient, SensorClient
from hiltestbed.devices.pace import Pace
from hiltestbed.devices.section import Devices, MotionLimits
from hiltestbed.devices.session import Observed, Options, Session
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import Run

_UNWATCHED = Devices(limits=MotionLimits(**dict.fromkeys(MotionLimits.model_fields)), watchdog=None)


def live(scenario: Scenario, options: Options) -> Run | Observed:
    """Run ``scenario`` with devices; unarmed, only observe them.

    Raises:
        InputError, DeviceError: the devices cannot be connected, or their rate is not the
            scenario's. Later faults end in the run.
    """
    rehearse(scenario)
    session = Session(scenario, options)
    with session.connected():
        observed = session.observe()
        if options.armed:
            session.run()
    return session.result(observed) if options.armed else observed


class _PushedSensor(SensorClient):
    """A sensor that reads forces of some newtons."""

    def open(self) -> None: ...
    def close(self) -> None: ...

    def poll(self) -> bool:
        self.reading.sequence += 1
        self.reading.wrench[:] = 10.0 * (self.reading.sequence % 3 - 1)
        self.reading.arrival = time.monotonic_ns()
        return True


class _Follower(PlatformClient):
    """A platform that reaches every command exactly."""

    def open(self) -> None: ...
    def close(self) -> None: ...
    def hold(self) -> None: ...

    def poll(self) -> bool:
        self.state.sequence += 1
        self.state.arrival = time.monotonic_ns()
        return True

    def command(self, pose: Array) -> None:
        self._check(pose)
        self.state.pose[:] = pose


def rehearse(scenario: Scenario) -> None:
    """A complete run of :data:`WARM_UP` ticks with dummy devices, before real ones are opened:
    compiles all kernels that are not compiled yet.
    """
    short = scenario.model_copy(update={"duration": WARM_UP / scenario.rate, "devices": _UNWATCHED})
    dummies = _PushedSensor(DeviceSettings()), _Follower(DeviceSettings())
    options = Options("", "", armed=True, pace=lambda *_: Pace(), devices=dummies)
    session = Session(short, options)
    for dummy in dummies:
        dummy.poll()
    session.observe()
    session.run()
