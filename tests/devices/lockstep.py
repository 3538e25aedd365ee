"""A run against an emulated rig in one process, tick by tick: what the wire carries is real, the
clock is not.

The wait for a tick moves the emulated devices on by one cycle and then takes in what they have
sent; nothing depends on how long it takes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hiltestbed.devices.emulate import Emulator
from hiltestbed.devices.interface import PlatformClient, SensorClient
from hiltestbed.devices.pace import DevicePace, Pace, SimulatedClock
from hiltestbed.devices.session import Observed, Options, Session
from hiltestbed.devices.watch import CommunicationLimits
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.simulation import Run
from tests.devices.running import going, until, urls

SCENARIOS = Path(__file__).parents[2] / "scenarios"
PATIENT = {
    "devices.watchdog": None,
    "devices.communication.stale": 1000.0,
    "devices.platform.run_up": 0.2,
}
RATES = {"rsi": 250.0, "rtde": 500.0, "udp": 1000.0, "shm": 1000.0}


def scenario_of(name: str, platform: str, **changes: Any) -> Scenario:
    """A shipped scenario at the rate of ``platform``, without noise, that does not mind how slow
    the machine is.
    """
    rate = RATES[platform]
    still = {"rate": rate, "physics_rate": 4000.0, "sensor.noise": 0.0, "sensor.torque_noise": 0.0}
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scenario(SCENARIOS / f"{name}.yaml", still | PATIENT | dotted)


def watched(scenario: Scenario, limits: CommunicationLimits) -> Scenario:
    """``scenario`` with these limits on lost, late and faulty records."""
    devices = scenario.devices.model_copy(update={"communication": limits})
    return scenario.model_copy(update={"devices": devices})


Disturbance = Callable[[int, Emulator, Session], Collection[str]]


@dataclass
class Outcome:
    """What came of a run in lockstep: the run, the emulated devices as they were left, and the
    session.
    """

    run: Run
    emulator: Emulator
    session: Session


def played(
    scenario: Scenario,
    platform: str,
    disturb: Disturbance | None = None,
    emulated: Scenario | None = None,
    armed: bool = True,
    record: Path | None = None,
    sensor: str = "rdt",
) -> Outcome:
    """Run ``scenario`` against the emulated rig of ``emulated``, the same where it is not given.

    Args:
        disturb: called before each cycle of the devices once the run is armed, with its number; the
            devices whose record of this cycle does not arrive in it.
        record: file that takes the rows as they come.
    """
    begun, cycle = False, 0

    def before(emulator: Emulator) -> Collection[str]:
        nonlocal begun, cycle
        begun = begun or session.rig.armed
        cycle += begun
        return disturb(cycle - 1, emulator, session) if begun and disturb is not None else ()

    with against(emulated or scenario, platform, before, armed, sensor=sensor) as (
        options,
        emulator,
    ):
        session = Session(scenario, replace(options, record=record))
        with session.connected():
            observed: Observed = session.observe()
            if armed:
                session.run()
    return Outcome(session.result(observed), emulator, session)


@contextmanager
def against(
    emulated: Scenario,
    platform: str,
    before: Callable[[Emulator], Collection[str]] = lambda emulator: (),
    armed: bool = True,
    faster: Callable[[], float] = lambda: 1.0,
    sensor: str = "rdt",
) -> Iterator[tuple[Options, Emulator]]:
    """Options for a session against the emulated rig of ``emulated``, which moves when the session
    waits for it.

    Args:
        before: called before each cycle of the devices; the devices whose record of this cycle does
            not arrive in it.
        faster: how much faster than the wall clock the devices' clock runs.
    """
    (sensor_url, device_sensor), (platform_url, device_platform) = urls(sensor), urls(platform)
    emulator = Emulator(emulated, device_sensor, device_platform)
    stepped, cycling = False, threading.Lock()

    def pace(felt: SensorClient, moved: PlatformClient, tick: float) -> Pace:
        nonlocal stepped
        with cycling:  # once a cycle that has begun is over
            stepped = True
        while felt.poll() or moved.poll():
            pass

        def wait(timeout: float, expected: float) -> bool:
            seen = felt.sample.sequence
            lost = before(emulator)
            emulator.cycle()
            if "sensor" not in lost:
                until(lambda: felt.sample.sequence != seen or felt.poll())
            if "platform" not in lost:
                until(moved.poll)
            return "platform" not in lost

        moved.wait = wait  # type: ignore[method-assign]
        return DevicePace(moved, tick, 1)

    def step() -> None:
        with cycling:
            if not stepped:
                emulator.cycle()

    with emulator, going(step, 0.002):
        options = Options(
            sensor_url,
            platform_url,
            armed=armed,
            pace=pace,
            clock=SimulatedClock(lambda: emulator.cycles * emulator.rig.period / faster()),
        )
        yield options, emulator
