"""Contact and sensor on recorded poses give the readings that the loop had: two ways through the
same models.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hiltestbed.contact.composition import IMPEDANCE
from hiltestbed.effects import EFFECTS
from hiltestbed.errors import InputError
from hiltestbed.frames import Array
from hiltestbed.replay import replay_wrench
from hiltestbed.scenario import Scenario
from hiltestbed.simulation import simulate
from tests.effects.examples import example
from tests.replay.recorded import Recorded, felt, lane, readings, record, scenario

# of the peak, where A is put in place: the loop's force is what MuJoCo's solver ends at, welds and
# mounts to a millionth
SOLVED = 5e-6
STEP = 5e-5  # of the peak, where a converter may round the other way for that
# of the peak, under the servo: what MuJoCo's soft contact leaves out for the acceleration is 1e-6
# of the force, friction too
DRIVEN = 5e-6
# of the peak, on a mount under the servo: it is integrated within the tick, where the path is not
# on record
UNSEEN = 1e-3
CONTACT = [kind for kind, cls in EFFECTS.items() if cls.link == "contact"]
# of the rigs, those that have all of contact, friction, latch and mount
SPANNING = ("bumper with friction", "probe and cone with latch on a mount", "latched")
# which is drawn at random
SENSOR = [
    kind
    for kind, cls in EFFECTS.items()
    if cls.link in ("sensor", "log") and kind != "sensor.jitter"
]


def errors(recorded: Recorded, replayed: Array) -> Array:
    """(R,) the largest difference over the largest reading."""
    measured = recorded["wrench_meas"]
    assert (np.abs(measured).max(axis=(1, 2)) > 30.0).all()
    return np.asarray(
        np.abs(replayed - measured).max(axis=(1, 2)) / np.abs(measured).max(axis=(1, 2))
    )


def possible(rig: str, kinds: list[str], tracking: str = "ideal") -> list[Scenario]:
    """A scenario for each of the effects that can act in a rig."""
    found = []
    for kind in kinds:
        try:
            found.append(scenario(rig, tracking, {"effects": [example(kind)]}))
        except InputError:
            assert kind in ("contact.backlash", "contact.adhesion")
    return found


@pytest.mark.parametrize("rig", SPANNING)
def test_under_a_servo_they_are_too_where_the_twist_is_on_record(rig: str) -> None:
    """The normal force is that of the law: MuJoCo's soft force leaves out d of what the
    acceleration at the contact would need, of a body of 1 kg as it is weighed here.
    """
    recorded = record([scenario(rig, "servo")])
    found = readings(recorded)
    assert errors(recorded, found)[0] < (UNSEEN if "mount" in rig else DRIVEN)
    if "mount" not in rig:
        measured, law = recorded["wrench_meas"][0, :, 2], found[0, :, 2]
        pressed = law > 0.2 * law.max()
        assert pressed.sum() > 200
        assert abs(np.mean(measured[pressed] / law[pressed]) - 1.0) < 0.1 * IMPEDANCE


def test_without_the_twist_a_servo_is_half_a_tick_off() -> None:
    """The slope of a tick is the twist in its middle: k x + c v misses c a h/2, here 4000 N s/m,
    and friction turns late.
    """
    recorded = record([scenario("probe and cone", "servo")])
    blind = replace(felt(recorded), rates=None, least_creep=0.0)
    error = errors(recorded, readings(recorded, shared=blind))[0]
    assert 200.0 * DRIVEN < error < 0.02


@pytest.mark.parametrize("rig", SPANNING)
def test_every_effect_of_the_contact_acts_in_the_replay_as_in_the_loop(rig: str) -> None:
    recorded = record(possible(rig, CONTACT))
    assert errors(recorded, readings(recorded)).max() < SOLVED
    shown = errors(recorded, readings(recorded, [])) > 1e-3
    assert shown.sum() >= len(shown) - 4, "an example that does not show proves nothing"


def test_every_effect_of_the_contact_acts_under_a_servo_too() -> None:
    scenarios = possible("probe and cone with latch", CONTACT, "servo")
    recorded = record(scenarios)
    # a frame rings between two ticks, too: 9e-6
    between = np.array([s.effects[0].kind == "frame.mode" for s in scenarios])
    assert (errors(recorded, readings(recorded)) < np.where(between, 2.0 * DRIVEN, DRIVEN)).all()


def test_a_soft_frame_that_rings_on_does_not_touch_what_is_apart() -> None:
    """It swings by millimetres towards surfaces whose distance matters as exactly as in contact."""
    frame = {"kind": "frame.mode", "frequency": 10.0, "damping_ratio": 0.03, "mass": 5.0}
    recorded = record([scenario("bumper", changes={"effects": [frame], "duration": 1.0})])
    assert errors(recorded, readings(recorded)).max() < SOLVED


def test_a_frame_whose_reaction_is_read_rings_on_when_the_surfaces_have_parted() -> None:
    frame = {"kind": "frame.mode", "frequency": 10.0, "damping_ratio": 0.03, "mass": 5.0}
    s = scenario("bumper", changes={"effects": [frame], "duration": 1.0})
    read = tuple(e.read_as({"reads": "reaction"}) for e in s.effects)
    trace = simulate([s.model_copy(update={"effects": read})], trace=True).trace
    assert trace is not None
    shown = trace.run(0)
    apart = ~shown.contact
    apart[: int(np.argmax(shown.contact))] = False
    assert apart.any()
    assert np.abs(shown["wrench_true"][apart, 2]).max() > 1.0


def test_every_effect_of_the_sensor_and_of_the_record_acts_in_the_replay_as_in_the_loop() -> None:
    recorded = record(possible("probe and cone with latch", SENSOR))
    assert errors(recorded, readings(recorded)).max() < STEP
    assert (errors(recorded, readings(recorded, [])) > 1e-3).all()


def test_effects_add_up_in_their_order() -> None:
    kinds = "gain", "stiffness", "delay", "preload", "lag", "bias"
    several = [
        example(f"{'contact' if k in ('stiffness', 'preload') else 'sensor'}.{k}") for k in kinds
    ]
    recorded = record([scenario("bumper with friction", changes={"effects": several})])
    assert errors(recorded, readings(recorded))[0] < SOLVED


def test_many_hypotheses_at_once_are_each_what_it_is_alone() -> None:
    """To the bit, also on a mount, whose contacts are computed in parallel."""
    rig = "probe and cone with latch on a mount"
    recorded = record([scenario(rig), scenario(rig, changes={"approach.offset": [0.02, 0.0]})])
    s = recorded.scenarios[0]
    kinds = (
        "contact.stiffness",
        "sensor.gain",
        "sensor.delay",
        "frame.compliance",
        "sensor.lag",
        "contact.misalignment",
    )
    effects = [EFFECTS[k](**example(k)) for k in kinds]
    # of a run, those of the sensor share their contact
    lanes = [lane(s, run, [e]) for e in effects for run in (1, 0)]
    for grid in (s.substeps, None):
        together = replay_wrench(felt(recorded), lanes, grid=grid)
        for i in (0, 2, 3, 5, 6, 9, 10):
            alone = replay_wrench(felt(recorded), [lanes[i]], grid=grid)[0]
            assert np.array_equal(together[i], alone)


def test_a_latch_closes_in_the_replay_when_it_does_in_the_loop() -> None:
    """Here 6 mm before the touch, at a speed that the latch allows: from then on the probe is
    held.
    """
    recorded = record([scenario("probe and cone with latch")])
    assert errors(recorded, readings(recorded))[0] < SOLVED
    pulled = recorded["wrench_meas"][0, :, 2].min()
    assert pulled < -30.0
    open_still = Recorded([scenario("probe and cone")], recorded.data)
    assert errors(recorded, readings(open_still))[0] > 0.5
