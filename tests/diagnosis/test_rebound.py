"""The rebound tells rivals apart that one link alone cannot: what the loop made of a departure
shows in the speed after the contact.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.diagnosis.closed_loop import bounce_of, trace_motion, traces_of
from hiltestbed.diagnosis.find import cause_of, judge
from hiltestbed.diagnosis.investigate import investigate
from hiltestbed.diagnosis.rebound import speed_noise
from hiltestbed.measured import load_dataset
from hiltestbed.scenario import scenario_from
from tests.slow import SLOW, slow

from .recorded import NOMINAL, recorded

FORCES = {
    name: NOMINAL | {"compensation": {"force": {"kind": name}}} for name in ("none", "phase_lead")
}


@pytest.mark.parametrize(
    ("kind", "delay", "force"),
    [("sensor.delay", 0.0021, "phase_lead"), slow("log.skew", 0.0047, "none")],
)
def test_a_late_sensor_and_a_late_record_are_told_apart_without_what_the_loop_was_driven_with(
    tmp_path: Path, kind: str, delay: float, force: str
) -> None:
    """A delay raises the rebound by exp(pi w tau/2), 1.12 of it at 5 ms; a record that is stamped
    late leaves it as it is. A compensation that finds the delay by itself leaves it open.
    """
    dataset = load_dataset(
        recorded(tmp_path, [{"kind": kind, "delay": delay}], FORCES[force], ("wrench_comp",))
    )
    judged = judge(investigate(dataset))
    assert judged.verdict.verdict == "named"
    cause = cause_of(judged.verdict.causes[0])
    assert (cause.effect, cause.indistinguishable_from, cause.probability) == (kind, (), 1.0)
    assert cause.parameters["delay"].estimate == pytest.approx(delay, abs=2e-5)
    (words,) = judged.findings.weighed
    assert words.startswith("the rebound decides")


@SLOW
def test_where_no_rebound_is_on_record_both_are_left_open(tmp_path: Path) -> None:
    """The record ends in the contact; the one is then as likely as the other, whatever lies between
    the rows of the log.
    """
    short = NOMINAL | {"duration": 0.25}
    dataset = load_dataset(
        recorded(tmp_path, [{"kind": "sensor.delay", "delay": 0.0024}], short, ("wrench_comp",))
    )
    verdict = judge(investigate(dataset)).verdict
    assert verdict.verdict == "ambiguous"
    (cause,) = verdict.causes
    assert {cause.effect, *cause.indistinguishable_from} == {"sensor.delay", "log.skew"}
    assert cause.cause.probability == pytest.approx(0.5)


def test_the_speed_after_a_contact_spreads_by_the_impulse_of_the_noise() -> None:
    """White noise of a force is a random walk of the speed; while in contact, half a swing, the
    spring turns half of its variance into position. 24 samples give a standard deviation to 15 %.
    """
    noise = 2.0
    rig = {"sensor": {"delay": 0.005, "noise": noise}, "compensation": {"force": {"kind": "none"}}}
    scenarios = [
        scenario_from(NOMINAL | rig | {"seed": i}, {"approach.velocity.2": 0.04}) for i in range(24)
    ]
    bounces = [
        bounce_of(motion, scenarios[0])
        for t in traces_of(scenarios)
        if (motion := trace_motion(t)) is not None
    ]
    known = [b for b in bounces if b is not None and b.approach_speed and b.rebound_speed]
    assert len(known) == len(scenarios)
    gained = [
        b.rebound_speed - b.approach_speed for b in known if b.approach_speed and b.rebound_speed
    ]
    rows = 0.5 * (sum(known[0].after) - sum(known[0].before))
    assert 0.5 < np.std(gained) / speed_noise(scenarios[0], noise, rows) < 1.5
    assert speed_noise(scenarios[0], noise, 100.0) == pytest.approx(
        noise / 400.0 * 1e-3 * math.sqrt(100.0)
    )
