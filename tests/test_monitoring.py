"""Touch, seat, capture and wear: recognised when they are there, and not when they are not."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from hiltestbed import build
from hiltestbed.analysis.assessment import monitored
from hiltestbed.bench.contacts import BenchContact, bounce
from hiltestbed.loop import Loop
from hiltestbed.scenario import Scenario
from hiltestbed.scenario.monitoring import ContactEstimate
from hiltestbed.simulation import simulate
from hiltestbed.supervision.monitoring import ProcessMonitor, wear
from tests.running import shipped

FORCE = {"kind": "resynchronised"}


def _watch(scenarios: list[Scenario]) -> tuple[ProcessMonitor, Loop]:
    loop, monitor = Loop(scenarios), build.monitor(scenarios)
    for _ in range(max(s.ticks for s in scenarios)):
        loop.step()
        monitor.update(loop.measurement.wrench, loop.measurement.pose, loop.measurement.twist)
    return monitor, loop


def test_a_bounce_is_a_touch_and_no_more() -> None:
    """Touch is said two readings after the force arrives, a delay after it was there; nothing
    seats, nothing is captured.
    """
    contacts = [BenchContact(4.0, d, 0.05, seed=i) for i, d in enumerate([0.002, 0.01] * 20)]
    monitor, loop = _watch([c.scenario(FORCE) for c in contacts])
    truth = loop.tally.first_tick / contacts[0].scenario(FORCE).rate
    late = monitor.touch - truth - np.array([c.delay for c in contacts])
    assert (late >= 0.0).all()
    assert (late <= 3.0 / 2000.0).all()
    assert np.isnan(monitor.seat).all()
    assert np.isnan(monitor.capture).all()


def test_noise_alone_is_no_touch() -> None:
    scenario = shipped(
        "01-free-flight", {"rig.platform.tracking": "ideal", "sensor.noise": 1.0, "duration": 1.0}
    )
    monitor, _ = _watch([scenario.model_copy(update={"seed": seed}) for seed in range(32)])
    assert np.isnan(monitor.touch).all()


def test_a_stop_behind_a_spring_is_a_seat() -> None:
    """A second spring, 5 k, 0.5 mm in: the stiffness over 20 ms rises from k to 6 k."""
    contact = BenchContact(2.0, 0.005, 0.05)
    stop = {"kind": "contact.hard_stop", "position": 1.2e-3, "stiffness": 5.0 * contact.stiffness}
    scenario = replace(contact, changes={"effects": [stop]}).scenario(FORCE)
    monitor, loop = _watch([scenario])
    assert monitor.first_stiffness[0] == pytest.approx(contact.stiffness, rel=0.1)
    # at the speed of approach; a little later in truth
    reached = loop.tally.first_tick[0] / scenario.rate + 1.2e-3 / contact.speed
    assert reached < monitor.seat[0] < reached + 0.005 + 4.0 * 0.02  # the delay, and four memories
    assert np.isnan(monitor.capture[0])


def test_a_mechanism_that_pulls_has_captured() -> None:
    scenario = shipped("13-ring-down", {"duration": 0.5, "rig.platform.tracking": "ideal"})
    monitor, _ = _watch([scenario])
    assert monitor.touch[0] < monitor.capture[0] < 0.3


def _estimates(contact: BenchContact, seeds: range) -> list[ContactEstimate]:
    result = bounce([replace(contact, seed=seed).scenario(FORCE) for seed in seeds])
    e = result.loop.identification
    assert e is not None
    names = ("stiffness", "damping", "stiffness_sd", "damping_sd")
    return [
        ContactEstimate(**{name: float(getattr(e, name)[i, 2]) for name in names})
        for i in range(len(seeds))
    ]


def test_a_scenario_asks_for_it() -> None:
    """The shipped one: 2 % softer than three contacts known to 0.04 % each: 40 sigma."""
    batch = simulate([shipped("24-worn-buffer")])
    found = batch.outcomes[0]["monitoring"]
    figures = batch.figures[0]
    assert (
        figures.first_contact + 0.005
        <= found["touch"]
        <= figures.first_contact + 0.005 + 3.0 / 2000.0
    )
    assert found["first_stiffness"] == pytest.approx(98000.0, rel=0.03)
    assert (found["seat"], found["capture"]) == (None, None)
    assert found["wear"]["alarm"]
    assert found["wear"]["stiffness_change"] == pytest.approx(-0.02, abs=0.002)
    assert batch.identification[0]["z"]["stiffness_true"] == pytest.approx(98000.0)
    healthy = simulate([shipped("24-worn-buffer", {"effects": []})]).outcomes[0]["monitoring"]
    assert not healthy["wear"]["alarm"]


def test_one_that_does_not_ask_is_not_watched() -> None:
    loop = Loop([shipped("02-bumper")])
    assert loop.monitor is None


def test_wear_is_told_and_its_false_alarms_are_as_rare_as_promised() -> None:
    """At 5 %, 200 healthy contacts raise 10 alarms, three standard deviations 9. A spring that is
    1 % softer is always told: 20 sigma.
    """
    contact = BenchContact(4.0, 0.01, 0.05)
    baseline, healthy = _estimates(contact, range(1000, 1010)), _estimates(contact, range(200))
    alarms = sum(wear(baseline, one, false_alarm_rate=0.05).alarm for one in healthy)
    assert 1 <= alarms <= 19
    worn = _estimates(replace(contact, frequency=contact.frequency * np.sqrt(0.99)), range(20))
    found = [wear(baseline, one, false_alarm_rate=0.001) for one in worn]
    assert all(f.alarm for f in found)
    assert np.mean([f.stiffness_change for f in found]) == pytest.approx(-0.01, abs=0.001)


def test_a_contact_without_damping_has_no_relative_change_of_it() -> None:
    elastic = ContactEstimate(stiffness=2e4, damping=0.0, stiffness_sd=10.0, damping_sd=1.0)
    found = wear(
        [elastic], ContactEstimate(stiffness=2.2e4, damping=5.0, stiffness_sd=10.0, damping_sd=1.0)
    )
    assert (found.stiffness_change, found.damping_change) == (pytest.approx(0.1), None)
    events = dict.fromkeys(("touch", "seat", "capture"), None)
    assert monitored({"monitoring": {**events, "wear": asdict(found)}}) == (
        "nothing",
        "worn: stiffness +10 %",
    )
