"""Devices by URL: what is read from it, and what is said of one that is wrong."""

from __future__ import annotations

import pytest

from hiltestbed.devices import table
from hiltestbed.devices.interface import Protocol, SensorClient
from hiltestbed.devices.rdt import RdtSettings
from hiltestbed.devices.rsi import RsiSettings
from hiltestbed.devices.table import (
    find,
    platform_client,
    protocols,
    register,
    sensor_client,
    sensor_server,
    settings_of,
)
from hiltestbed.devices.url import DeviceSettings
from hiltestbed.errors import InputError
from tests.devices.running import free_ports


def _said(url: str) -> list[str]:
    with pytest.raises(InputError) as raised:
        settings_of(url)
    return [f"{fault.key}: {fault.message}" for fault in raised.value.faults]


def test_what_is_not_given_is_the_loopback_address_and_the_protocols_own_port() -> None:
    for scheme, protocol in protocols().items():
        settings = settings_of(f"{scheme}://")
        assert isinstance(settings, protocol.settings)
        assert settings.host == ("hiltestbed" if scheme == "shm" else "127.0.0.1")
    assert settings_of("rdt://").port == 49152
    assert settings_of("rtde://").port == 30004


def test_address_port_and_options_are_read() -> None:
    settings = settings_of(
        "rdt://192.168.1.1:50000?counts_per_force=1e6&mode=buffered&ignore_status=0x80010000"
    )
    assert isinstance(settings, RdtSettings)
    assert (settings.host, settings.port, settings.counts_per_force, settings.mode) == (
        "192.168.1.1",
        50000,
        1e6,
        "buffered",
    )
    assert settings.ignore_status == 0x80010000
    rsi = settings_of("rsi://?correction=relative&hold=false&period_ms=12")
    assert isinstance(rsi, RsiSettings)
    assert (rsi.correction, rsi.hold, rsi.period_ms) == ("relative", False, 12)


def test_every_fault_of_a_url_is_told_at_once() -> None:
    options = (
        "counts_per_force, counts_per_torque, force_unit, torque_unit, rate, "
        "internal_rate, mode, buffer, http, ignore_status"
    )
    assert set(_said("rdt://127.0.0.1?count_per_force=1&rate=-5&mode=fast&http=99999&rate=2")) == {
        f"count_per_force: unknown option (did you mean 'counts_per_force'?); allowed: {options}",
        "rate: is given twice; each option may stand once",
        "rate: is out of range (got -5); allowed is > 0",
        "mode: unknown value (got 'fast'); allowed: realtime, buffered",
        "http: is out of range (got 99999); allowed is <= 65535",
    }


FORM = "give it as scheme://host:port?option=value"
WRONG = {
    "rsy://127.0.0.1": "unknown protocol (did you mean 'rsi'?) (got 'rsy'); allowed: rdt, rsi, rtde, shm, udp",
    "127.0.0.1:49152": f"is not a device (got '127.0.0.1:49152'); {FORM}",
    "rdt://127.0.0.1:abc": "is not a port (got 'abc'); allowed is 0 to 65535",
    "rdt://127.0.0.1:70000": "is not a port (got '70000'); allowed is 0 to 65535",
    "rdt://127.0.0.1/stream": f"has a path, a user or a fragment; {FORM}",
    "rdt://?host=1.2.3.4": "is not an option; the address goes before the question mark",
    "rdt://[::1": f"is not a URL (Invalid IPv6 URL); {FORM}",
    "rsi://?period_ms=5": "unknown value (got 5); allowed: 4, 12",
    "rsi://?sentype=a%3Cb": "string should match pattern '^[A-Za-z0-9_.-]+$' (got 'a<b')",
}


@pytest.mark.parametrize("url", WRONG)
def test_what_is_wrong_is_said(url: str) -> None:
    assert WRONG[url] in [said.partition(": ")[2] for said in _said(url)]


def test_the_message_says_where_the_url_stands() -> None:
    with pytest.raises(
        InputError,
        match=r"^--sensor rdt://x\?rate=0: rate: is out of range \(got 0\); allowed is > 0$",
    ):
        sensor_client("rdt://x?rate=0")


def test_a_protocol_without_the_part_that_is_asked_for() -> None:
    with pytest.raises(
        InputError,
        match=r"rsi is not a protocol of a force sensor .*; allowed: rdt, rtde, shm, udp",
    ):
        sensor_client("rsi://")
    with pytest.raises(
        InputError,
        match=r"rdt is not a protocol of a motion platform .*; allowed: rsi, rtde, shm, udp",
    ):
        platform_client("rdt://")


def test_an_address_that_is_none_or_not_this_machines() -> None:
    with pytest.raises(InputError, match=r"host: is not an address \(got 'no.such.host.invalid'"):
        sensor_client("rdt://no.such.host.invalid?counts_per_force=1&counts_per_torque=1").open()
    with pytest.raises(
        InputError,
        match=r"UDP 192.0.2.7:.* is not an address of this machine; give one of its own, or "
        r"127.0.0.1",
    ):
        sensor_server(f"rdt://192.0.2.7:{free_ports(1)[0]}").open()


def test_a_protocol_of_the_users_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "_registered", {})

    class Quiet(SensorClient):
        def open(self) -> None: ...
        def close(self) -> None: ...
        def poll(self) -> bool:
            return False

    register(Protocol("quiet", "says nothing", DeviceSettings, sensor_client=Quiet))
    with sensor_client("quiet://") as sensor:
        assert sensor.wait(0.0) is False
    assert find("quiet://", "--sensor").summary == "says nothing"
