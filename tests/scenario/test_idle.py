"""Keys that act on nothing: what is said to have no effect has none, and a key that was given in
vain is warned of.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed import load_scenario
from hiltestbed.config.check import look_at
from hiltestbed.config.gallery import shipped
from hiltestbed.config.sense import warnings
from hiltestbed.scenario import Scenario, dump_scenario, resolved, scenario_from
from hiltestbed.scenario.idle import given_in_vain, idle_keys
from hiltestbed.signals import RunTrace
from hiltestbed.simulation import run_batch
from tests.slow import slow

BUMPER = shipped("scenarios") / "02-bumper.yaml"
SHORT = {
    "duration": 0.15,
    "approach.gap": 0.001,
    "sensor.delay": 0.003,
    "identification.kind": "none",
    "rate": 1000.0,
    "physics_rate": 2000.0,
}


def rig(kind: str, tracking: str, **more: Any) -> Scenario:
    return load_scenario(
        BUMPER, SHORT | {"rig.platform": {"kind": kind, "tracking": tracking}} | more
    )


def traced(scenario: Scenario) -> RunTrace:
    found = run_batch([scenario], trace=True)[0].trace
    assert found is not None
    return found


def changed(value: Any) -> Any:
    """Another value of the same kind; None where there is no other that surely holds."""
    if isinstance(value, dict):
        return {k: v if k == "kind" or changed(v) is None else changed(v) for k, v in value.items()}
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    if isinstance(value, float):
        return 1.25 * value + 0.125 * (value == 0.0)
    return value + 1 if value != 3 else None


@pytest.mark.parametrize(
    ("kind", "tracking"),
    [("pss33", "servo"), ("pss33", "response"), ("pss33", "ideal"), slow("serial_arm", "response")],
)
def test_keys_that_are_said_to_have_no_effect_have_none(kind, tracking) -> None:
    """All of them changed at once, the same trace to the last bit."""
    s = rig(kind, tracking)
    data, touched = resolved(s), 0
    for path, _ in idle_keys(s):
        owner: Any = data
        for part in path[:-1]:
            owner = owner[part]
        before = owner[path[-1]]
        if path[0] == "compensation":  # a kind is no number
            owner["motion"] = {"kind": "none"}
        elif path[-1] == "command":  # whose rates must divide
            before["delay_cycles"] += 2
            touched += 1
        elif (other := changed(before)) is not None:
            owner[path[-1]] = other
            touched += other != before
    assert touched > 2
    first, second = traced(s), traced(scenario_from(data))
    for column in ("pose_act", "wrench_true", "pose_cmd"):
        np.testing.assert_array_equal(first[column], second[column])


def test_what_stands_for_them_acts() -> None:
    delays = {}, {"rig.platform.response.delay": 0.004}
    first, second = (traced(rig("pss33", "response", **more))["pose_act"] for more in delays)
    assert np.abs(first - second).max() > 1e-5


def test_a_key_that_was_given_in_vain_is_named_with_what_to_do(tmp_path: Path) -> None:
    keys = {
        "rig.platform.command": {"delay_cycles": 3},
        "compensation.motion": {"kind": "feedforward"},
    }
    s = rig("pss33", "response", **keys)
    said = {text.partition(": has no effect")[0]: text for text in warnings(s)}
    assert "response.delay" in said["rig.platform.command.delay_cycles"]
    assert "inverse_model" in said["compensation.motion.kind"]
    file = tmp_path / "resolved.yaml"
    file.write_text(dump_scenario(s), encoding="utf-8")
    again = [keys for keys, _ in given_in_vain(load_scenario(file))]
    # of what a resolved file holds, only what is not the default
    assert again == [("rig.platform.command.delay_cycles",)]
    assert any("delay_cycles: has no effect" in remark for remark in look_at(file).remarks)


def test_a_key_that_acts_is_not_named() -> None:
    keys = {"rig.platform.command": {"delay_cycles": 3}, "rig.platform.bandwidth": 30.0}
    assert not list(given_in_vain(rig("pss33", "servo", **keys)))
    assert not list(given_in_vain(load_scenario(BUMPER)))


def test_what_a_mechanism_that_holds_leaves_aside() -> None:
    contact = {"stiffness": 2e4, "damping": 200.0, "friction": 0.2}
    keys = SHORT | {
        "mechanism": {"kind": "latched", "contact": contact},
        "compensation.force": {"kind": "resynchronised", "blending": 0.004},
        "approach.gap": 0.0,
    }
    plain = keys | {"mechanism.contact.friction": 0.0, "compensation.force.blending": 0.002}
    first, second = (load_scenario(BUMPER, changes) for changes in (keys, plain))
    assert {keys for keys, _ in given_in_vain(first)} == {
        ("mechanism.contact.friction",),
        ("compensation.force.blending",),
    }
    np.testing.assert_array_equal(traced(first)["pose_act"], traced(second)["pose_act"])


@pytest.mark.parametrize(("tracking", "named"), [("ideal", True), ("servo", False)])
def test_a_campaign_that_varies_such_a_key(tmp_path: Path, tracking, named) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(
        f"scenario: {BUMPER}\nset: {{rig.platform.tracking: {tracking}}}\nvary:\n  "
        f"rig.platform.bandwidth: {{values: [10.0, 20.0]}}\n"
        "  sensor.delay: {values: [0.001, 0.002]}\ndesign: {kind: grid}\n"
    )
    said = [remark for remark in look_at(file).remarks if "vary." in remark]
    expected = "warning: vary.rig.platform.bandwidth: has no effect: tracking is ideal"
    assert [text.startswith(expected) for text in said] == [True] * named
