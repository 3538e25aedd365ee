"""ATI's Raw Data Transfer against peers that share no code with it; the configuration page: units as devices
spell them, and pages that do not arrive."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from hiltestbed.devices import rdt_page
from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.rdt import BIAS, RdtClient, RdtServer, page_of
from hiltestbed.devices.table import sensor_client, sensor_server, settings_of
from hiltestbed.errors import InputError
from tests.devices.independent.rdt_peer import IndependentRdtSensor
from tests.devices.running import going, until

WRENCH = np.array([1.5, -2.25, 310.125, 0.5, -0.125, 7.75])


def _server(options: str = "") -> RdtServer:
    server = sensor_server("rdt://127.0.0.1:0?" + options)
    assert isinstance(server, RdtServer)
    return server


def _client(port: int, options: str = "counts_per_force=1e6&counts_per_torque=1e6") -> RdtClient:
    client = sensor_client(f"rdt://127.0.0.1:{port}?{options}")
    assert isinstance(client, RdtClient)
    return client


@pytest.mark.parametrize("mode", ["realtime", "buffered"])
def test_the_client_reads_and_tares_the_emulated_sensor(mode: str) -> None:
    with _server("counts_per_force=1e5&counts_per_torque=2e6&buffer=4") as server:
        options = f"counts_per_force=1e5&counts_per_torque=2e6&mode={mode}"
        client, ticks = _client(server.address[1], options), iter(range(1, 1_000_000))
        load = WRENCH.copy()
        with going(lambda: server.publish(load, 0.001 * next(ticks))), client:
            np.testing.assert_allclose(client.reading.wrench, WRENCH, atol=0.5e-5)
            first = client.reading.sequence
            until(lambda: client.wait(1.0) and client.reading.sequence > first + 10)
            assert client.counts[Event.LOST] == client.counts[Event.MALFORMED] == 0
            milliseconds = 1e3 * client.reading.device_time
            assert milliseconds == pytest.approx(round(milliseconds))
            client._request(BIAS)
            until(lambda: client.wait(1.0) and not client.reading.wrench.any())
            load[0] = 1e6  # counts end at their limits
            limit = pytest.approx((2**31 - 1) / 1e5)
            until(lambda: client.wait(1.0) and client.reading.wrench[0] == limit)


def test_the_client_reads_an_independent_sensor() -> None:
    sensor = IndependentRdtSensor(lambda k: [k, -k, 1000 * k, 2 * k, -3 * k, 10 * k])
    with _client(
        sensor.port, "counts_per_force=1000&counts_per_torque=1e4&internal_rate=3500"
    ) as client:
        assert sensor.requests[0] == bytes.fromhex("1234000200000000")
        for _ in range(20):
            assert client.wait(5.0)
            k = client.reading.sequence
            expected = [k / 1e3, -k / 1e3, k, 2 * k / 1e4, -3 * k / 1e4, 10 * k / 1e4]
            np.testing.assert_allclose(client.reading.wrench, expected, rtol=1e-12)
            assert client.reading.device_time == pytest.approx((7000 + 7 * k) / 3500.0)
        assert client.counts[Event.LOST] == client.counts[Event.MALFORMED] == 0
        client._request(BIAS)
        until(lambda: sensor.requests[-1] == bytes.fromhex("1234004200000000"))
    # closing stops the stream
    until(lambda: sensor.requests[-1] == bytes.fromhex("1234000000000000"))
    sensor.close()


def test_a_lost_request_is_repeated_and_units_are_converted() -> None:
    sensor = IndependentRdtSensor(lambda k: [1000, 0, 0, 0, 0, 1000])
    sensor.ignore = 2
    options = "counts_per_force=1000&counts_per_torque=1000&force_unit=lbf&torque_unit=lbf-in"
    with _client(sensor.port, options) as client:
        assert client.reading.wrench[0] == pytest.approx(4.4482216152605)  # one pound-force
        assert client.reading.wrench[5] == pytest.approx(4.4482216152605 * 0.0254)
    sensor.close()


def test_buffered_records_are_taken_in_one_by_one() -> None:
    sensor = IndependentRdtSensor(lambda k: [k] * 6)
    with _client(sensor.port, "counts_per_force=1&counts_per_torque=1&mode=buffered") as client:
        until(lambda: client.wait(1.0) and client.reading.sequence >= 50)
        assert client.reading.sequence % 5 == 0
        assert client.counts[Event.RECEIVED] == client.reading.sequence
        assert client.counts[Event.LOST] == 0
    sensor.close()


def test_a_sensor_that_stands_still_and_one_with_an_error_give_nothing_new() -> None:
    sensor = IndependentRdtSensor(lambda k: [k] * 6)
    with _client(sensor.port, "counts_per_force=1&counts_per_torque=1") as client:
        sensor.per_sample = 0
        until(lambda: client.wait(0.05) is False and client.counts[Event.REPEATED] > 3)
        before = client.reading.wrench.copy()
        sensor.per_sample, sensor.status = 7, 0x80020000
        until(lambda: client.poll() is False and client.counts[Event.STATUS] > 3)
        assert client.reading.status == 0x80020000
        np.testing.assert_array_equal(client.reading.wrench, before)
    sensor.close()


def test_what_keeps_a_client_from_opening_is_said() -> None:
    with _server() as server:
        with pytest.raises(DeviceError, match=r"no good record in .* check the address"):
            _client(server.address[1]).open()  # it is asked, but publishes nothing
        with pytest.raises(DeviceError, match=r"configuration page .* cannot be read"):
            _client(server.address[1], f"http={server.address[1]}").open()
        with pytest.raises(
            InputError, match=r"is in use by another program; stop it or give another port"
        ):
            sensor_server(f"rdt://127.0.0.1:{server.address[1]}").open()


def _body(force: str, torque: str) -> bytes:
    elements = {"scfgfu": force, "scfgtu": torque, "cfgcpf": 1e6, "cfgcpt": 1e6, "comrdtrate": 250}
    inside = "".join(f"<{name}>{value}</{name}>" for name, value in elements.items())
    return f"<netft>{inside}</netft>".encode()


@contextmanager
def _serving(answer: Callable[[socket.socket], None]) -> Iterator[int]:
    """A server that answers one request."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.recv(4096)
                try:
                    answer(client)
                except OSError:
                    return

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1]


