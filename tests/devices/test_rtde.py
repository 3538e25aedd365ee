"""Universal Robots' RTDE against peers that share no code with it."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.rtde_controller import RtdePlatformServer, RtdeSensorServer
from hiltestbed.devices.table import platform_client, platform_server, sensor_client, sensor_server
from hiltestbed.errors import InputError
from tests.devices.independent.rtde_peer import IndependentController, IndependentRtdeClient
from tests.devices.running import START, free_ports, going, until

WRENCH = np.array([1.5, -2.25, 310.125, 0.5, -0.125, 7.75])
ROBOT = {
    "actual_TCP_pose": [0.3, -0.1, 0.4, 0.2, -2.0, 1.0],
    "actual_TCP_force": WRENCH.tolist(),
    "safety_status_bits": [1],
    "robot_status_bits": [3],
}
REGISTERS = ",".join(
    [*(f"input_double_register_{24 + i}" for i in range(6)), "input_int_register_24"]
)


def _address(server: RtdeSensorServer | RtdePlatformServer) -> tuple[str, int]:
    return server.address


def test_an_independent_client_reads_and_commands_the_emulated_robot() -> None:
    server = platform_server("rtde://127.0.0.1:0")
    assert isinstance(server, RtdePlatformServer)
    ticks = iter(range(1_000_000))
    target = [0.5, 0.1, 0.2, 0.3, -0.4, 0.5]
    with server, going(lambda: server.publish(START, 0.008 * next(ticks))):
        client = IndependentRtdeClient(
            _address(server), "timestamp,actual_TCP_pose,safety_status_bits", REGISTERS
        )
        assert client.accepted == client.started == b"\x01"
        assert client.output_types == ["DOUBLE", "VECTOR6D", "UINT32"]
        assert client.input_types == ["DOUBLE"] * 6 + ["INT32"]
        first, second = (struct.unpack("!B7dI", client.data()) for _ in range(2))
        assert first[0] == client.output_recipe
        assert second[1] - first[1] == pytest.approx(0.008)
        np.testing.assert_allclose(first[2:5], START[:3])
        np.testing.assert_allclose(
            first[5:8], Rotation.from_quat(START[3:]).as_rotvec(), atol=1e-12
        )
        assert first[8] == 1
        client.write("6di", *target, 1)
        until(lambda: server.commanded)
        np.testing.assert_allclose(server.command[:3], target[:3])
        assert (
            Rotation.from_quat(server.command[3:]) * Rotation.from_rotvec(target[3:]).inv()
        ).magnitude() < 1e-12
        assert client.ask("P") == b"\x01"
        client.close()


def test_unknown_fields_and_taken_registers_are_refused_by_name() -> None:
    server = sensor_server("rtde://127.0.0.1:0")
    assert isinstance(server, RtdeSensorServer)
    with server, going(lambda: server.publish(WRENCH, 0.0)):
        first = IndependentRtdeClient(_address(server), "timestamp,no_such_field", REGISTERS)
        assert first.output_types == ["DOUBLE", "NOT_FOUND"]
        assert first.started == b"\x00"
        second = IndependentRtdeClient(_address(server), "timestamp", REGISTERS)
        assert set(second.input_types) == {"IN_USE"}
        assert second.ask("V", struct.pack("!H", 7)) == b"\x00"
        first.close()
        second.close()


def test_the_clients_read_and_command_an_independent_controller() -> None:
    controller = IndependentController(ROBOT)
    with platform_client(f"rtde://127.0.0.1:{controller.port}?rate=125&connect=5") as client:
        np.testing.assert_allclose(client.state.pose[:3], ROBOT["actual_TCP_pose"][:3])
        assert (
            Rotation.from_quat(client.state.pose[3:])
            * Rotation.from_rotvec(ROBOT["actual_TCP_pose"][3:]).inv()
        ).magnitude() < 1e-9
        pose = np.concatenate([[0.31, -0.1, 0.4], Rotation.from_rotvec([0.1, 0.2, 0.3]).as_quat()])
        client.command(pose)
        until(lambda: len(controller.received) == 2)
        # opening holds where it was found
        np.testing.assert_allclose(controller.received[0][:6], ROBOT["actual_TCP_pose"], atol=1e-9)
        np.testing.assert_allclose(
            controller.received[1][:6], [0.31, -0.1, 0.4, 0.1, 0.2, 0.3], atol=1e-12
        )
        assert [received[6] for received in controller.received] == [1, 2]
        client.stop()
        until(lambda: controller.received[-1][6] == -1)
        for _ in range(10):
            assert client.wait(5.0)
        assert client.counts[Event.LOST] == client.counts[Event.MALFORMED] == 0
    controller.close()
    controller = IndependentController(ROBOT)
    with sensor_client(f"rtde://127.0.0.1:{controller.port}?rate=125&connect=5") as sensor:
        assert sensor.wait(5.0)
        np.testing.assert_array_equal(sensor.reading.wrench, WRENCH)
        first = sensor.reading.device_time
        assert sensor.wait(5.0)
        assert math.isclose(
            (sensor.reading.device_time - first) / 0.008,
            round((sensor.reading.device_time - first) / 0.008),
        )
        controller.values = ROBOT | {"safety_status_bits": [4]}  # protective stop
        until(lambda: sensor.poll() is False and sensor.counts[Event.STATUS] > 0)
        assert sensor.reading.status & 4
    controller.close()
    until(lambda: sensor.poll() is False)


def test_what_keeps_a_client_from_opening_is_said() -> None:
    (port,) = free_ports(1)
    with pytest.raises(DeviceError, match=r"no connection .* check that the device is on"):
        sensor_client(f"rtde://127.0.0.1:{port}").open()
    controller = IndependentController(ROBOT)
    with pytest.raises(DeviceError, match=r"does not give ft_raw_wrench: NOT_FOUND"):
        sensor_client(f"rtde://127.0.0.1:{controller.port}?wrench=ft_raw_wrench").open()
    controller.close()
    controller = IndependentController(ROBOT, in_use=True)
    with pytest.raises(
        DeviceError, match=r"input_double_register_30: IN_USE.*give another register"
    ):
        platform_client(f"rtde://127.0.0.1:{controller.port}?first_register=30").open()
    controller.close()
    controller = IndependentController(ROBOT | {"robot_status_bits": [1]})
    with pytest.raises(
        DeviceError,
        match=r"no pose in 0.2 s; its status is 0x80000000; check the robot's mode, and start its "
        r"program",
    ):
        platform_client(f"rtde://127.0.0.1:{controller.port}?connect=0.2&rate=125").open()
    controller.close()


def test_a_port_in_use() -> None:
    with platform_server("rtde://127.0.0.1:0") as server:
        assert isinstance(server, RtdePlatformServer)
        with pytest.raises(InputError, match=r"TCP 127.0.0.1:.* is in use by another program"):
            platform_server(f"rtde://127.0.0.1:{_address(server)[1]}").open()
