"""The believed rig on a recorded command, under the recorded force: where its drives take the platform."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltestbed.replay import replay_rig
from tests.replay.recorded import record, scenario


@pytest.mark.parametrize(
    ("rig", "changes"),
    [
        ("bumper with friction", {}),
        ("bumper with friction", {"compensation.motion": {"kind": "none"}}),
        ("bumper with friction", {"compensation.motion": {"kind": "inverse_model"}}),
        ("bumper with friction", {"compensation.motion": {"kind": "adaptive_time_series"}}),
        ("bumper with friction", {"compensation.motion": {"kind": "admittance", "limit": 100.0}}),
        ("bumper with friction", {"rig.platform.actuator.kind": "single"}),
        ("probe and cone with latch", {}),
    ],
)
def test_it_goes_where_the_rig_went(rig: str, changes: dict[str, Any]) -> None:
    """Between two ticks the recorded force lies on a straight line. At the touch it steps by c v, 400 N in the cone, anywhere in a tick:
    an impulse that is off by 0.1 N s moves 600 kg at 0.17 mm/s, which a drive of 40 Hz stops within 4 ms, 0.7 um on."""
    recorded = record([scenario(rig, "servo", changes)])
    (s,) = recorded.scenarios
    path = replay_rig(s, recorded["pose_cmd"][0], recorded["twist_cmd"][0], recorded["wrench_true"][0], recorded["wrench_meas"][0])
    assert path is not None
    reached = recorded["pose_act"][0]
    assert np.abs(path[0] - reached[0]).max() < 1e-14
    assert np.abs(path - reached).max() < 7e-7
    rigid = np.abs(recorded["pose_cmd"][0, :-1] - reached[1:]).max()
    assert rigid > 1e-6, "the rig yields: what is replayed is there"


def test_a_force_that_throws_it_out_is_told() -> None:
    recorded = record([scenario("bumper with friction", "servo")])
    (s,) = recorded.scenarios
    shove = np.full_like(recorded["wrench_true"][0], 1e7)
    assert replay_rig(s, recorded["pose_cmd"][0], None, shove, recorded["wrench_meas"][0]) is None


def test_on_a_mount_it_bears_the_contact_but_not_what_the_mounts_inertia_keeps_from_the_sensor() -> None:
    """What is on record is the sensor's wrench. The contact bears more by m a: 120 kg at 20 Hz and 0.3 mm, 570 N, on drives of 40 Hz
    and 214 kg each, 4e7 N/m together."""
    recorded = record([scenario("latched on a mount", "servo")])
    (s,) = recorded.scenarios
    path = replay_rig(s, recorded["pose_cmd"][0], recorded["twist_cmd"][0], recorded["wrench_true"][0], recorded["wrench_meas"][0])
    assert path is not None
    assert np.abs(path - recorded["pose_act"][0]).max() < 2e-5
