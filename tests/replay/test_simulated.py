"""What moves on a side, or collides at several points, is carried along recorded poses as the loop
had it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hiltestbed.effects import EFFECTS
from hiltestbed.frames import Array
from hiltestbed.replay import Simulated, replay_rig
from hiltestbed.replay.simulated import step_between
from hiltestbed.scenario import Scenario, load_scenario
from tests.effects.examples import example
from tests.replay.recorded import QUIET, SCENARIOS, Recorded, carried, laws, record

EXACT = 1e-9  # of the peak: the same solver on the same path
# of the peak: joints that rub creep by how their carrier yields; found are 6e-7, 2.5e-5 and 1.4e-5
UNDER_SERVO = 1e-4
# Each from just before the touch, with what it takes to come to its first phases.
DOCKINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "ring with petals": (
        "15-ring-docking",
        {"approach.gap": 0.1, "approach.velocity": [0.0, 0.0, 0.15], "duration": 0.7},
    ),
    "ring on legs": (
        "28-active-ring",
        {"approach.gap": 0.1, "approach.velocity": [0.0, 0.0, 0.15], "duration": 0.7},
    ),
    "head on a sprung rod": ("16-probe-drogue", {"approach.gap": 0.05, "duration": 1.5}),
    "jaws that close": ("17-gripper", {"duration": 1.9}),
}
EFFECTS_TRIED = ("contact.stiffness", "contact.surface_friction", "contact.touch_offset")


def docking(
    name: str, effects: tuple[dict[str, Any], ...] = (), tracking: str = "ideal"
) -> Scenario:
    file, changes = DOCKINGS[name]
    return load_scenario(
        SCENARIOS / f"{file}.yaml",
        set=QUIET | changes | {"rig.platform.tracking": tracking, "effects": list(effects)},
    )


@cache
def driven(name: str) -> Recorded:
    return record([docking(name, tracking="servo")])


def simulated(recorded: Recorded) -> Simulated:
    servo = recorded.scenarios[0].rig.platform.tracking == "servo"
    return Simulated(
        *carried(recorded.scenarios),
        recorded["pose_act"],
        np.ascontiguousarray(recorded["twist_act"]) if servo else None,
    )


@pytest.mark.parametrize("name", DOCKINGS)
def test_the_wrench_is_that_of_the_loop_under_whatever_effect(name: str) -> None:
    """The believed mechanism is handed the effect; the record had it in the loop."""
    recorded = record([docking(name, (example(kind),)) for kind in EFFECTS_TRIED])
    wanted = [
        (i, laws(recorded.scenarios[i], [EFFECTS[kind](**example(kind))]))
        for i, kind in enumerate(EFFECTS_TRIED)
    ]
    truth = recorded["wrench_true"]
    peak = np.abs(truth).max(axis=(1, 2))
    assert (peak > 20.0).all()
    for i, wrench in enumerate(simulated(recorded).exerted(wanted)):
        np.testing.assert_allclose(wrench[:, -1], truth[i], atol=EXACT * peak[i])


@pytest.mark.parametrize("name", DOCKINGS)
def test_under_a_servo_the_rows_and_their_rates_tell_what_happens_between_them(name: str) -> None:
    """The rig is a body of 334 kg on drives that yield; here what does not yield carries the sides
    past the same places.
    """
    recorded = driven(name)
    truth = recorded["wrench_true"][0]
    peak = np.abs(truth).max()
    assert peak > 20.0
    np.testing.assert_allclose(
        simulated(recorded).believed(0).wrench[:, -1], truth, atol=UNDER_SERVO * peak
    )


def test_free_flight_is_gone_through_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is resumed where it ends, on however many threads, is what is carried along the whole
    path, to the bit.

    A touch that comes much earlier is carried along the whole path.
    """
    name = "ring with petals"
    one = docking(name, tracking="servo")
    slower = one.approach.model_copy(
        update={"velocity": tuple(0.9 * v for v in one.approach.velocity)}
    )
    recorded = record([one, one.model_copy(update={"approach": slower})])
    resumed, whole = simulated(recorded), simulated(recorded)
    monkeypatch.setattr(whole, "_flight", lambda rubs: None)
    touch = EFFECTS["contact.touch_offset"]
    for effects in (
        [
            EFFECTS["contact.stiffness"].hypothesis({}, factor=1.3),
            EFFECTS["contact.dry_friction"].hypothesis({}, force=20.0),
        ],
        [touch.hypothesis({}, offset=-0.002)],
        [touch.hypothesis({}, offset=-0.02)],
    ):
        wanted = [(1, laws(one, effects)), (0, laws(one, []))]
        monkeypatch.setattr("hiltestbed.replay.simulated.threads", lambda: 2)
        once = resumed.exerted(wanted)
        monkeypatch.setattr("hiltestbed.replay.simulated.threads", lambda: 1)
        np.testing.assert_array_equal(once, whole.exerted(wanted))
    flights = list(resumed._flights.values())
    assert all(f is not None for f in flights)
    early = laws(one, [touch.hypothesis({}, offset=-0.02)])
    assert not any(f.holds(early) for f in flights if f is not None)


