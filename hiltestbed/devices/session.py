"""One run of the loop with two devices: connect, tare, wait, travel to the start, run, stop; the
result is a run like any other.

Nothing moves before it is armed. Any fault from then on ends the run with its reason, and the
platform is held, retracted or stopped as the scenario specifies. The trace is kept in memory that
is allocated before the first cycle, and written after the last; a separate process writes its rows
as they are produced, in case the loop's process dies.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.devices.interface import DeviceError, PlatformClient, SensorClient
from hiltestbed.devices.motion import run_down, run_up, travel
from hiltestbed.devices.pace import SECOND, Pace, SimulatedClock, WallClock, pace_of
from hiltestbed.devices.realtime import PATIENCE, Granted, prepared
from hiltestbed.devices.recorder import TraceRecorder
from hiltestbed.devices.side import Connected, DeviceRig
from hiltestbed.devices.table import platform_client, sensor_client, settings_of, with_rate
from hiltestbed.devices.watch import said
from hiltestbed.devices.watchdog import Watchdog
from hiltestbed.errors import HiltestbedError
from hiltestbed.frames import Array
from hiltestbed.loop import Loop
from hiltestbed.numerical_model.bodies import approach_state
from hiltestbed.scenario import Scenario
from hiltestbed.signals import CYCLE, Trace
from hiltestbed.simulation import (
    Run,
    collected,
    concluded,
    reference_fault,
    reference_scenario,
    simulate,
)

# [s] least time for which the devices are observed before the start, and longest, while their rate
# cannot be told
OBSERVED, LONGEST = 1.0, 10.0
RETRACT_RATE = math.radians(5.0)  # [rad/s] that of the default travel; the goal is not turned


@dataclass
class Options:
    """Options of a run with devices.

    Attributes:
        sensor, platform: URLs. armed: whether anything may move. cpu: processor to run on.
        record: file to which the rows are written as they are produced, in case the process dies.
        pace: creates the :class:`Pace` from sensor, platform and tick; for tests without a clock.
        clock: the wall clock; None: that of the machine, or with a pace of one's own the time that
            it tells. say: called with a message when the platform is about to move.
        devices: the clients themselves; None: those of the URLs.
    """

    sensor: str
    platform: str
    armed: bool = False
    cpu: int | None = None
    record: Path | None = None
    pace: Callable[[SensorClient, PlatformClient, float], Pace] = pace_of
    clock: WallClock | None = None
    say: Callable[[str], None] = lambda step: None
    devices: tuple[SensorClient, PlatformClient] | None = None


def clients(scenario: Scenario, options: Options) -> tuple[SensorClient, PlatformClient]:
    """The loop's sides of both devices, not yet open. Raises InputError."""
    if options.devices is not None:
        return options.devices
    sensor = options.sensor
    if not settings_of(sensor, "--sensor").device_tells_rate:
        sensor = with_rate(sensor, scenario.rate, "--sensor")
    platform = with_rate(options.platform, scenario.rate, "--platform")
    return sensor_client(sensor), platform_client(platform)


@dataclass
class Observed:
    """Observation of the devices while nothing moves.

    Attributes:
        pose, wrench, noise: pose (7,), reading (6,) and its standard deviation, in P.
        shown, shown_noise: (6,) the reading and its standard deviation in the sensor's own frame.
        rate: ticks a second by the wall clock [Hz]. counts: events so far.
        fault: why nothing may move; None if it may.
    """

    pose: Array
    wrench: Array
    noise: Array
    shown: Array
    shown_noise: Array
    rate: float
    counts: dict[str, dict[str, int]]
    fault: str | None


@dataclass
class Row:
    """A tick of a known motion: pose (7,) commanded for its end, pose (7,) of A in P reached now,
    reading (6,) in the sensor's own frame.
    """

    command: Array
    pose: Array
    shown: Array


