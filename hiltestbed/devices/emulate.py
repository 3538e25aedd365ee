"""The simulated physical side of a scenario behind the protocols of real devices, in real time.

In each cycle the rig moves to the pose that the controller has commanded since the last cycle, and
pose and wrench are published. A command that has not arrived in time counts as missed, and the
platform keeps the last one. The rig stands still until the first command.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from hiltestbed.devices.mounting import Mounting
from hiltestbed.devices.pace import CycleClock
from hiltestbed.devices.physical import SimulatedRig
from hiltestbed.devices.realtime import prepared
from hiltestbed.devices.table import platform_server, sensor_server, with_rate
from hiltestbed.devices.watch import said
from hiltestbed.scenario import Scenario

WARM_UP = 64  # ticks that are discarded; they compile the kernels that are not compiled yet


class Emulator:
    """Both devices of a scenario; a context manager that opens and closes them."""

    def __init__(self, scenario: Scenario, sensor_url: str, platform_url: str) -> None:
        """Raises InputError if a URL is wrong or its rate is not the scenario's."""
        self.scenario = scenario
        self.sensor = sensor_server(with_rate(sensor_url, scenario.rate, "--sensor"))
        self.platform = platform_server(with_rate(platform_url, scenario.rate, "--platform"))
        self.mounting = Mounting(scenario.devices)
        warm = SimulatedRig(scenario)
        for _ in range(WARM_UP):
            warm.step(warm.pose.copy())
        self.rig = SimulatedRig(scenario)
        self.cycles = self.missed = self._silent = 0
        self._wrench, self._pose, self._goal = np.zeros(6), np.zeros(7), self.rig.pose.copy()
        self._opened = ExitStack()

    def __enter__(self) -> Emulator:
        with ExitStack() as stack:
            stack.enter_context(self.sensor)
            stack.enter_context(self.platform)
            self._opened = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def cycle(self) -> None:
        """Read the commands, step the rig by one tick and publish its pose and wrench."""
        if self.cycles > 0:
            self.sensor.poll()
            new = self.platform.poll()
            if self.platform.commanded:
                self._silent += 1
                if new:  # the silence after the last command is the end of the run, not a miss
                    self.missed += self._silent - 1
                    self._silent = 0
                if self.platform.stopped is None:
                    self.mounting.pose_in_P(self.platform.command, self._goal)
            self.rig.step(self._goal)
        self.mounting.wrench_shown(self.rig.wrench, self._wrench)
        self.mounting.command_of(self.rig.pose, self._pose)
        now = self.cycles * self.rig.period
        self.sensor.publish(self._wrench, now)
        self.platform.publish(self._pose, now)
        self.cycles += 1


def emulate(
    scenario: Scenario,
    sensor_url: str,
    platform_url: str,
    seconds: float | None = None,
    cpu: int | None = None,
    ready: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """Emulate the devices for ``seconds``, or until Ctrl-C; ``ready`` is called when both are open.

    Returns ``cycles``, ``missed`` (without a command in time) and ``skipped``; why it ``ended``;
    the events of ``sensor`` and ``platform``.

    Raises:
        InputError: a URL is wrong. HiltestbedError: the rig diverged.
    """
    emulator = Emulator(scenario, sensor_url, platform_url)
    clock = CycleClock(scenario.rate, 1)
    ended = "the time was up"
    with prepared(cpu), emulator:
        if ready is not None:
            ready()
        until = None if seconds is None else time.monotonic() + seconds
        clock.start()
        try:
            while until is None or time.monotonic() < until:
                clock.wait()
                emulator.cycle()
        except KeyboardInterrupt:
            ended = "interrupted"
    if emulator.platform.stopped is not None:
        ended = f"{ended}; the platform had stopped: {emulator.platform.stopped}"
    counts = {"cycles": emulator.cycles, "missed": emulator.missed, "skipped": clock.skipped}
    events = {"sensor": said(emulator.sensor), "platform": said(emulator.platform)}
    return {**counts, "ended": ended, **events}
