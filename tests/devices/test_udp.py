"""Plain records over UDP: the layout of the user's, packed by hand here."""

from __future__ import annotations

import math
import socket
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.layout import WireRecord, default_layout, read_layout
from hiltestbed.devices.table import platform_client, platform_server, sensor_client, sensor_server
from hiltestbed.errors import InputError
from tests.devices.running import START, free_ports, going, until

LAYOUT = """
byte_order: big
sensor:
  - {name: const, type: uint16, value: 0x5AA5}
  - {name: sequence, type: uint8}
  - {name: pad, type: uint8, size: 3}
  - {name: time, type: uint32, scale: 1.0e-6}
  - {name: fx, type: int16, scale: 0.1}
  - {name: fy, type: int16, scale: 0.1}
  - {name: fz, type: int32, scale: 0.001}
  - {name: tx, type: float32}
  - {name: ty, type: float32}
  - {name: tz, type: float32, scale: -1.0}
  - {name: crc, type: crc16}
state:
  - {name: sequence, type: uint32}
  - {name: px, type: float64, scale: 1.0e-3}
  - {name: py, type: float64, scale: 1.0e-3}
  - {name: pz, type: float64, scale: 1.0e-3}
  - {name: rx, type: float64}
  - {name: ry, type: float64}
  - {name: rz, type: float64}
command:
  - {name: px, type: float64}
  - {name: py, type: float64}
  - {name: pz, type: float64}
  - {name: qw, type: float64}
  - {name: qx, type: float64}
  - {name: qy, type: float64}
  - {name: qz, type: float64}
  - {name: stop, type: uint8}
"""


def _file(folder: Path, text: str = LAYOUT) -> Path:
    path = folder / "layout.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def _crc16(data: bytes) -> int:
    """CRC-16/CCITT, polynomial 0x1021 from 0xFFFF, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_a_sensor_record_by_hand(tmp_path: Path) -> None:
    record = WireRecord(read_layout(_file(tmp_path)), "sensor")
    body = struct.pack(">HB3xIhhifff", 0x5AA5, 200, 2_500_000, 105, -3, 310_125, 0.5, -0.125, 7.75)
    data = body + struct.pack(">H", _crc16(body))
    assert record.size == len(data)
    assert record.unpack(data)
    np.testing.assert_allclose(record.values, [10.5, -0.3, 310.125, 0.5, -0.125, -7.75])
    assert (record.sequence, record.time, record.sequence_bits) == (200, pytest.approx(2.5), 8)
    assert record.pack(record.values, 200, 2.5) == data
    assert not record.unpack(data[:-1] + bytes([data[-1] ^ 1]))
    assert not record.unpack(b"\x5a\xa4" + data[2:])
    assert not record.unpack(data[:-1])
    assert not record.unpack(data + b"\0")


def test_whole_numbers_are_rounded_and_end_at_their_limits(tmp_path: Path) -> None:
    record = WireRecord(read_layout(_file(tmp_path)), "sensor")
    record.unpack(record.pack(np.array([1e9, -1e9, 0.0004, 0.0, 0.0, 0.0]), 300, 1e9))
    np.testing.assert_allclose(record.values[:3], [3276.7, -3276.8, 0.0])
    assert (record.sequence, record.time) == (300 - 256, pytest.approx(4294.967295))


def test_poses_as_rotation_vector_and_as_quaternion(tmp_path: Path) -> None:
    layout = read_layout(_file(tmp_path))
    state, command = WireRecord(layout, "state"), WireRecord(layout, "command")
    turn = Rotation.from_quat(START[3:])
    assert state.unpack(struct.pack(">I6d", 3, *(1e3 * START[:3]), *turn.as_rotvec()))
    np.testing.assert_allclose(state.values, START, atol=1e-12)
    assert math.isnan(state.time)
    data = command.pack(START, 1, 0.0, flag=1)
    assert struct.unpack(">7dB", data) == (*START[:3], START[6], *START[3:6], 1)
    # not a unit quaternion
    assert not command.unpack(struct.pack(">7dB", *START[:3], 1.0, 1.0, 0.0, 0.0, 0))
    assert not command.unpack(struct.pack(">7dB", math.nan, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0))


def test_the_default_layout_ends_with_the_crc_32_of_all_before_it() -> None:
    record = WireRecord(default_layout(), "sensor")
    data = record.pack(np.arange(6.0), 7, 0.25, flag=0)
    assert data[:-4] == struct.pack("<IdI6d", 7, 0.25, 0, *range(6))
    assert int.from_bytes(data[-4:], "little") == zlib.crc32(data[:-4])


def test_faults_of_a_layout_are_told_by_line_and_column(tmp_path: Path) -> None:
    text = LAYOUT.replace("type: crc16}", "type: uint16}").replace(
        "{name: fy, type: int16", "{name: fx, type: int16"
    )
    text = text.replace("{name: sequence, type: uint8}", "{name: sequence, type: float32}").replace(
        "value: 0x5AA5", "value: 0x5AA55"
    )
    with pytest.raises(InputError) as raised:
        read_layout(_file(tmp_path, text))
    said = {fault.key: fault.message for fault in raised.value.faults}
    assert "needs a whole number as value that fits its type" in said["sensor.0"]
    assert (
        said["sensor.1.type"]
        == "does not fit sequence (got 'float32'); allowed: uint8, uint16, uint32, uint64"
    )
    assert said["sensor.5.name"] == "is given twice (got 'fx'); each value may stand once"
    assert "a crc is the last field" in said["sensor.10.type"]
    assert said["sensor"].endswith("needed: fx fy fz tx ty tz")
    assert all(fault.line for fault in raised.value.faults)


def test_a_platform_over_the_loopback_address_and_its_stop() -> None:
    ours, theirs = free_ports(2)
    server = platform_server(f"udp://127.0.0.1:{theirs}?peer=127.0.0.1:{ours}")
    client = platform_client(f"udp://127.0.0.1:{theirs}?listen={ours}&connect=5")
    ticks = iter(range(1_000_000))
    with (
        server,
        going(
            lambda: server.publish(
                server.command if server.commanded else START, 0.001 * next(ticks)
            )
        ),
        client,
    ):
        np.testing.assert_array_equal(client.state.pose, START)
        target = START.copy()
        target[0] += 0.01
        client.command(target)
        until(lambda: client.wait(1.0) and client.state.pose[0] == target[0])
        np.testing.assert_array_equal(client.held[:7], target)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"x" * 40, ("127.0.0.1", ours))
            until(lambda: client.poll() is not None and client.counts[Event.SENDER] == 1)
        client.stop()
        until(lambda: server.stopped)
        client.command(START)
        assert not server.wait(0.05)  # what has stopped stays stopped


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=r"listen: is missing; give the end of this machine where the device's records "
        r"arrive as listen=",
    ):
        sensor_client("udp://127.0.0.1").open()
    with pytest.raises(InputError, match=r"peer: is missing; give the controller's end"):
        sensor_server("udp://127.0.0.1")
    with pytest.raises(InputError, match=r"peer: is not address:port"):
        sensor_server("udp://127.0.0.1?peer=here")
    with pytest.raises(InputError, match=r"has no state record; describe it there"):
        platform_client(
            f"udp://127.0.0.1?layout={_file(tmp_path, LAYOUT.partition('state:')[0])}&listen=1"
        )
    (port,) = free_ports(1)
    with pytest.raises(
        DeviceError, match=r"no good record in 0.05 s .0 malformed, 0 from other senders"
    ):
        sensor_client(f"udp://127.0.0.1?listen={port}&connect=0.05").open()
