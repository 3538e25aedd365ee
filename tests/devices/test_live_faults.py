"""Faults on the wire while the loop runs: it stops in their cycle, and the platform is held or backs
out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed.devices.emulate import Emulator
from hiltestbed.devices.interface import Link
from hiltestbed.devices.session import Options, Session
from hiltestbed.devices.sockets import Datagrams
from hiltestbed.devices.watch import CommunicationLimits
from hiltestbed.run_folder.store import read_run
from hiltestbed.scenario import Scenario, dump_scenario
from hiltestbed.simulation import Run
from tests.devices.lockstep import Disturbance, played, scenario_of, watched
from tests.devices.running import urls

STRICT = CommunicationLimits(
    misses_in_a_row=0, misses_in_window=0, disturbances_in_window=0, stale=1000.0
)
LENIENT = STRICT.model_copy(
    update={"misses_in_a_row": 5, "misses_in_window": 1000, "disturbances_in_window": 1000}
)
SATURATED = 0x80020000  # a status word of RDT
TRAVEL, TOUCHED = 15, 450  # cycles after arming at 1 kHz: on the way to the start, and in contact


def _strict(platform: str, **changes: object) -> Scenario:
    near = {"duration": 0.2, "approach__gap": 0.003}
    return watched(scenario_of("02-bumper", platform, **near | changes), STRICT)


def _sends(link: Link, change: Callable[[bytes], list[bytes]]) -> None:
    """Have ``change`` done to every datagram that an emulated device sends in the coming cycle."""
    assert isinstance(link, Datagrams)
    real: Any = link._socket

    class Once:
        def sendto(self, data: bytes, towards: tuple[str, int]) -> int:
            link._socket = real
            for new in change(bytes(data)):
                real.sendto(new, towards)
            return len(data)

        def __getattr__(self, attribute: str) -> object:
            return getattr(real, attribute)

    link._socket = Once()  # type: ignore[assignment]


class Fault:
    """Something that happens to one device in cycle ``at``."""

    def __init__(self, kind: str, who: str, at: int) -> None:
        self.kind, self.who, self.at = kind, who, at
        self._kept: list[bytes] = []

    def __call__(self, cycle: int, emulator: Emulator, session: Session) -> Collection[str]:
        link = getattr(emulator, self.who)
        if self.kind == "gone":
            if cycle < self.at:
                return ()
            link.close()
            return (self.who,)
        if cycle == self.at:
            if self.kind == "lost":
                _sends(link, lambda data: [])
            elif self.kind in ("late", "reordered"):
                _sends(link, lambda data: self._kept.append(data) or [])
            elif self.kind == "truncated":
                _sends(link, lambda data: [data[:-5]])
            elif self.kind == "repeated":
                _sends(link, lambda data: [data, data])
                return ()
            elif self.kind == "status":
                _sends(link, lambda data: [data[:8] + SATURATED.to_bytes(4, "big") + data[12:]])
            return (self.who,)
        if cycle == self.at + 1 and self._kept:
            old = self._kept[0]
            _sends(link, lambda data: [old, data] if self.kind == "late" else [data, old])
        return ()


@pytest.mark.parametrize(
    ("kind", "who", "at"),
    [
        *((kind, "sensor", TOUCHED) for kind in ("late", "reordered", "truncated", "status")),
        *((kind, "platform", TOUCHED) for kind in ("lost", "repeated", "gone")),
        ("lost", "sensor", TRAVEL),
        ("gone", "platform", TRAVEL),
    ],
)
def test_a_fault_stops_the_run_in_its_cycle(kind: str, who: str, at: int) -> None:
    """Where nothing is allowed. A record that comes twice is seen with the next one at the latest;
    all others in their own cycle.
    """
    sent: list[int] = []

    def noted(cycle: int, emulator: Emulator, session: Session) -> Collection[str]:
        if not session.rig.stop:
            sent.append(cycle)
        return fault(cycle, emulator, session)

    fault = Fault(kind, who, at)
    outcome = played(_strict("udp"), "udp", noted)
    summary = outcome.run.summary
    assert summary["status"] == "stopped"
    assert f"{who} " in summary["stop_reason"]
    assert at <= sent[-1] <= at + (kind == "repeated")
    assert ("before the start" in summary["stop_reason"]) is (at == TRAVEL)
    if kind != "gone":
        held = outcome.emulator.platform.command
        np.testing.assert_allclose(held, outcome.session.rig.last, atol=1e-12)
    if at == TOUCHED:
        assert summary["peak_force"] > 10.0


def test_a_robot_that_fails_stops_the_run_in_its_cycle() -> None:
    outcome = played(_strict("rsi"), "rsi", Fault("lost", "platform", 80))
    assert outcome.run.summary["status"] == "stopped"
    assert "platform rsi://" in outcome.run.summary["stop_reason"]
    assert len(outcome.run.trace.t) < 80


def _losing(who: str, cycles: set[int]) -> Disturbance:
    """Loses the record of ``who`` in these cycles."""
    return lambda cycle, *given: Fault("lost", who, cycle)(cycle, *given) if cycle in cycles else ()


def test_a_lost_record_of_the_clock_costs_its_tick_and_not_the_time_base() -> None:
    """The platform's record is lost five times: the loop still makes as many ticks as the devices,
    and ends where it would have.
    """
    lenient = LENIENT.model_copy(update={"disturbances_in_window": 0})
    scenario = watched(scenario_of("01-free-flight", "udp", duration=0.4), lenient)
    outcome = played(scenario, "udp", _losing("platform", set(range(50, 10_000, 100))))
    assert outcome.run.summary["status"] == "completed"
    np.testing.assert_allclose(
        outcome.run.trace["pose_act"], outcome.run.trace["pose_cmd"], atol=2e-3
    )


def test_the_platform_backs_out_where_it_is_told_to() -> None:
    """With the sensor gone, in contact: 20 mm along -z of P from where it was held, no matter that
    the sensor stays silent.
    """
    scenario = _strict("udp", devices__on_stop__kind="retract")
    outcome = played(scenario, "udp", Fault("gone", "sensor", TOUCHED))
    held = outcome.run.trace["pose_cmd"][-1, 2]
    assert outcome.emulator.platform.command[2] == pytest.approx(held - 0.02, abs=2e-4)


LIMITS = {
    "safety.force": (20.0, "the sensor carries"),
    "devices.limits.position": (0.009, "A is commanded"),
    "devices.limits.speed": (0.02, "A is commanded to move at"),
    "devices.limits.acceleration": (0.05, "A is commanded to accelerate at"),
    "safety.energy": (1e-6, "the rig has created"),
    "safety.tracking_error": (1e-6, "the platform is"),
}


@pytest.mark.parametrize("key", LIMITS)
def test_a_limit_stops_the_run_before_anything_beyond_it_is_sent(key: str) -> None:
    limit, text = LIMITS[key]
    name = "03-bumper-delay-uncompensated"
    scenario = scenario_of(name, "udp", duration=0.8, **{key.replace(".", "__"): limit})
    outcome = played(scenario, "udp")
    reason = outcome.run.summary["stop_reason"]
    assert outcome.run.summary["status"] == "stopped"
    assert text in reason
    assert key in reason
    if key == "devices.limits.position":  # it stands beyond the limit: nothing at all is sent
        assert outcome.emulator.rig.pose[2] == pytest.approx(-scenario.approach.gap, abs=1e-6)
    else:
        np.testing.assert_allclose(
            outcome.emulator.platform.command, outcome.session.rig.last, atol=1e-12
        )


def test_a_run_that_its_supervision_stops_ends_the_command_with_status_3(
    call: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By the command itself, but for the wall clock: its devices move in lockstep."""

    def in_lockstep(scenario: Scenario, options: Options) -> Run:
        return played(
            scenario, "udp", Fault("gone", "platform", TOUCHED), record=options.record
        ).run

    monkeypatch.setattr("hiltestbed.devices.live.live", in_lockstep)
    file, folder = tmp_path / "s.yaml", tmp_path / "run"
    file.write_text(dump_scenario(_strict("udp")))
    (sensor, _), (platform, _) = urls("rdt"), urls("udp")
    devices = ("--sensor", sensor, "--platform", platform, "--arm", "--no-rerun")
    status, out, err = call("live", str(file), *devices, "--out", str(folder), "--json")
    summary = json.loads(out)
    assert (status, summary["status"]) == (3, "stopped")
    assert f"{summary['stop_reason']}; the run is in {folder}" in err
    assert read_run(folder).summary["status"] == "stopped"
    assert sorted(tmp_path.iterdir()) == [folder, file], "rows are left of a process that dies only"
