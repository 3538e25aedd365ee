"""A few ticks of the whole loop against devices that stand still, before real ones are opened: what is not compiled is compiled then."""

from __future__ import annotations

import time

import numpy as np

from hiltestbed.devices.interface import PlatformClient, SensorClient
from hiltestbed.devices.side import Connected, DeviceRig, side_of
from hiltestbed.frames import Array
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.scenario import Scenario
from hiltestbed.signals import Trace

TICKS = 64


class _StillSensor(SensorClient):
    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def poll(self) -> bool:
        self.reading.sequence += 1
        self.reading.arrival = time.monotonic_ns()
        return True


class _StillPlatform(PlatformClient):
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

    def hold(self) -> None:
        pass


def rehearse(scenario: Scenario) -> None:
    """Run :data:`TICKS` ticks of the loop of ``scenario`` with forces of some newtons."""
    free = scenario.model_copy(update={"safety": type(scenario.safety)(**dict.fromkeys(type(scenario.safety).model_fields))})
    sensor, platform = _StillSensor("rehearsal"), _StillPlatform("rehearsal")
    rig = DeviceRig(free, Connected(sensor, platform), TICKS)
    loop = Loop([free], side=side_of(rig))
    trace = Trace(TICKS, 1, free.rate)
    state = approach_state(free)
    platform.state.pose[:] = state[:7]
    rig.watch()
    rig.arm()
    for k in range(TICKS):
        sensor.reading.wrench[:] = 10.0 * np.sin(np.pi * k / TICKS)
        platform.state.pose[2] += state[9] * free.tick
        loop.step(trace)
