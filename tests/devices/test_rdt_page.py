"""The configuration page of a sensor: units as devices spell them, and pages that do not arrive."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from hiltestbed.devices import rdt_page
from hiltestbed.devices.interface import DeviceError
from hiltestbed.devices.rdt import page_of
from hiltestbed.devices.table import settings_of
from hiltestbed.errors import InputError


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
    with pytest.raises(InputError, match=r"torque_unit: is no unit \(got 'mN'\); allowed: N-m"):
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
