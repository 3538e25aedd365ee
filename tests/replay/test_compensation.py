"""Every compensation on recorded readings and poses gives the wrench that drove the numerical
model.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltestbed.compensation.input import InputParameters
from hiltestbed.compensation.settings import FORCE_METHODS, MOTION_METHODS
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.replay import replay_compensation
from hiltestbed.replay.compensation import needs
from hiltestbed.scenario import Scenario
from tests.effects.examples import example
from tests.replay.recorded import record, scenario

# of the peak. The resynchronised one looks at poses, whose last bit decides its own
ROUND_OFF = 1e-12
K, C = 1e5, 300.0
NOISE = {"sensor.noise": 0.3, "sensor.torque_noise": 0.02}
SETTINGS: dict[str, dict[str, Any]] = {  # what a method must be given
    "cor_designed": {"stiffness": K, "damping": C},
    "dead_zone": {"width": 5.0},
    "smith_predictor": {"stiffness": K, "damping": C, "lead_rest": True},
    "virtual_contact": {"damping": 500.0},
    "admittance": {"limit": 100.0},
}
VARIANTS = [
    {"kind": "resynchronised", "delay": "estimate"},
    {"kind": "resynchronised", "contact": {"stiffness": K, "damping": C}},
]
FORCE = [{"kind": kind} | SETTINGS.get(kind, {}) for kind in FORCE_METHODS] + VARIANTS
MOTION = [{"kind": kind} | SETTINGS.get(kind, {}) for kind in MOTION_METHODS]


def error(s: Scenario) -> float:
    """Of the replayed wrench, over its peak, from what the method says that it needs."""
    recorded = record([s])
    needed = needs(s.compensation, s.mechanism) - {"wrench_meas"}
    records = {
        group: recorded[group] for name in needed for group in (name, name.replace("pose", "twist"))
    }
    found = replay_compensation(
        [s],
        [InputParameters().with_effects(s.effects)],
        records,
        recorded["wrench_meas"],
        recorded.lanes,
    )
    peak = np.abs(recorded["wrench_comp"]).max()
    assert peak > 30.0
    return float(np.abs(found - recorded["wrench_comp"]).max() / peak)


@pytest.mark.parametrize(
    "force", FORCE, ids=lambda f: "-".join([f["kind"], *(k for k in f if k != "kind")])
)
def test_a_method_gives_what_it_gave_in_the_loop(force: dict[str, Any]) -> None:
    changes = NOISE | {"compensation.force": force}
    assert error(scenario("probe and cone with latch", "ideal", changes)) < ROUND_OFF


@pytest.mark.parametrize("motion", MOTION, ids=lambda m: m["kind"])
def test_so_it_does_beside_every_way_to_tell_the_platform_where_to_go(
    motion: dict[str, Any],
) -> None:
    changes = {"compensation.force": {"kind": "resynchronised"}, "compensation.motion": motion}
    assert error(scenario("bumper with friction", "servo", NOISE | changes)) < ROUND_OFF


@pytest.mark.parametrize("identification", [kind for kind in IDENTIFIERS if kind != "none"])
def test_so_it_does_with_every_estimator(identification: str) -> None:
    changes = {
        "compensation.force": {"kind": "reconstruction"},
        "identification": {"kind": identification},
    }
    assert error(scenario("bumper", "servo", NOISE | changes)) < ROUND_OFF


def test_a_dead_zone_before_the_method_acts_in_the_replay_as_in_the_loop() -> None:
    changes = {"compensation.force": {"kind": "phase_lead"}, "effects": [example("loop.deadzone")]}
    assert error(scenario("bumper with friction", "ideal", NOISE | changes)) < ROUND_OFF