def test_drives_bear_what_touches_and_what_moves_on_them() -> None:
    """The rig with its parts at rest goes where it went, under the wrench of the sensor and the
    rate of momentum of its parts.

    Left are 0.04 um of 23 um: at the touch the force steps within a tick, and lies on a line here.
    Without the momentum it is 1.0 um.
    """
    recorded = driven("head on a sprung rod")
    (scenario,), wrench = recorded.scenarios, recorded["wrench_true"][0]
    command, rates = (np.ascontiguousarray(recorded[name][0]) for name in ("pose_cmd", "twist_cmd"))
    taken = simulated(recorded).believed(0).taken
    away = []
    for load in (0.0 * wrench, wrench + taken, wrench):
        path = replay_rig(scenario, command, rates, load, recorded["wrench_meas"][0])
        away.append(np.abs(path - recorded["pose_act"][0])[:, :3].max())
    assert away[1] < 0.02 * away[0]
    assert away[1] < 0.5 * away[2]


@pytest.mark.parametrize("steps", [1, 3])
def test_a_uniform_acceleration_is_stepped_as_a_stepper_steps_it(steps: int) -> None:
    """Velocities before places: v_s = v_0 + a s dt, x_s = x_(s-1) + v_s dt."""
    dt, acceleration = 1e-3, np.array([2.0, -1.0, 0.5, 0.0, 0.0, 0.0])
    twists = [np.array([0.1, 0.2, -0.3, 0.0, 0.0, 0.0])]
    places = [np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])]
    for _ in range(steps):
        twists.append(twists[-1] + acceleration * dt)
        places.append(places[-1] + np.r_[twists[-1][:3] * dt, 0.0, 0.0, 0.0, 0.0])
    poses, rates = np.empty((steps, 1, 7)), np.empty((steps, 1, 6))
    step_between(
        *(np.array([x]) for x in (places[0], twists[0], places[-1], twists[-1])), dt, poses, rates
    )
    np.testing.assert_allclose(poses[:, 0], places[1:], atol=1e-15)
    np.testing.assert_allclose(rates[:, 0], twists[1:], atol=1e-12)


BAR = """<mujoco><worldbody><geom name="bar" type="box" size="0.16 0.02 0.02" pos="0 0 -0.02" contype="1" conaffinity="1"/>
<site name="A"/></worldbody></mujoco>"""
STOPS = """<mujoco><worldbody><geom name="one" type="box" size="0.02 0.02 0.02" pos="0.15 0 0.02" contype="1" conaffinity="1"/>
<geom name="other" type="box" size="0.02 0.02 0.02" pos="-0.15 0 0.02" contype="1" conaffinity="1"/><site name="P"/></worldbody></mujoco>"""


def test_boxes_that_collide_at_several_points_push_with_the_stiffness_of_their_pairs(
    tmp_path: Path,
) -> None:
    """On a path that nobody simulated, F = 2 (k x + c v): the law itself, k scaled as the effect
    asks.
    """
    pair = {"active": "bar", "passive": "*", "stiffness": 1.0e5, "damping": 400.0}
    mechanism: dict[str, Any] = {"kind": "mjcf", "pairs": [pair]}
    for name, text in (("active", BAR), ("passive", STOPS)):
        mechanism[name] = str(tmp_path / f"{name}.xml")
        (tmp_path / f"{name}.xml").write_text(text)
    keys = {"mechanism": mechanism, "rig.platform.tracking": "ideal", "approach.gap": 0.001}
    s = load_scenario("02-bumper", keys | {"rate": 1000, "physics_rate": 2000})
    t = np.arange(150) * s.tick
    depth = 1e-3 * np.sin(2.0 * np.pi * 5.0 * t) ** 2 + 1e-4
    poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (1, len(t), 1))
    poses[0, :, 2] = depth
    rate = np.diff(depth, prepend=depth[:1]) / s.tick
    along = Simulated(*carried([s]), poses)
    stiffer = EFFECTS["contact.stiffness"].hypothesis({}, factor=1.3)
    (wrench,) = along.exerted([(0, laws(s, [stiffer]))])
    law = 2.0 * (1.3e5 * depth + 400.0 * rate)
    # the first row has the rate of the approach
    np.testing.assert_allclose(wrench[1:, -1, 2], law[1:], atol=1e-4 * 2.6e5 * depth.max())
    np.testing.assert_allclose(along.believed(0).depth, depth, atol=1e-9)


def test_lanes_of_one_batch_give_what_each_gives_alone() -> None:
    recorded = driven("head on a sprung rod")
    softer = EFFECTS["contact.stiffness"].hypothesis({}, factor=0.7)
    both = [(0, laws(recorded.scenarios[0], effects)) for effects in ([], [softer])]
    together: list[Array] = simulated(recorded).exerted(both)
    for wrench, lane in zip(together, both, strict=True):
        np.testing.assert_array_equal(wrench, simulated(recorded).exerted([lane])[0])
