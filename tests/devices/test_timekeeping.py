"""Model time runs at the wall clock's rate, whatever the device that sets the clock does.

The law: in no stretch of wall time does the platform go further than the model says by more than
1 %; nothing moves at another rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.devices.emulate import Emulator
from hiltestbed.devices.interface import DeviceError
from hiltestbed.devices.pace import RATE_ERROR, HostPace, Timekeeper, WallClock, pace_of
from hiltestbed.devices.session import Session
from hiltestbed.devices.table import platform_client, sensor_client
from tests.devices.lockstep import against, scenario_of

TICK, LIMIT = 0.001, 0.02
SECOND = 1_000_000_000


class Wall(WallClock):
    """A wall clock that the test moves; what is slept moves it, too."""

    def __init__(self) -> None:
        self.at = self.slept = 0.0

    def __call__(self) -> int:
        return round(self.at * SECOND)

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.at += seconds
        self.slept += seconds


def _faults(arrivals: np.ndarray) -> tuple[float, str | None, float]:
    """A clock whose k-th record comes at ``arrivals[k]`` [s], two seconds before arming and after:
    its factor at arming, the fault after it, and the wall time of that.
    """
    wall = Wall()
    keeper = Timekeeper(TICK, LIMIT, wall)
    factor, right = np.nan, None
    for k, at in enumerate(arrivals):
        wall.at = float(at)
        keeper.ticked(1, k)
        if np.isnan(factor) and at >= 2.0:
            right = keeper.is_right()
            factor = keeper.factor
            keeper.start()
        if keeper.fault is not None:
            break
    assert right is (abs(factor - 1.0) <= RATE_ERROR)
    return factor, keeper.fault, wall.at


@pytest.mark.parametrize("rate", [0.5, 1.01 + 1e-3, 10.0])
def test_a_clock_of_another_rate_is_measured_before_anything_moves(rate: float) -> None:
    factor, *_ = _faults(np.arange(30_000) * TICK / rate)
    assert factor == pytest.approx(rate, rel=1e-6)
    assert abs(factor - 1.0) > RATE_ERROR


STEADY = np.arange(6000) * TICK
RNG = np.random.default_rng(3)
HARMLESS = {
    "steady": STEADY,
    "1001 Hz for 1000": STEADY / 1.001,
    "jitter": STEADY + RNG.uniform(0.0, 2e-3, 6000),
    "in bursts of ten": np.ceil(STEADY / 0.01 + 1e-9) * 0.01,
    "one held back by 15 ms, and those behind it": np.where(
        (STEADY > 3.0) & (STEADY < 3.015), 3.015, STEADY
    ),
}


@pytest.mark.parametrize("name", HARMLESS)
def test_what_a_network_does_to_a_clock_of_the_right_rate_is_no_fault(name: str) -> None:
    factor, fault, _ = _faults(np.maximum.accumulate(HARMLESS[name]))
    assert abs(factor - 1.0) < RATE_ERROR
    assert fault is None


def _after(change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Steady for three seconds, then ``change`` of the times from there [s]."""
    after = np.arange(6000) * TICK
    return np.concatenate([np.arange(3000) * TICK, 3.0 + change(after)])


HARMFUL = {  # and the wall time [s] within which it has to be seen, from 3.0 s on
    "drifts by 1.5 % ahead": (_after(lambda t: t / 1.015), 1.5),
    "drifts by half a per cent until it is beyond the limit": (_after(lambda t: t / 1.005), 4.1),
    "doubles": (_after(lambda t: t / 2.0), 0.045),
    "halves": (_after(lambda t: t * 2.0), 0.045),
    "stalls for 0.3 s": (_after(lambda t: t + 0.3), 0.301),
    "jumps by 50 ms": (_after(lambda t: np.maximum(t - 0.05, 0.0)), 0.045),
}


@pytest.mark.parametrize("name", HARMFUL)
def test_a_clock_that_goes_wrong_while_the_platform_moves_stops_it(name: str) -> None:
    arrivals, within = HARMFUL[name]
    _, fault, at = _faults(arrivals)
    assert fault is not None
    assert at - 3.0 < within


def test_a_jump_of_the_records_numbers_is_seen_in_its_cycle() -> None:
    """All those ticks would begin at once."""
    wall = Wall()
    keeper = Timekeeper(TICK, LIMIT, wall)
    keeper.start()
    for k, ticks in enumerate([*[1] * 100, 25]):
        assert keeper.fault is None
        wall.at += TICK
        keeper.ticked(ticks, k + ticks)
    assert "ahead of the wall clock; devices.limits.time_offset is 20 ms" in str(keeper.fault)


