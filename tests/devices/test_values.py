"""Every value is checked where it is received: what is not physical is never used, stops the run in
its cycle, and the run folder is written all the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.devices import poses
from hiltestbed.devices.emulate import Emulator
from hiltestbed.devices.interface import Event
from hiltestbed.devices.layout import WireRecord, default_layout
from hiltestbed.devices.session import Session, _written
from hiltestbed.devices.table import platform_client, platform_server, sensor_client, sensor_server
from hiltestbed.devices.watch import CommunicationLimits, CommunicationWatch
from hiltestbed.run_folder.store import read_run, write_run
from tests.devices.lockstep import played, scenario_of
from tests.devices.running import START, going, until, urls
from tests.devices.test_live_faults import _sends

LENIENT = CommunicationLimits(
    misses_in_a_row=10_000, misses_in_window=10_000, disturbances_in_window=10_000, stale=1e3
)
WRENCH = np.array([1.0, -2.0, 30.0, 0.1, 0.2, -0.3])


@contextmanager
def _connected(protocol: str, role: str) -> Iterator[tuple]:
    """A client and its server, open; :func:`publish` sends good values."""
    ours, theirs = urls(protocol)
    sensor = role == "sensor"
    client = sensor_client(ours) if sensor else platform_client(ours)
    server = sensor_server(theirs) if sensor else platform_server(theirs)
    good, tick = (WRENCH if sensor else START), 0

    def publish(values: np.ndarray = good) -> None:
        nonlocal tick
        tick += 1
        server.publish(values, 0.002 * tick)

    with server, ExitStack() as stack:
        with going(publish, 0.002):
            stack.enter_context(client)
            until(lambda: client.wait(0.1))
        while client.wait(0.02):
            pass
        yield client, publish


def _turned(pose: np.ndarray, to: float, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """``pose`` whose rotation vector on the wire is ``to`` about x."""
    frame = np.array([*pose[:3], to, 0.0, 0.0])
    monkeypatch.setattr(poses, "rotation_vector_from_pose", lambda _: frame)
    return pose


def _with(values: np.ndarray, index: int, value: float) -> np.ndarray:
    out = values.copy()
    out[index] = value
    return out


CASES = [
    ("udp", "sensor", lambda m: _with(WRENCH, 5, -2e7)),
    ("shm", "sensor", lambda m: _with(WRENCH, 0, 1e300)),
    ("rtde", "sensor", lambda m: _with(WRENCH, 1, -1e155)),
    ("udp", "platform", lambda m: _with(START, 1, 1e160)),
    ("shm", "platform", lambda m: _with(START, 6, 1e9)),
    ("rtde", "platform", lambda m: _turned(START, 1e200, m)),
]


@pytest.mark.parametrize(("protocol", "role", "bad"), CASES)
def test_a_value_that_is_not_physical_is_never_taken(
    protocol: str,
    role: str,
    bad: Callable[[pytest.MonkeyPatch], np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And stops in its cycle, however many rejected records are allowed."""
    with _connected(protocol, role) as (client, publish):
        watch = CommunicationWatch(client, LENIENT, role)
        watch.start()
        before = client.sample.values.copy()
        malformed, sequence = client.counts[Event.MALFORMED], client.sample.sequence
        with monkeypatch.context() as changed:
            publish(bad(changed))
        until(lambda: client.poll() or client.counts[Event.MALFORMED] > malformed)
        np.testing.assert_array_equal(client.sample.values, before)
        assert client.sample.sequence == sequence
        stop = watch.check(False)
        assert "which is not physical here" in stop.reason
        assert stop.reason.startswith(f"{role} {client.where}: value ")


def test_the_folder_is_written_whatever_was_received(tmp_path: Path) -> None:
    record, huge = WireRecord(default_layout(), "state"), np.array([0.0, 1e160, 0, 0, 0, 0, 1.0])

    def change(data: bytes) -> list[bytes]:
        """The platform's state replaced, its number kept."""
        assert record.unpack(data)
        return [record.pack(huge, record.sequence, record.time)]

    def disturb(cycle: int, emulator: Emulator, session: Session) -> Collection[str]:
        if cycle != 700:  # in contact
            return ()
        _sends(emulator.platform, change)
        return ("platform",)

    outcome = played(scenario_of("02-bumper", "udp", duration=0.5), "udp", disturb)
    summary = outcome.run.summary
    assert summary["status"] == "stopped"
    assert "is 1e+160, which is not physical here" in summary["stop_reason"]
    write_run(outcome.run, tmp_path / "run", rerun=False)
    kept = read_run(tmp_path / "run")
    assert kept.summary["live"] == json.loads(json.dumps(summary["live"], allow_nan=False))
    assert np.isfinite(kept.trace["pose_act"]).all()


def test_the_scenarios_limits_bound_what_is_physical() -> None:
    """Ten times the limits of force and torque; a value within them is the business of `safety`."""
    scenario = scenario_of("02-bumper", "udp", safety__force=100.0, safety__torque=None)
    outcome = played(scenario.model_copy(update={"duration": 0.01}), "udp")
    largest = outcome.session.devices.sensor.reading.largest
    assert largest[:3].tolist() == [1000.0] * 3
    assert (largest[3:] > 1e6).all()
    place = outcome.session.devices.platform.state.largest
    assert place[:3].tolist() == [10.0 * 0.5] * 3


def test_what_is_not_finite_is_written_as_none() -> None:
    given = {"a": [1.0, math.nan, (math.inf, "x")], "b": {"c": np.float64(-math.inf), "d": 3}}
    assert _written(given) == {"a": [1.0, None, [None, "x"]], "b": {"c": None, "d": 3}}
