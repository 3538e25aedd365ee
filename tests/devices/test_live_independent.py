"""`live` and `emulate` against devices and clients that were written from the protocols'
descriptions and share nothing with them.
"""

from __future__ import annotations

import numpy as np
import pytest

from hiltestbed.devices.emulate import Emulator
from hiltestbed.devices.rdt import RdtServer
from hiltestbed.devices.session import Options, Session
from hiltestbed.devices.timekeeping import SimulatedClock
from hiltestbed.devices.watch import CommunicationLimits
from tests.devices.independent.rdt_peer import IndependentRdtClient, IndependentRdtSensor
from tests.devices.independent.rsi_peer import IndependentRobot, IndependentSensorSystem
from tests.devices.lockstep import scenario_of, watched
from tests.devices.running import free_ports

COUNTS = 1e6
LENIENT = CommunicationLimits(
    misses_in_a_row=1_000_000,
    misses_in_window=1_000_000,
    disturbances_in_window=1_000_000,
    stale=1000.0,
)


def test_an_independent_robot_and_sensor_play_a_run() -> None:
    """A free flight: the robot, whose next cycle begins when it has its answer, goes where the
    numerical model goes.
    """
    scenario = scenario_of(
        "02-bumper", "rsi", duration=0.3, approach__gap=0.1, approach__velocity=[0.01, -0.02, 0.04]
    )
    scenario = watched(scenario, LENIENT)
    (port,) = free_ports(1)
    robot = IndependentRobot(port, position=(0.0, 0.0, -0.1), angles=(0.0, 0.0, 0.0), patience=0.5)
    sensor = IndependentRdtSensor(lambda k: [7_000_000, 0, 0, 0, 0, 0])  # 7 N before the tare
    try:
        url = f"rdt://127.0.0.1:{sensor.port}?counts_per_force={COUNTS}&counts_per_torque={COUNTS}"
        session = Session(
            scenario,
            Options(
                url,
                f"rsi://127.0.0.1:{port}?connect=5",
                armed=True,
                # this robot's time passes with the answers: its clock is the wall clock here
                clock=SimulatedClock(lambda: 1e-3 * robot.ipoc),
            ),
        )
        with session.connected():
            observed = session.observe()
            session.run()
            followed = robot.position.copy()
    finally:
        robot.close()
        sensor.close()
    run = session.result(observed)
    assert run.summary["status"] == "completed"
    assert run.summary["live"]["tare"][0] == pytest.approx(7.0)
    assert run.trace is not None
    np.testing.assert_allclose(run.trace["wrench_meas"], 0.0, atol=1e-9)
    expected = np.array([0.0, 0.0, -0.1]) + 0.3 * np.array([0.01, -0.02, 0.04])
    np.testing.assert_allclose(run.trace["pose_cmd"][-1, :3], expected, atol=1e-6)
    # and then to rest, half a run-up further
    np.testing.assert_allclose(followed, session.rig.last[:3], atol=1e-6)
    np.testing.assert_allclose(
        followed, expected + 0.5 * 0.2 * np.array([0.01, -0.02, 0.04]), atol=1e-4
    )


def test_independent_clients_move_the_emulated_rig_and_read_its_force() -> None:
    """Pressed 1 mm into a spring of 1e5 N/m: 100 N, by a client of RDT and a sensor system of RSI
    of others.
    """
    scenario = scenario_of(
        "02-bumper",
        "rsi",
        sensor__delay=0.0,
        rig__platform__tracking="ideal",
        mechanism__contact={"stiffness": 1.0e5, "damping": 0.0},
    )
    system = IndependentSensorSystem()
    emulator = Emulator(scenario, "rdt://127.0.0.1:0", f"rsi://127.0.0.1:{system.port}")
    with emulator:
        assert isinstance(emulator.sensor, RdtServer)
        client = IndependentRdtClient(emulator.sensor.address, COUNTS, COUNTS)
        client.request(2)
        told, record = {"frame": [0.0] * 6}, {"force": [0.0] * 3, "rdt": 0}
        for k in range(60):
            emulator.cycle()
            told, record = system.receive(), client.records()[0]
            # mm from -10 to +1
            system.answer([0.0, 0.0, 11.0 * min(1.0, (k + 1) / 50), 0.0, 0.0, 0.0])
            while not emulator.platform.wait(1.0):
                pass
        client.close()
        system.close()
    assert record["rdt"] == 60
    assert told["frame"][2] == pytest.approx(1.0, abs=1e-5)
    assert record["force"][2] == pytest.approx(100.0, abs=1e-3)
