"""Faults on the wire: seen in the cycle in which they happen, with their reason; and what is
allowed is allowed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from hiltestbed.devices.interface import (
    Client,
    Event,
    PlatformClient,
    PlatformServer,
    SensorClient,
    SensorServer,
)
from hiltestbed.devices.rdt import RdtServer
from hiltestbed.devices.table import platform_client, platform_server, sensor_client, sensor_server
from hiltestbed.devices.watch import CommunicationLimits, CommunicationWatch, Stop
from tests.devices.running import PATIENCE, START, free_ports, going
from tests.devices.wire import Changed, Fault, OneCycleLate, Swapped, Wire, pass_on, take_in

NONE = CommunicationLimits(
    misses_in_a_row=0, misses_in_window=0, disturbances_in_window=0, stale=PATIENCE
)
AT = 17  # the cycle in which something happens
BAD = 0x80020000  # a status word: transducer saturation


class Rig:
    """A device, a wire and a client, moved cycle by cycle."""

    def __init__(self, client: Client, server: SensorServer | PlatformServer, wire: Wire) -> None:
        self.client, self.server, self.wire = client, server, wire
        self.tick = 0

    def send(self, status: int = 0) -> None:
        self.tick += 1
        if isinstance(self.server, SensorServer):
            self.server.publish(np.full(6, float(self.tick)), 0.004 * self.tick, status)
        else:
            self.server.publish(START, 0.004 * self.tick, status)

    def cycle(self, watch: CommunicationWatch, fault: Fault, status: int = 0) -> Stop | None:
        self.send(status)
        new = take_in(self.client, self.wire.to_client(fault))
        stop = watch.check(new)
        if isinstance(self.client, PlatformClient) and new:
            self.client.hold()
        self.wire.to_device()
        if isinstance(self.server, PlatformServer):
            self.server.poll()
        return stop


@contextmanager
def _rdt() -> Iterator[Rig]:
    server = sensor_server("rdt://127.0.0.1:0")
    assert isinstance(server, RdtServer)
    with server:
        wire = Wire(device=server.address)
        url = f"rdt://127.0.0.1:{wire.near.getsockname()[1]}"
        client = sensor_client(f"{url}?counts_per_force=1e6&counts_per_torque=1e6")
        yield from _opened(Rig(client, server, wire))


@contextmanager
def _rsi() -> Iterator[Rig]:
    (port,) = free_ports(1)
    wire = Wire(client=("127.0.0.1", port))
    server = platform_server(f"rsi://127.0.0.1:{wire.far.getsockname()[1]}")
    with server:
        yield from _opened(Rig(platform_client(f"rsi://127.0.0.1:{port}"), server, wire))


@contextmanager
def _udp() -> Iterator[Rig]:
    ours, theirs = free_ports(2)
    wire = Wire(device=("127.0.0.1", theirs), client=("127.0.0.1", ours))
    server = platform_server(f"udp://127.0.0.1:{theirs}?peer={wire.far.getsockname()[1]}")
    with server:
        url = f"udp://127.0.0.1:{wire.near.getsockname()[1]}"
        client = platform_client(f"{url}?listen={ours}&connect=5")
        yield from _opened(Rig(client, server, wire))


def _opened(rig: Rig) -> Iterator[Rig]:
    """Opening needs a device that goes on by itself; from then on the test moves it."""
    lock = threading.Lock()

    def step() -> None:
        with lock:
            rig.wire.to_device()
            rig.send()
            rig.wire.both()

    with going(step, 0.001):
        rig.client.open()
    rig.wire.both()
    rig.client.poll()
    watch = _watch(rig, CommunicationLimits(misses_in_a_row=99, stale=PATIENCE))
    for _ in range(3):
        rig.cycle(watch, pass_on)
    try:
        yield rig
    finally:
        rig.client.close()
        rig.wire.close()


RIGS = {"rdt": _rdt, "rsi": _rsi, "udp": _udp}


def _watch(rig: Rig, limits: CommunicationLimits = NONE) -> CommunicationWatch:
    watch = CommunicationWatch(rig.client, limits, "device")
    watch.start()
    return watch


def _run(
    rig: Rig, watch: CommunicationWatch, fault: Fault, cycles: int = 60, bad: float = np.inf
) -> int | None:
    """The cycle in which the watch stops; None where it does not. From ``bad`` on with a status."""
    for k in range(cycles):
        if rig.cycle(watch, fault, BAD if k >= bad else 0) is not None:
            return k
    return None


@pytest.mark.parametrize("protocol", RIGS)
def test_an_undisturbed_connection_is_not_stopped(protocol: str) -> None:
    with RIGS[protocol]() as rig:
        watch = _watch(rig)
        before = rig.client.counts.copy()
        assert _run(rig, watch, pass_on, 200) is None
        assert np.flatnonzero(rig.client.counts - before).tolist() == [Event.RECEIVED]


FAULTS: dict[str, tuple[Callable[[], Fault], int, Event]] = {
    # its absence shows in its own cycle
    "lost": (lambda: Changed({AT}, lambda data: []), AT, Event.LATE),
    "late": (lambda: OneCycleLate({AT}), AT, Event.LATE),
    "reordered": (lambda: Swapped({AT}), AT, Event.LATE),
    "burst lost": (lambda: Changed(set(range(AT, AT + 6)), lambda data: []), AT, Event.LATE),
    "burst held back": (lambda: OneCycleLate(set(range(AT, AT + 6))), AT, Event.LATE),
    "truncated": (lambda: Changed({AT}, lambda data: [data[:-3]]), AT, Event.LATE),
    "lengthened": (lambda: Changed({AT}, lambda data: [data + b"<"]), AT, Event.LATE),
    "repeated": (lambda: Changed({AT}, lambda data: [data, data]), AT, Event.REPEATED),
    "rubbish besides": (lambda: Changed({AT}, lambda data: [data, b"\0" * 7]), AT, Event.MALFORMED),
    "gone": (lambda: Changed(set(range(AT, 10_000)), lambda data: []), AT, Event.LATE),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("protocol", RIGS)
def test_where_nothing_is_allowed_the_cycle_of_the_fault_stops(protocol: str, fault: str) -> None:
    make, cycle, event = FAULTS[fault]
    with RIGS[protocol]() as rig:
        watch = _watch(rig)
        assert _run(rig, watch, make()) == cycle
        assert watch.stop is not None
        assert watch.stop.event is event
        assert watch.stop.reason.startswith(f"device {rig.client.where}: ")
        assert event.name.lower() in watch.stop.reason


LENIENT = NONE.model_copy(
    update={"misses_in_a_row": 1, "misses_in_window": 100, "disturbances_in_window": 100}
)


@pytest.mark.parametrize(
    ("fault", "event"),
    [
        (lambda: Changed({AT}, lambda data: []), Event.LOST),
        (lambda: Swapped({AT}), Event.REORDERED),
        (lambda: Changed({AT}, lambda data: [data[: len(data) // 2]]), Event.MALFORMED),
    ],
)
@pytest.mark.parametrize("protocol", RIGS)
def test_one_miss_that_is_allowed_is_counted_and_does_not_stop(
    protocol: str, fault: Callable[[], Fault], event: Event
) -> None:
    with RIGS[protocol]() as rig:
        watch = _watch(rig, LENIENT)
        before = rig.client.counts[event]
        assert _run(rig, watch, fault()) is None
        assert rig.client.counts[event] == before + 1


@pytest.mark.parametrize("protocol", RIGS)
def test_more_misses_in_a_row_than_allowed_stop_in_the_cycle_of_the_first_too_many(
    protocol: str,
) -> None:
    with RIGS[protocol]() as rig:
        watch = _watch(rig, NONE.model_copy(update={"misses_in_a_row": 3, "misses_in_window": 100}))
        assert _run(rig, watch, Changed(set(range(AT, AT + 9)), lambda data: [])) == AT + 3
        assert watch.stop is not None
        assert "4 misses in a row, the last late (limit 3)" in watch.stop.reason


@pytest.mark.parametrize("protocol", RIGS)
@pytest.mark.parametrize("kind", ["lost", "late"])
def test_two_in_a_hundred_stop_where_the_window_says(protocol: str, kind: str) -> None:
    """The 11th in a window of 500 cycles, where 10 are allowed; two that follow each other are
    two.
    """
    rng = np.random.default_rng(11)
    bad = set(np.flatnonzero(rng.random(1000) < 0.02).tolist())
    misses = np.array([k in bad for k in range(1000)], dtype=int)
    windows = np.convolve(misses, np.ones(500, dtype=int))[:1000]
    expected = int(np.argmax(windows > 10))
    assert windows[expected] == 11
    with RIGS[protocol]() as rig:
        limits = {"misses_in_a_row": 5, "misses_in_window": 10, "window": 500}
        watch = _watch(rig, NONE.model_copy(update=limits))
        fault = Changed(bad, lambda data: []) if kind == "lost" else OneCycleLate(bad)
        assert _run(rig, watch, fault, 1000) == expected


@pytest.mark.parametrize("protocol", ["rdt", "udp"])
def test_an_error_status_stops_at_once(protocol: str) -> None:
    with RIGS[protocol]() as rig:
        watch = _watch(rig, LENIENT)
        assert _run(rig, watch, pass_on, bad=AT) == AT
        assert watch.stop is not None
        assert watch.stop.event is Event.STATUS
        said = "the device reports an error (status 0x80020000; allowed are 0 in a row)"
        assert said in watch.stop.reason


def test_a_device_that_refuses_is_gone() -> None:
    """What is sent to a port that has been closed comes back: the next cycle sees it, without
    waiting for misses to add up.
    """
    with _rdt() as rig:
        watch = _watch(rig, LENIENT.model_copy(update={"misses_in_a_row": 50}))
        assert _run(rig, watch, pass_on, 10) is None
        rig.wire.close()
        assert isinstance(rig.client, SensorClient)
        rig.client.bias()
        stop = watch.check(rig.client.poll())
        assert stop is not None
        assert stop.event is Event.GONE
        assert "nothing listens at the device's address any more" in stop.reason


def test_an_old_sample_stops_whatever_else_is_allowed() -> None:
    with _rdt() as rig:
        rest = {"misses_in_a_row": 10_000, "misses_in_window": 10_000}
        watch = _watch(rig, NONE.model_copy(update=rest | {"stale": 1e-9}))
        stop = rig.cycle(watch, pass_on)
        assert stop is not None
        assert stop.event is Event.STALE
        assert "ms old (limit" in stop.reason


def test_answers_that_get_lost_on_the_way_back_are_told_by_the_controller() -> None:
    """RSI: Delay D counts what the controller did not get in time; the cycle that reads it
    stops.
    """
    with _rsi() as rig:
        watch = _watch(rig)
        stopped = None
        for k in range(40):
            rig.send()
            new = take_in(rig.client, rig.wire.to_client())
            stop = watch.check(new)
            if stop is not None:
                stopped = k, stop
                break
            assert isinstance(rig.client, PlatformClient)
            rig.client.hold()
            rig.wire.to_device((lambda datagrams: []) if k == AT else pass_on)
            rig.server.poll()
        assert stopped is not None
        assert stopped[0] == AT + 1
        assert stopped[1].event is Event.LATE
