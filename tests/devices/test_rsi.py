"""KUKA's RobotSensorInterface against peers that share no code with it."""

from __future__ import annotations

import re
import socket

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.rsi import Odd, RsiClient, RsiServer, read_telegram
from hiltestbed.devices.table import platform_client, platform_server
from hiltestbed.errors import InputError
from tests.devices.independent.rsi_peer import (
    IndependentRobot,
    IndependentSensorSystem,
    from_frame,
    to_frame,
)
from tests.devices.running import START, free_ports, going, until


def _client(port: int, options: str = "") -> RsiClient:
    client = platform_client(f"rsi://127.0.0.1:{port}?connect=5{options}")
    assert isinstance(client, RsiClient)
    return client


def _server(port: int, options: str = "") -> RsiServer:
    server = platform_server(f"rsi://127.0.0.1:{port}?{options}")
    assert isinstance(server, RsiServer)
    return server


def _pose(position, rotation: Rotation) -> np.ndarray:
    return np.concatenate([position, rotation.as_quat()])


def _far(pose: np.ndarray, position, rotation: Rotation) -> tuple[float, float]:
    """Distance [m] and angle [rad] of a pose from another."""
    return float(np.linalg.norm(pose[:3] - position)), float(
        (Rotation.from_quat(pose[3:]) * rotation.inv()).magnitude()
    )


@pytest.mark.parametrize("correction", ["absolute", "relative"])
def test_the_client_moves_an_independent_robot(correction: str) -> None:
    """Through poses up to 50 mm and 0.2 rad off: what is commanded is where the robot goes."""
    (port,) = free_ports(1)
    robot = IndependentRobot(port, relative=correction == "relative", patience=0.2)
    try:
        with _client(port, f"&correction={correction}") as client:
            assert client.clock == "device"
            assert client.period == 0.004
            np.testing.assert_allclose(client.start[:3], robot.start_position, atol=1e-9)
            rng = np.random.default_rng(3)
            assert client.wait(5.0)
            for k in range(1, 41):
                position = robot.start_position + rng.uniform(-0.05, 0.05, 3)
                rotation = Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3)) * robot.start_rotation
                client.command(_pose(position, rotation))
                assert client.wait(5.0)
                distance, angle = _far(client.state.pose, position, rotation)
                # each telegram is rounded to 1e-6 mm and 1e-6 deg; relative ones add up
                steps = k if correction == "relative" else 1
                assert distance < 2e-9 * (steps + 1)
                assert angle < 5e-8 * (steps + 1)
            assert (
                client.counts[Event.MALFORMED]
                == client.counts[Event.SENDER]
                == client.counts[Event.LOST]
                == 0
            )
    finally:
        robot.close()


def test_the_client_holds_and_counts_what_the_controller_calls_late() -> None:
    (port,) = free_ports(1)
    robot = IndependentRobot(port, patience=0.1)
    try:
        with _client(port) as client:
            target = client.start.copy()
            target[2] += 0.01

            def arrived() -> bool:
                client.wait(1.0)
                client.command(target)
                return abs(robot.position[2] - 1.11) < 1e-8

            until(arrived)
            for _ in range(5):
                assert client.wait(1.0)
                client.hold()
            assert robot.position[2] == pytest.approx(1.11, abs=1e-8)
            before = client.counts[Event.LATE]
            robot.late += 3
            until(lambda: client.wait(1.0) and client.counts[Event.LATE] >= before + 3)
            with pytest.raises(DeviceError, match=r"not finite"):
                client.command(np.full(7, np.nan))
    finally:
        robot.close()


@pytest.mark.parametrize("reference", ["base", "tool"])
@pytest.mark.parametrize("correction", ["absolute", "relative"])
def test_an_independent_sensor_system_moves_the_emulated_robot(
    correction: str, reference: str
) -> None:
    system = IndependentSensorSystem()
    server = _server(system.port, f"correction={correction}&reference={reference}")
    with server:
        position, rotation = START[:3].copy(), Rotation.from_quat(START[3:])
        rng = np.random.default_rng(5)
        pose = START.copy()
        for k in range(20):
            server.publish(pose, 0.004 * k)
            telegram = system.receive()
            np.testing.assert_allclose(telegram["frame"][:3], 1e3 * pose[:3], atol=1e-6)
            np.testing.assert_allclose(
                telegram["frame"], to_frame(pose[:3], Rotation.from_quat(pose[3:])), atol=1e-5
            )
            assert telegram["ipoc"] == RsiServer.FIRST_IPOC + 4 * (k + 1)
            frame = [*rng.uniform(-3, 3, 3), *rng.uniform(-2, 2, 3)]
            system.answer(frame)
            until(server.poll)
            shift, turn = from_frame(frame)
            p0, r0 = (
                (position, rotation)
                if correction == "relative"
                else (START[:3], Rotation.from_quat(START[3:]))
            )
            position, rotation = (
                (p0 + shift, turn * r0)
                if reference == "base"
                else (p0 + r0.apply(shift), r0 * turn)
            )
            distance, angle = _far(server.command, position, rotation)
            steps = k + 1 if correction == "relative" else 1
            assert distance < 1e-11 * steps  # telegrams here have eight decimals
            assert angle < 2e-10 * steps
            pose = server.command.copy()
        assert server.late == 0
    system.close()