def test_a_clock_that_is_silent_has_no_rate() -> None:
    wall = Wall()
    keeper = Timekeeper(TICK, LIMIT, wall)
    for _ in range(2000):
        wall.at += TICK
        keeper.ticked(1, 7.0)
    assert keeper.is_right() is False
    assert keeper.rate == 0.0


@pytest.mark.parametrize("held", [0.03, 0.25])
@pytest.mark.parametrize("change", [np.maximum, np.add])
def test_one_stall_of_a_busy_machine_is_waited_out(change: np.ufunc, held: float) -> None:
    """Records held back, and a clock that paused, look like another rate at first: that cannot be
    told, and after a while it can.
    """
    wall, found = Wall(), []
    keeper = Timekeeper(TICK, LIMIT, wall)
    after = change(np.arange(20_000) * TICK, held)
    arrivals = np.concatenate([np.arange(500) * TICK, 0.5 + after])
    for k in np.flatnonzero(np.diff(arrivals)).tolist():  # of those that come at once, the newest
        wall.at = at = float(arrivals[k])
        keeper.ticked(1, k)
        if k % 50 == 49 and at > 1.0:
            found.append(keeper.is_right())
    assert False not in found
    assert found[-1] is True


def test_a_clock_that_pauses_again_and_again_has_its_mean_rate() -> None:
    wall = Wall()
    keeper = Timekeeper(TICK, None, wall)
    keeper.start()
    for k in range(10_000):
        wall.at += TICK + (0.003 if k % 100 == 99 else 0.0)
        keeper.ticked(1, k)
    assert "it ran at 9" in str(keeper.fault)


@pytest.mark.parametrize(
    ("platform", "rate"),
    [("udp", 0.985), ("udp", 2.0), ("rsi", 10.0)],
)
def test_nothing_is_armed_with_a_device_at_another_rate(platform: str, rate: float) -> None:
    """The message names both rates and the key to set; the platform stays where it was."""
    scenario = scenario_of("01-free-flight", platform, duration=0.2)
    with against(scenario, platform, faster=lambda: rate) as (options, emulator):
        session = Session(scenario, options)
        with session.connected():
            before = emulator.platform.command.copy()
            with pytest.raises(DeviceError, match="Nothing was moved") as refused:
                session.observe()
            np.testing.assert_allclose(emulator.platform.command, before, atol=1e-9)
    assert f"{rate * scenario.rate:.5g} ticks a second" in str(refused.value)
    assert f"the scenario's rate is {scenario.rate:g} Hz" in str(refused.value)
    assert "--set rate=" in str(refused.value)


@pytest.mark.parametrize(("kind", "rate"), [("hold", 0.5), ("hold", 10.0), ("retract", 2.0)])
def test_the_platform_never_goes_further_than_the_model_in_the_wall_time(
    kind: str, rate: float
) -> None:
    """A device that changes its rate in flight, 0.1 s after the start of the run: by one per cent
    and the ticks at both ends at most, the retraction included.
    """
    scenario = scenario_of("01-free-flight", "udp", duration=2.0, devices__on_stop__kind=kind)
    wall, factor = Wall(), 1.0
    sent: list[tuple[float, float]] = []
    session: Session

    def before(emulator: Emulator) -> tuple[str, ...]:
        nonlocal factor
        if session.loop.k > 100:
            factor = rate
        wall.at += emulator.rig.period / factor
        sent.append((wall.at, float(emulator.platform.command[2])))
        return ()

    with against(scenario, "udp", before) as (options, emulator):

        def meanwhile(seconds: float) -> None:
            """The device does not wait for a loop that sleeps."""
            for _ in range(round(seconds * factor / emulator.rig.period)):
                before(emulator)
                emulator.cycle()

        wall.sleep = meanwhile  # type: ignore[method-assign]
        session = Session(scenario, replace(options, clock=wall))
        with session.connected():
            observed = session.observe()
            session.run()
    summary = session.result(observed).summary
    assert summary["status"] == "stopped"
    assert "wall clock" in summary["stop_reason"]
    times, places = np.array(sent).T
    fastest = max(scenario.approach.velocity[2], scenario.devices.platform.travel_speed)
    for stretch in (0.02, 0.1, 1.0):
        ends = np.interp(times - stretch, times, places)
        assert np.abs(places - ends).max() <= fastest * (1.01 * stretch + 2 * TICK)


def test_the_loops_own_clock_paces_where_neither_device_does() -> None:
    sensor = sensor_client("udp://127.0.0.1:5001?listen=5002&clock=host")
    platform = platform_client("shm://nobody?clock=host")
    assert isinstance(pace_of(sensor, platform, TICK), HostPace)
