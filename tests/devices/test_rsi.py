"""KUKA's RobotSensorInterface against peers that share no code with it."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hiltestbed.devices.interface import DeviceError, Event
from hiltestbed.devices.rsi import Odd, RsiClient, RsiServer, RsiSettings, read_telegram
from hiltestbed.devices.table import platform_client, platform_server
from hiltestbed.errors import InputError
from tests.devices.independent.rsi_peer import IndependentRobot
from tests.devices.running import START, free_ports, going, until, urls


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
    relative = correction == "relative"
    with (
        closing(IndependentRobot(port, relative, patience=0.2)) as robot,
        _client(port, f"&correction={correction}") as client,
    ):
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
            steps = k if relative else 1
            assert distance < 2e-9 * (steps + 1)
            assert angle < 5e-8 * (steps + 1)
        assert not client.counts[[Event.MALFORMED, Event.SENDER, Event.LOST]].any()


def test_the_client_holds_and_counts_what_the_controller_calls_late() -> None:
    (port,) = free_ports(1)
    with closing(IndependentRobot(port, patience=0.1)) as robot, _client(port) as client:
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


@pytest.mark.parametrize("correction", ["absolute", "relative"])
@pytest.mark.parametrize("reference", ["base", "tool"])
def test_the_client_moves_the_emulated_robot(correction: str, reference: str) -> None:
    ours, theirs = urls("rsi")
    options = f"&correction={correction}&reference={reference}"
    server, rng = platform_server(theirs + options), np.random.default_rng(5)

    def cycle() -> None:
        server.publish(server.command if server.commanded else START, 0.0)
        server.wait(0.002)

    with server, going(cycle), platform_client(ours + options) as client:
        for _ in range(3):
            turned = Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3)) * Rotation.from_quat(START[3:])
            target = _pose(START[:3] + rng.uniform(-0.05, 0.05, 3), turned)

            def arrived(target: np.ndarray = target) -> bool:
                if client.wait(0.1):
                    client.command(target)
                distance, angle = _far(server.command, target[:3], Rotation.from_quat(target[3:]))
                return distance < 2e-8 and angle < 2e-7  # telegrams have six decimals

            until(arrived)


@pytest.fixture
def system() -> Iterator[tuple[int, Callable[..., int]]]:
    """The port of a sensor system, and what answers its next telegram; returns the IPOC."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(2.0)

        def answer(x: float, ipoc: int | None = None) -> int:
            """With a correction of ``x`` [mm]."""
            data, robot = opened.recvfrom(4096)
            newest = int(data.partition(b"<IPOC>")[2].partition(b"<")[0])
            frame = np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0])
            opened.sendto(RsiSettings().answer(frame, ipoc or newest), robot)
            return newest

        yield opened.getsockname()[1], answer


def test_late_and_missing_answers_are_counted_held_and_stop_the_controller(system) -> None:
    port, answer = system
    with _server(port, "late_limit=3") as server:
        server.publish(START, 0.0)
        first = answer(5.0)
        until(server.poll)
        held = server.command.copy()
        server.publish(START, 0.004)
        answer(9.0, ipoc=first)  # the cycle before: too late
        until(lambda: server.poll() or server.counts[Event.REORDERED] == 1)
        server.publish(START, 0.008)
        assert server.late == 1
        np.testing.assert_array_equal(server.command, held)
        for k in range(3):
            assert server.stopped is None
            server.publish(START, 0.012 + 0.004 * k)
        assert "4 answers came late or not at all (Timeout 3)" in str(server.stopped)


@pytest.mark.parametrize(("hold", "expected"), [("true", 3e-3), ("false", 1e-3)])
def test_a_relative_correction_that_is_held_goes_on(system, hold: str, expected: float) -> None:
    """HOLDON = 1: the last step is taken again in each cycle without an answer; 0: none."""
    port, answer = system
    with _server(port, f"correction=relative&hold={hold}") as server:
        server.publish(START, 0.0)
        answer(1.0)
        until(server.poll)
        for k in range(3):
            server.publish(START, 0.004 * (k + 1))
        assert server.command[0] - START[0] == pytest.approx(expected, abs=1e-12)


def test_what_keeps_a_client_from_opening_is_said() -> None:
    (port,) = free_ports(1)
    with pytest.raises(
        DeviceError, match=r"no telegram of a robot in 0.05 s; check IP_NUMBER and PORT"
    ):
        platform_client(f"rsi://127.0.0.1:{port}?connect=0.05").open()
    with (
        closing(IndependentRobot(port)),
        _client(port),
        pytest.raises(InputError, match=rf"UDP 127.0.0.1:{port} is in use by another program"),
    ):
        _client(port).open()


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