def _fetched(force: str, torque: str) -> rdt_page.Page:
    body = _body(force, torque)
    head = b"HTTP/1.0 200 OK\r\n\r\n"
    with _serving(lambda client: client.sendall(head + body)) as port:
        return rdt_page.fetch("127.0.0.1", port, "rdt://sensor")


POUND = 4.4482216152605
TORQUES = {
    "Nm": 1.0,
    "N-m": 1.0,
    "Nmm": 1e-3,
    "kNm": 1e3,
    "N m": 1.0,
    "mNm": 1e-3,
    "lbf-in": POUND * 0.0254,
    " lbf-ft ": POUND * 0.3048,
    "in-lbf": POUND * 0.0254,
    "kgf-cm": 9.80665e-2,
    "gfcm": 9.80665e-5,
}
FORCES = {"N": 1.0, "gf": 9.80665e-3, "kgf": 9.80665, " lbf ": POUND, "klbf": 1e3 * POUND}


def test_units_as_devices_spell_them() -> None:
    for unit, factor in TORQUES.items():
        page = _fetched("N", unit)
        assert page.torque == pytest.approx(factor, rel=1e-12), unit
        assert page.rate == 250.0
    for unit, factor in FORCES.items():
        assert _fetched(unit, "Nm").force == pytest.approx(factor, rel=1e-12), unit


@pytest.mark.parametrize(("force", "torque"), [("dyn", "Nm"), ("N", "mN"), ("N", "")])
def test_a_unit_that_is_none_is_named_with_all_keys_that_replace_it(
    force: str, torque: str
) -> None:
    with pytest.raises(DeviceError) as refused:
        _fetched(force, torque)
    said = str(refused.value)
    assert repr(force if force != "N" else torque) in said
    for word in ("known: N", "counts_per_force", "force_unit", "torque_unit", "rate"):
        assert word in said, word


def test_counts_given_by_hand_need_no_unit_from_the_page() -> None:
    head = b"HTTP/1.0 200 OK\r\n\r\n" + _body("dyn", "Nmm")
    with _serving(lambda client: client.sendall(head)) as port:
        url = f"rdt://127.0.0.1?http={port}&counts_per_force=10&force_unit=gf"
        page = page_of(settings_of(url), "127.0.0.1")  # type: ignore[arg-type]
    assert (page.counts_per_force, page.force) == (10.0, pytest.approx(9.80665e-3))
    assert (page.counts_per_torque, page.torque, page.rate) == (1e6, 1e-3, 250.0)
    with pytest.raises(InputError, match=r"torque_unit: is no unit \(got 'mN'\); allowed: N m"):
        settings_of("rdt://127.0.0.1?torque_unit=mN")


def _trickle(client: socket.socket, data: bytes) -> None:
    for byte in data:
        client.sendall(bytes([byte]))
        time.sleep(0.05)


PAGES = {
    "a byte now and then from the first line on": lambda c: _trickle(
        c, b"HTTP/1.0 200 OK\r\n" * 99
    ),
    "nothing": lambda c: time.sleep(1.0),
    "no HTTP": lambda c: c.sendall(b"\x00" * 400),
    "not found": lambda c: c.sendall(b"HTTP/1.0 404 Not Found\r\n\r\n"),
}


@pytest.mark.parametrize("kind", PAGES)
def test_a_page_that_does_not_arrive_is_given_up(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rdt_page, "DEADLINE", 0.4)
    monkeypatch.setattr(rdt_page, "PATIENCE", 0.3)
    began = time.monotonic()
    with (
        _serving(PAGES[kind]) as port,
        pytest.raises(DeviceError, match=r"configuration page .* cannot be read"),
    ):
        rdt_page.fetch("127.0.0.1", port, "rdt://sensor")
    assert time.monotonic() - began < 3.0
