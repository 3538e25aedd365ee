"""The physical side made of real devices, in place of the simulated rig and its sensor.

A tick, at t_k: the wrench and the pose at t_k have arrived; ``begin`` sends the pose for t_(k+1),
``finish`` waits for the records of t_(k+1). Every command passes the guard, and after a fault only
the stop behaviour is sent. Nothing is commanded before :meth:`DeviceRig.arm`: until then the
platform is held.

None of the protocols transmits the switches of a latch: capture is detected from a pulling force,
which a contact alone cannot exert.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.build import monitor
from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.phases import Phases
from hiltestbed.devices.interface import PlatformClient, SensorClient
from hiltestbed.devices.mounting import Mounting
from hiltestbed.devices.pace import SECOND, Pace, Timekeeper, WallClock
from hiltestbed.devices.section import MotionLimits
from hiltestbed.devices.watch import CommunicationWatch
from hiltestbed.devices.watchdog import Watchdog
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, rotation_vector, twist_between
from hiltestbed.scenario import Scenario
from hiltestbed.supervision.safety import LIMITS

GATE_SIGMA = 5.0  # a force above this many standard deviations of its noise counts as contact
LEAST_FORCE = 0.5  # [N] the same threshold if the scenario has no noise
# of the scenario's limits: readings before the tare contain the weight of a tool, and a platform
# may stand away from the rig; a value beyond this multiple is not physical
HEADROOM = 10.0
DRAINS = 100  # polls, each of up to LONGEST_DRAIN datagrams: several seconds of any sensor


_SAID = (
    ("position", "A is commanded {value:.4g} m from the nominal touch", "m"),
    ("angle_deg", "A is commanded to turn by {value:.4g} deg", "deg"),
    ("speed", "A is commanded to move at {value:.4g} m/s", "m/s"),
    ("rate_deg", "A is commanded to turn at {value:.4g} deg/s", "deg/s"),
    ("acceleration", "A is commanded to accelerate at {value:.4g} m/s^2", "m/s^2"),
)


class Guard:
    """The last check of each pose (7,) of A in P before it is sent, one per ``tick`` [s]: finite,
    and within the limits of position, speed and acceleration.
    """

    def __init__(self, limits: MotionLimits, tick: float) -> None:
        self._tick = tick
        given = [getattr(limits, name) for name, *_ in _SAID]
        self._limits = np.array([math.inf if limit is None else limit for limit in given])
        self._quantities = np.zeros(len(_SAID))
        self._before, self._twist = np.zeros(7), np.zeros(6)
        self.start(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
        self.refusal(self._before)  # compile now, not in the first cycle

    def start(self, pose: Array) -> None:
        """Start from rest at ``pose`` (7,)."""
        self._before[:], self._twist[:] = pose, 0.0

    def refusal(self, pose: Array) -> str | None:
        """Why ``pose`` (7,) must not be sent; None if it may be, and it then counts as sent."""
        if _within(pose, self._before, self._twist, self._tick, self._limits, self._quantities):
            return None
        if not np.isfinite(pose).all():
            return f"a pose that is not finite was commanded ({pose})"
        i = int(np.argmax(self._quantities > self._limits))
        name, text, unit = _SAID[i]
        return (
            f"{text.format(value=self._quantities[i])}; devices.limits.{name} is "
            f"{self._limits[i]:g} {unit}"
        )


@njit(cache=True)
def _within(pose, before, twist, tick, limits, q):
    slope, turn = np.empty(6), np.empty(3)
    twist_between(before, pose, tick, slope)
    rotation_vector(pose[3:7], turn)
    q[0] = max(abs(pose[0]), abs(pose[1]), abs(pose[2]))
    q[1] = math.degrees(math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2))
    q[2] = math.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2)
    q[3] = math.degrees(math.sqrt(slope[3] ** 2 + slope[4] ** 2 + slope[5] ** 2))
    q[4] = (
        math.sqrt(
            (slope[0] - twist[0]) ** 2 + (slope[1] - twist[1]) ** 2 + (slope[2] - twist[2]) ** 2
        )
        / tick
    )
    for i in range(q.shape[0]):
        if not q[i] <= limits[i]:  # true for NaN as well
            return False
    copied(pose, before)
    copied(slope, twist)
    return True


@dataclass
class Connected:
    """Two devices, the pace of the loop once they are open, and the loop's watchdog process."""

    sensor: SensorClient
    platform: PlatformClient
    pace: Pace = field(default_factory=Pace)
    watchdog: Watchdog | None = None


class CycleLog:
    """Times of the cycles: rows ``(capacity, 4)``, allocated before the first, one per tick, as in
    :data:`hiltestbed.signals.CYCLE`; and the start of the last cycle, ``began`` [ns].
    """

    def __init__(self, capacity: int) -> None:
        self.rows = np.zeros((capacity, 4))
        self.k = 0
        self.began = time.monotonic_ns()

    def begin(self, ticks: int, age: float) -> None:
        """Record the start of a cycle, ``ticks`` after the last, with a reading ``age`` [s] old."""
        now = time.monotonic_ns()
        self.k += 1
        if self.k < len(self.rows):
            self.rows[self.k] = (now - self.began) / SECOND, 0.0, age, ticks - 1
        self.began = now

    def sent(self) -> None:
        """Record that the command has been sent."""
        if self.k < len(self.rows):
            self.rows[self.k, 1] = (time.monotonic_ns() - self.began) / SECOND


