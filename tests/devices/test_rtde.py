"""Universal Robots' RTDE against peers that share no code with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.rtde_controller import RtdePlatformServer
from hiltestbed.devices.table import platform_client, platform_server, sensor_client
from hiltestbed.errors import InputError
from tests.devices.independent.rtde_peer import IndependentController
from tests.devices.running import START, free_ports, going, until

WRENCH = np.array([1.5, -2.25, 310.125, 0.5, -0.125, 7.75])
ROBOT = {
    "actual_TCP_pose": [0.3, -0.1, 0.4, 0.2, -2.0, 1.0],
    "actual_TCP_force": WRENCH.tolist(),
    "safety_status_bits": [1],
    "robot_status_bits": [3],
}


def test_the_client_commands_the_emulated_robot_and_has_its_registers_to_itself() -> None:
    server = platform_server("rtde://127.0.0.1:0")
    assert isinstance(server, RtdePlatformServer)
    ticks, target = iter(range(1_000_000)), START + np.array([0.1, 0.0, -0.2, 0, 0, 0, 0])
    with server, going(lambda: server.publish(START, 0.008 * next(ticks))):
        url = f"rtde://127.0.0.1:{server.address[1]}?rate=125"
        with platform_client(url) as client:
            np.testing.assert_allclose(client.state.pose, START, atol=1e-12)
            client.command(target)
            until(lambda: abs(server.command[0] - target[0]) < 1e-12)
            np.testing.assert_allclose(server.command, target, atol=1e-12)
            with pytest.raises(DeviceError, match=r"input_double_register_24: IN_USE"):
                platform_client(url).open()
        until(lambda: not server._clients)
        with platform_client(url) as client:
            client.stop()
            until(lambda: server.stopped)


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
            platform_server(f"rtde://127.0.0.1:{server.address[1]}").open()
