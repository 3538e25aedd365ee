"""The believed rig on a recorded command, under the recorded force: where its drives take the
platform.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hiltestbed.contact.mount_dynamics import MountDynamics, borne
from hiltestbed.frames import Array
from hiltestbed.replay import replay_rig
from hiltestbed.replay.rig import RecordedForce
from tests.replay.recorded import Recorded, record, scenario


def path_of(recorded: Recorded, load: Array) -> Any:
    """(N, 7) where the drives take the believed rig under a load (N, 6); None: out of its reach."""
    command, rates, felt = (recorded[n][0] for n in ("pose_cmd", "twist_cmd", "wrench_meas"))
    return replay_rig(recorded.scenarios[0], command, rates, load, felt)


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
    """Between two ticks the recorded force lies on a straight line. At the touch it steps by c v,
    400 N in the cone, anywhere in a tick: an impulse that is off by 0.1 N s moves 600 kg at 0.17
    mm/s, which a drive of 40 Hz stops within 4 ms, 0.7 um on.
    """
    recorded = record([scenario(rig, "servo", changes)])
    path = path_of(recorded, recorded["wrench_true"][0])
    reached = recorded["pose_act"][0]
    assert np.abs(path[0] - reached[0]).max() < 1e-14
    assert np.abs(path - reached).max() < 7e-7
    rigid = np.abs(recorded["pose_cmd"][0, :-1] - reached[1:]).max()
    assert rigid > 1e-6, "the rig yields: what is replayed is there"


def test_a_force_that_throws_it_out_is_told() -> None:
    recorded = record([scenario("bumper with friction", "servo")])
    assert path_of(recorded, np.full_like(recorded["wrench_true"][0], 1e7)) is None


def test_on_a_mount_it_bears_what_the_contact_exerts() -> None:
    """The sensor stands behind the mount; the contact bears more by M q'': 14 um of a platform that
    is held at once at 8 mm/s.

    The mount's motion is found to the first order, and the force within a tick lies on a straight
    line: 0.5 um are left.
    """
    recorded = record([scenario("latched on a mount", "servo")])
    (s,) = recorded.scenarios
    felt = recorded["wrench_true"][0]
    bears, feels = (
        np.abs(path_of(recorded, load) - recorded["pose_act"][0]).max()
        for load in (borne(s.mechanism, s.tick, felt), felt)
    )
    assert bears < 7e-7
    assert feels > 1e-5


def test_what_a_mount_bears_is_what_moves_it() -> None:
    """A mount of one axis in closed form: a force A sin(w t) on the body leaves K q + C q' at the
    sensor.
    """
    s = scenario("latched on a mount", "servo")
    (dynamics,) = [d for d in [MountDynamics.of([s.mechanism])] if d is not None]
    mass, k, c = dynamics.body[0], dynamics.stiffness[0, 2], dynamics.damping[0, 2]
    t, w = s.tick * np.arange(4000), 2.0 * np.pi * 5.0
    answer = (k + 1j * w * c) / (k - mass * w**2 + 1j * w * c)
    reading = np.zeros((len(t), 6))
    reading[:, 2] = 100.0 * (answer * np.exp(1j * w * t)).imag
    late = slice(2000, 3900)  # the start-up of its motion is forgotten; the last rows have no slope
    assert borne(s.mechanism, s.tick, reading)[late, 2] == pytest.approx(
        100.0 * np.sin(w * t)[late], abs=1e-3 * 100.0
    )


def test_a_recorded_force_lies_on_lines_between_rows_and_what_is_added_between_them() -> None:
    record = np.array([0.0, 3.0, 9.0])[:, None] * np.ones(6)
    between = np.zeros((3, 3, 6))
    between[1, 0] = between[2, 1] = 5.0  # a third into the first tick, two thirds into the second
    force = RecordedForce(record, 3, between)
    np.testing.assert_allclose(
        [force.next()[0] for _ in range(7)], [0.0, 1.0 + 5.0, 2.0, 3.0, 5.0, 7.0 + 5.0, 9.0]
    )