class DeviceRig:
    """Platform and sensor as the physical side of one run: rig, force sensor and supervisor of a
    :class:`hiltestbed.loop.Loop`. The reading is in P, less the tare, as it arrives: the signal
    chain is in the device itself.

    Attributes:
        stop: why the run has to stop; None while there is no fault. tare: (6,) subtracted from the
            sensor's wrench in P.
        last: (7,) the pose of A in P that was sent last. shown: (6,) the newest reading in the
            sensor's own frame. time: compares model time with wall time.
        late_work: [J] work of the force with each reading paired with the motion at which it acted,
            by the scenario's sensor.delay, less that with the motion of the tick of its reading.
        missed: ticks that began without the record of the device that sets the clock, or too late
            for an answer.
    """

    units: tuple[str, ...] = ()  # of the platform's joints, which devices do not report
    physical = False  # the bodies do not move freely
    phases: Phases | None = None  # phases of capture are those of the real mechanism

    def __init__(
        self, scenario: Scenario, connected: Connected, ticks: int, clock: WallClock | None = None
    ) -> None:
        if scenario.rig.platform.physical:
            kind = scenario.rig.platform.kind
            raise InputError(
                f"rig.platform: the bodies of {kind!r} move freely; devices are only for "
                f"platforms that are commanded"
            )
        tick, limits = scenario.tick, scenario.devices.limits
        self.scenario, self.connected, self.tick = scenario, connected, tick
        self.mounting = Mounting(scenario.devices)
        self.guard = Guard(limits, tick)
        self.time = Timekeeper(tick, limits.time_offset, clock or WallClock())
        self._bound_values()
        communication = scenario.devices.communication
        self._watches = [
            CommunicationWatch(link, communication, name)
            for name, link in (("sensor", connected.sensor), ("platform", connected.platform))
        ]
        self._seen = [-1, -1]
        self.log = CycleLog(ticks)
        self.monitor = monitor([scenario])
        self.stop: str | None = None
        self.armed = False
        self.missed = self._behind = 0
        self.tare, self.last = np.zeros(6), np.zeros(7)
        self.shown: Array = connected.sensor.reading.wrench
        self._command, self._raw, self._before = np.zeros(7), np.zeros(6), np.zeros(7)
        self._slope, self._slope_before = np.zeros(6), np.zeros(6)
        late = scenario.sensor.delay / tick
        self._late, self._part = int(late), late % 1.0
        # of the last ticks: the motion at which the force read now acted
        self._slopes = np.zeros((self._late + 2, 6))
        self._taken = 0
        self.late_work = 0.0
        self._threshold = max(GATE_SIGMA * scenario.sensor.noise, LEAST_FORCE)
        self.pose_act, self.twist_act = np.zeros((1, 7)), np.zeros((1, 6))
        self.pose_act[:, 6] = 1.0
        self.wrench_sub = np.zeros((1, 1, 6))
        # one view for all ticks: kernels are bound to it
        self.reading = self.wrench_sub[:, 0]
        self.contact, self.captured, self.diverged = (np.zeros(1, dtype=bool) for _ in range(3))
        self.slider_cmd, self.slider_act = np.zeros((1, 0)), np.zeros((1, 0))
        self.upper_cmd, self.upper_act = np.full((1, 3), np.nan), np.full((1, 3), np.nan)

    def read(self, k: int, wrench_sub: Array) -> Array:
        return self.reading

    def feel(self, k: int, wrench: Array) -> None:
        """Do nothing: the device measures the wrench itself."""

    def divergence(self, i: int) -> str:
        return "the rig is real"

    def payload_left(self, i: int) -> None:
        return None

    def held_pair(self, i: int) -> None:
        return None

    def reset(self, pose: Array, twist: Array) -> None:
        """Do nothing: the platform has already been brought to its start."""

    def passed(self, plant: DeviceRig, pose_before: Array, energy: Array) -> bool:
        if self.stop is None:
            self.stop = self._beyond("energy", float(energy[0]) + self.late_work)
        return self.stop is not None

    def _beyond(self, name: str, value: float) -> str | None:
        """Why to stop at a ``value`` of what ``safety`` limits; None if it is within."""
        limit, (said, unit) = getattr(self.scenario.safety, name), LIMITS[name]
        if limit is None or value <= limit:  # false for NaN
            return None
        return f"{said.format(value=value)}; safety.{name} is {limit:g} {unit}"

    def reason(self, i: int) -> str | None:
        return self.stop

    def _bound_values(self) -> None:
        """Narrow what counts as physical to the scenario's limits."""
        safety, devices = self.scenario.safety, self.scenario.devices
        away = math.hypot(*devices.platform.base.position, *devices.platform.tool.position)
        position = devices.limits.position
        load, place = (self.connected.sensor.reading.largest, self.connected.platform.state.largest)
        for values, limit in (
            (load[:3], safety.force),
            (load[3:], safety.torque),
            (place[:3], None if position is None else position + away),
        ):
            if limit is not None:
                np.minimum(values, HEADROOM * limit, out=values)

    def watch(self) -> None:
        """Begin to process the records; events before now are ignored."""
        # what arrived while the devices were opened is not the first tick
        for _ in range(DRAINS):
            if not (self.connected.sensor.poll() or self.connected.platform.poll()):
                break
        self.connected.pace.start()
        self.time.watch()
        self._seen[:] = [-1, -1]
        for watch in self._watches:
            watch.start()
        self._take_in()
        self._before[:] = self.last[:] = self.pose_act[0]

    def arm(self) -> None:
        """Allow commands to the platform from now on."""
        self.last[:] = self.pose_act[0]
        self.guard.start(self.last)
        self.time.start()
        self.armed = True

    def begin(self, pose_cmd: Array, twist_cmd: Array, accel_cmd: Array) -> None:
        """Send the pose ``(1, 7)`` for the end of the tick; the platform derives its velocity from
        it.
        """
        if self._behind == 0:
            self._send(pose_cmd[0])
        elif self.armed and self.stop is None:  # a newer record has arrived: that one is answered
            self.guard.refusal(pose_cmd[0])
            self.last[:] = pose_cmd[0]
        self.log.sent()

    def _send(self, pose: Array) -> None:
        platform, watchdog = self.connected.platform, self.connected.watchdog
        if self.armed and self.stop is None:
            self.stop = self.guard.refusal(pose)
        if self.armed and self.stop is None:
            self.last[:] = pose
            self.mounting.command_of(pose, self._command)
            platform.command(self._command)
        else:
            platform.hold()
        if self.armed and watchdog is not None:
            watchdog.beat()

    def finish(self) -> None:
        """Wait for the records of the next tick."""
        ticks = 2
        if self._behind > 0:
            self._behind -= 1
        else:
            begun = self.connected.pace.wait()
            self._behind = begun - 1
            self.time.ticked(begun, self.connected.pace.told())
            if self.stop is None and self.time.fault is not None:
                self.stop = f"{self.connected.pace.source}: {self.time.fault}"
            ticks = 1 if self._take_in() else 2
        self.log.begin(ticks, self.connected.sensor.sample.age())
        self.missed += ticks - 1

    def _take_in(self) -> bool:
        """Process and check the records that have arrived; whether both devices had a new one."""
        sensor, platform = self.connected.sensor, self.connected.platform
        sensor.poll()
        platform.poll()
        fresh = True
        for i, watch in enumerate(self._watches):
            sequence = watch.link.sample.sequence
            new = sequence != self._seen[i]
            self._seen[i] = sequence
            stop = watch.check(new)
            if stop is not None and self.stop is None:
                self.stop = stop.reason
            fresh = fresh and new
        self.mounting.wrench_in_P(sensor.reading.wrench, self._raw)
        self.reading[0] = self._raw - self.tare
        self._before[:] = self.pose_act[0]
        self.mounting.pose_in_P(platform.state.pose, self.pose_act[0])
        self._slope_before[:] = self._slope
        twist_between(self._before, self.pose_act[0], self.tick, self._slope)
        self._pair()
        ahead = 1.5 * self._slope - 0.5 * self._slope_before
        prescribed = self.scenario.rig.platform.prescribed
        self.twist_act[0] = self._slope if prescribed else ahead
        self.contact[0] = _length(self.reading[0, :3]) > self._threshold
        self.monitor.update(self.reading, self.pose_act, self.twist_act)
        self.captured[0] = not math.isnan(self.monitor.capture[0])
        if self.stop is None:
            self.stop = self._overload()
        return fresh

    def _pair(self) -> None:
        length = len(self._slopes)
        self._slopes[self._taken % length] = self._slope
        newer, older = ((self._taken - self._late - i) % length for i in range(2))
        acted = self._slopes[newer] * (1.0 - self._part) + self._slopes[older] * self._part
        self.late_work += self.tick * float(self.reading[0] @ (acted - self._slope))
        self._taken += 1

    def _overload(self) -> str | None:
        tracking, watchdog = math.dist(self.last[:3], self.pose_act[0, :3]), self.connected.watchdog
        stop = self._beyond("force", _length(self.reading[0, :3]))
        stop = stop or self._beyond("torque", _length(self.reading[0, 3:]))
        if stop is None and self.armed:
            stop = self._beyond("tracking_error", tracking)
            if stop is None and watchdog is not None and watchdog.tripped:
                stop = (
                    f"the watchdog has acted: the loop was silent for more than "
                    f"{watchdog.timeout:g} s"
                )
        return stop


def _length(vector: Array) -> float:
    return math.sqrt(float(vector @ vector))