def test_late_and_missing_answers_are_counted_held_and_stop_the_controller() -> None:
    system = IndependentSensorSystem()
    with _server(system.port, "late_limit=3") as server:
        server.publish(START, 0.0)
        first = system.receive()
        system.answer([5.0, 0, 0, 0, 0, 0])
        until(server.poll)
        held = server.command.copy()
        server.publish(START, 0.004)
        system.receive()
        system.answer([9.0, 0, 0, 0, 0, 0], ipoc=first["ipoc"])  # the cycle before: too late
        until(lambda: server.poll() or server.counts[Event.REORDERED] == 1)
        server.publish(START, 0.008)
        assert system.receive()["delay"] == 1
        np.testing.assert_array_equal(server.command, held)
        for k in range(3):
            assert server.stopped is None
            server.publish(START, 0.012 + 0.004 * k)
        assert server.stopped is not None
        assert "4 answers came late or not at all (Timeout 3)" in server.stopped
    system.close()


def test_a_relative_correction_that_is_held_goes_on() -> None:
    """HOLDON = 1: the last step is taken again in each cycle without an answer; HOLDON = 0:
    none.
    """
    for hold, expected in (("true", 3e-3), ("false", 1e-3)):
        system = IndependentSensorSystem()
        with _server(system.port, f"correction=relative&hold={hold}") as server:
            server.publish(START, 0.0)
            system.receive()
            system.answer([1.0, 0, 0, 0, 0, 0])
            until(server.poll)
            for k in range(3):
                server.publish(START, 0.004 * (k + 1))
            assert server.command[0] - START[0] == pytest.approx(expected, abs=1e-12)
        system.close()


def test_what_keeps_a_client_from_opening_is_said() -> None:
    (port,) = free_ports(1)
    with pytest.raises(
        DeviceError, match=r"no telegram of a robot in 0.05 s; check IP_NUMBER and PORT"
    ):
        platform_client(f"rsi://127.0.0.1:{port}?connect=0.05").open()
    robot = IndependentRobot(port)
    with (
        _client(port),
        pytest.raises(InputError, match=rf"UDP 127.0.0.1:{port} is in use by another program"),
    ):
        _client(port).open()
    robot.close()


ODD = {
    '<Rob><AIPos A1="0"/><IPOC>4</IPOC></Rob>': "without RIst (they hold AIPos, IPOC); add the tag",
    '<Rob><RIst X="1" Y="2" Z="3" A="0" B="0"/><IPOC>4</IPOC></Rob>': "RIst has no six plausible",
    '<Rob><RIst X="1" Y="2" Z="1e9" A="0" B="0" C="0"/><IPOC>4</IPOC></Rob>': "RIst has no six",
    '<Rob><RIst X="1" Y="2" Z="3" A="0" B="0" C="0"/></Rob>': "IPOC is no whole number",
    '<Robot><RIst X="1" Y="2" Z="3" A="0" B="0" C="0"/><IPOC>4</IPOC></Robot>': "root is <Robot>",
}


def test_telegrams_that_are_not_understood_are_described() -> None:
    for telegram, said in ODD.items():
        with pytest.raises(Odd, match=re.escape(said)):
            read_telegram(telegram.encode(), "Rob", "RIst")
    (port,) = free_ports(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        client = platform_client(f"rsi://127.0.0.1:{port}?connect=0.3")
        with (
            going(lambda: robot.sendto(b"hello", ("127.0.0.1", port)), 0.02),
            pytest.raises(DeviceError, match=r"telegrams arrive from 127.0.0.1:.* not plain XML"),
        ):
            client.open()