class Session:
    """One run with two devices: everything is prepared before they are opened, since some require
    answers from then on.
    """

    def __init__(self, scenario: Scenario, options: Options) -> None:
        self.scenario, self.options, self.armed = scenario, options, options.armed
        self.devices = Connected(*clients(scenario, options))
        real = options.pace is pace_of
        self._now = options.clock or (WallClock() if real else SimulatedClock(self._told))
        self.rig = DeviceRig(scenario, self.devices, scenario.ticks + 1, self._now)
        self.loop = Loop([scenario], side=lambda *_: (self.rig, self.rig, self.rig))
        self.trace = Trace(scenario.ticks, 1, scenario.rate, self.rig.units)
        self.granted = Granted()
        self.recorder: TraceRecorder | None = None
        self.wall = 0.0
        self._start = approach_state(scenario.approach)
        self._to_send, self._zero = np.zeros((1, 7)), np.zeros((1, 6))

    @contextmanager
    def connected(self) -> Iterator[None]:
        """Context with both devices open, in a process prepared for real time."""
        devices, watchdog = self.devices, self.scenario.devices.watchdog
        with ExitStack() as stack:
            self.granted = stack.enter_context(prepared(self.options.cpu))
            stack.enter_context(devices.sensor)
            stack.enter_context(devices.platform)
            if self.armed and self.options.record is not None:
                self.recorder = TraceRecorder(self.trace, self.options.record)
                stack.callback(self.recorder.finish)
            devices.pace = self.options.pace(devices.sensor, devices.platform, self.scenario.tick)
            if self.armed and watchdog is not None:
                url = with_rate(self.options.platform, self.scenario.rate, "--platform")
                devices.watchdog = Watchdog(
                    url, devices.platform, watchdog.timeout, watchdog.action
                )
                stack.callback(devices.watchdog.close)
            yield

    def observe(self) -> Observed:
        """Observe the devices while the platform is held, tare the sensor, wait for the watchdog's
        process, and compare the rate of the clock with the scenario's: armed, another one raises
        DeviceError.
        """
        rig, rate, tare = self.rig, self.scenario.rate, self.scenario.devices.sensor.tare
        ticks = max(round(max(OBSERVED, tare) * rate), 2)
        readings, shown = np.zeros((2, ticks, 6))
        rig.watch()
        # by the wall clock, not by ticks
        observed, longest = (self._now() + round(s * SECOND) for s in (OBSERVED, LONGEST))
        for k in range(ticks):
            self._hold()
            readings[k], shown[k] = rig.reading[0], rig.shown
        wrench = readings.mean(axis=0)
        if tare > 0.0:
            rig.tare[:] = readings[-max(round(tare * rate), 2) :].mean(axis=0)
        until = time.monotonic() + PATIENCE
        watchdog = self.devices.watchdog
        while rig.stop is None and (
            self._now() < observed
            or (self._now() < longest and self.rig.time.is_right() is None)
            or (watchdog is not None and not watchdog.ready() and time.monotonic() < until)
        ):
            self._hold()
        if watchdog is not None and not watchdog.ready() and rig.stop is None:
            rig.stop = f"the watchdog did not start within {PATIENCE:g} s"
        refused = self._other_rate()
        if refused is not None and self.armed and rig.stop is None:
            raise DeviceError(refused)
        return Observed(
            pose=rig.pose_act[0].copy(),
            wrench=wrench,
            noise=readings.std(axis=0),
            shown=shown.mean(axis=0),
            shown_noise=shown.std(axis=0),
            rate=rig.time.rate,
            counts=self._counts(),
            fault=refused or rig.stop,
        )

    def _told(self) -> float:
        return self.devices.pace.told() * self.scenario.tick

    def _other_rate(self) -> str | None:
        """Why the rate of the clock is not that of the scenario; None if it is."""
        if self.rig.time.is_right():
            return None
        factor, pace = self.rig.time.factor, self.devices.pace
        return (
            f"{pace.source}: sets the clock, and by the wall clock it runs at "
            f"{self.rig.time.rate:.5g} ticks a second; the scenario's rate is "
            f"{self.scenario.rate:g} Hz: the platform would move {factor:.4g} times as fast as the "
            f"model. Nothing was moved; {pace.advice(factor)}"
        )

    def run(self) -> None:
        """Arm, travel, run, stop."""
        self.guarded(self._run)
        if self.loop.k == 0 and self.rig.stop is not None:
            self.loop.trouble[0] = (0, "stopped", f"before the start: {self.rig.stop}")

    def guarded(self, work: Callable[[], None]) -> None:
        """Arm, do ``work``, and bring the platform to rest whatever happens; ``rig.stop`` says why
        it was stopped.
        """
        rig = self.rig
        try:
            self.options.say("armed: the platform moves from now on")
            rig.arm()
            work()
        except KeyboardInterrupt:
            rig.stop = "interrupted"
        # a device that refuses is a reason to stop, not to lose the run
        except (HiltestbedError, OSError) as error:
            rig.stop = str(error)
        finally:
            reason = rig.stop
            self._end()
            rig.stop = reason
            if reason is not None and not self.loop.trouble:
                self.loop.trouble[0] = (self.loop.k, "stopped", reason)

    def _run(self) -> None:
        if not self._approach():
            return
        self.rig.log.k, self.rig.log.rows[:] = 0, 0.0
        self.rig.missed, self.rig.late_work = 0, 0.0
        began = time.perf_counter()
        try:
            while self.loop.k < self.scenario.ticks and self.loop.alive[0]:
                self.loop.step(self.trace)
                if self.recorder is not None:
                    self.recorder.push_tick(self.loop.k - 1)
        finally:
            self.wall = time.perf_counter() - began

    def _approach(self) -> bool:
        """Travel to the start of the run-up, and accelerate to the approach velocity."""
        duration = self.scenario.devices.platform.run_up
        way = run_up(self._start[:7], self._start[7:], self.rig.tick, duration)
        rest = next(way)
        return self.travel(rest) and self.follow(chain([rest], way))

    def travel(self, goal: Array) -> bool:
        """Travel to rest at ``goal`` (7,); False if stopped."""
        settings = self.scenario.devices.platform
        speed, rate = settings.travel_speed, np.radians(settings.travel_rate_deg)
        return self.follow(travel(self.rig.last.copy(), goal, self.rig.tick, speed, rate))

    def _end(self) -> None:
        """Bring the platform to rest: smoothly after a whole run, else as the scenario says."""
        rig, duration = self.rig, self.scenario.devices.platform.run_up
        try:
            if rig.stop is not None or self.loop.trouble:
                self._stop()
                return
            twist = self.loop.drive.twist[0].copy() if self.loop.k > 0 else np.zeros(6)
            if self.follow(run_down(rig.last.copy(), twist, rig.tick, duration)):
                self._hold()
            else:
                self.devices.platform.hold()
        except (HiltestbedError, OSError, KeyboardInterrupt):
            pass  # nothing more can be commanded; the device's own limits and the watchdog remain
        finally:
            if self.devices.watchdog is not None:
                self.devices.watchdog.disarm()

    def _stop(self) -> None:
        settings, rig, platform = self.scenario.devices.on_stop, self.rig, self.devices.platform
        if settings.kind == "stop":
            platform.stop()
            return
        platform.hold()
        if settings.kind == "retract":
            goal = rig.last.copy()
            goal[2] -= settings.distance
            rig.guard.start(rig.last)
            way = travel(rig.last.copy(), goal, rig.tick, settings.speed, RETRACT_RATE)
            self.follow(way, tolerant=True)
        rig.armed = False
        for _ in range(2):
            self._hold()

    def follow(
        self, poses: Iterable[Array], tolerant: bool = False, rows: list[Row] | None = None
    ) -> bool:
        """Command ``poses`` (7,), one per tick; False if stopped. ``rows`` receives the readings of
        each tick and the command sent from them. ``tolerant``, for the retraction after a stop:
        only guard and wall clock can stop it.
        """
        rig = self.rig
        for pose in poses:
            self._to_send[0] = pose
            if tolerant:
                rig.stop = rig.time.fault
            if rows is not None:
                rows.append(Row(pose, rig.pose_act[0].copy(), rig.shown.copy()))
            rig.begin(self._to_send, self._zero, self._zero)
            if rig.stop is not None:
                return False
            rig.finish()
        return rig.stop is None

    def _hold(self) -> None:
        armed, self.rig.armed = self.rig.armed, False
        self.rig.begin(self._to_send, self._zero, self._zero)
        self.rig.finish()
        self.rig.armed = armed

    def _counts(self) -> dict[str, dict[str, int]]:
        return {"sensor": said(self.devices.sensor), "platform": said(self.devices.platform)}

    def result(self, observed: Observed) -> Run:
        """The result, with its reference."""
        loop, rig = self.loop, self.rig
        rows = self.trace
        rows.length[:] = min(loop.k, self.scenario.ticks)
        for i, (k, *_) in loop.trouble.items():
            rows.length[i] = min(k + 1, self.scenario.ticks) if loop.k > 0 else 0
        rows.data["wrench_true"][:] = np.nan  # no device measures it
        rows.data[CYCLE.name] = rig.log.rows[: self.scenario.ticks, None, :]
        reference = simulate([reference_scenario(self.scenario)], until_parted=True)
        batch, fault = collected(loop, rows, self.wall, {}), reference_fault(reference, 0)
        run = concluded(batch, reference.figures[0], fault, 0)
        run.summary["energy_generated"] += rig.late_work
        run.summary["live"] = self._report(observed, int(rows.length[0]))
        run.summary = _written(run.summary)
        return run

    def _report(self, observed: Observed, rows: int) -> dict[str, Any]:
        late = np.abs(self.rig.log.rows[1:rows, 0] - self.rig.tick) if rows > 1 else np.zeros(1)
        busy = self.rig.log.rows[:rows, 1] if rows else np.zeros(1)
        return {
            "sensor": self.devices.sensor.where,
            "platform": self.devices.platform.where,
            "clock": self.devices.pace.source,
            "rate": observed.rate,
            "time_offset": self.rig.time.worst,
            "cycles": rows,
            "missed": int(self.rig.missed),
            "jitter": _spread(late),
            "busy": _spread(busy),
            "tare": self.rig.tare.tolist(),
            "noise": observed.noise.tolist(),
            "events": self._counts(),
            "granted": self.granted.granted,
            "refused": self.granted.refused,
        }


def _spread(times: Array) -> dict[str, float]:
    p99 = float(np.percentile(times, 99))
    return {"median": float(np.median(times)), "p99": p99, "worst": float(times.max())}


def _written(value: Any) -> Any:
    """``value`` as it can be written as JSON: None for a number that is not finite."""
    if isinstance(value, dict):
        return {key: _written(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_written(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
