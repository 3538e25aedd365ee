"""The vocabulary of effects: each one is described, searched and acts; a new effect that lacks a
part fails here."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, get_args

import numpy as np
import pytest

from hiltestbed.compensation.input import InputParameters
from hiltestbed.contact.parameters import ContactParameters
from hiltestbed.effects import EFFECTS, Effect
from hiltestbed.effects.departure import LINKS
from hiltestbed.effects.log import LogParameters
from hiltestbed.effects.search import Candidate, Scales
from hiltestbed.numerical_model.parameters import DynamicsParameters
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.scenario import Scenario, load_scenario
from hiltestbed.sensor.parameters import SensorParameters
from tests.effects.examples import EXAMPLES, example

# Parameters and units as users, scripts and data sets rely on them; "": a choice, not a quantity.
VOCABULARY: dict[str, dict[str, str]] = {
    "sensor.delay": {"delay": "s"},
    "sensor.lag": {"time_constant": "s"},
    "sensor.highpass": {"time_constant": "s"},
    "sensor.drift": {"rate": "N/s", "axis": ""},
    "sensor.bias": {"force": "N", "torque": "N m"},
    "sensor.gain": {"factor": "-", "axis": ""},
    "sensor.crosstalk": {"ratio": "-", "source": "", "axis": ""},
    "sensor.rotation": {"angles_deg": "deg"},
    "sensor.deadzone": {"width": "N"},
    "sensor.saturation": {"limit": "N"},
    "sensor.hum": {"frequency": "Hz", "amplitude": "N", "phase": "rad", "axis": ""},
    "sensor.jitter": {"sigma": "s"},
    "contact.stiffness": {"factor": "-"},
    "contact.damping": {"factor": "-"},
    "contact.power_law": {"exponent": "-", "stiffness": "N/m^n"},
    "contact.hunt_crossley": {"alpha": "s/m"},
    "contact.dry_friction": {"force": "N", "stiffness": "N/m"},
    "contact.preload": {"force": "N"},
    "contact.hard_stop": {"position": "m", "stiffness": "N/m"},
    "contact.relaxation": {"stiffness": "N/m", "time_constant": "s"},
    "contact.adhesion": {"force": "N"},
    "contact.surface_friction": {"coefficient": "-"},
    "contact.touch_offset": {"offset": "m"},
    "contact.backlash": {"width": "m"},
    "contact.misalignment": {"angles_deg": "deg"},
    "frame.compliance": {"stiffness": "N/m"},
    "frame.mode": {"frequency": "Hz", "damping_ratio": "-", "mass": "kg"},
    "platform.delay": {"delay": "s"},
    "platform.lag": {"bandwidth": "Hz"},
    "platform.backlash": {"width": "m"},
    "platform.friction": {"stick": "m"},
    "platform.mode": {"frequency": "Hz", "damping_ratio": "-"},
    "platform.scale": {"factor": "-", "axis": ""},
    "platform.speed_limit": {"speed": "m/s"},
    "dynamics.mass": {"factor": "-", "body": ""},
    "dynamics.inertia": {"factor": "-", "body": ""},
    "dynamics.port_offset": {"offset": "m", "body": ""},
    "dynamics.appendage": {
        "mass_ratio": "-",
        "frequency": "Hz",
        "damping_ratio": "-",
        "body": "",
        "place": "m",
    },
    "dynamics.force": {
        "viscous": "N s/m",
        "coulomb": "N",
        "offset": "N",
        "viscous_asymmetry": "-",
        "coulomb_back": "N",
        "static": "N",
        "stribeck_speed": "m/s",
        "axis": "",
        "body": "",
    },
    "platform.response": {"step": "s, -"},
    "platform.drive": {
        "bandwidth": "Hz",
        "damping_ratio": "-",
        "friction": "m",
        "offset": "m",
        "acceleration_limit": "m/s^2",
        "integral_time": "s",
        "static": "-",
        "axis": "",
    },
    "dynamics.step_delay": {"ticks": "-"},
    "dynamics.integrator": {"scheme": ""},
    "loop.deadzone": {"width": "N"},
    "log.skew": {"delay": "s"},
    "contact.map": {
        "penetration": "m, N",
        "rate": "m/s, N",
        "stretch": "m, N",
        "spring": "m, -",
        "spring_rate": "m/s, -",
    },
    "sensor.map": {"reading": "N, N", "axis": ""},
}

# The size at which an effect does nothing.
NEUTRAL: dict[str, dict[str, Any]] = {
    "sensor.delay": {"delay": 0.0},
    "sensor.drift": {"rate": 0.0},
    "sensor.bias": {"force": (0.0, 0.0, 0.0), "torque": (0.0, 0.0, 0.0)},
    "sensor.gain": {"factor": 1.0},
    "sensor.crosstalk": {"ratio": 0.0},
    "sensor.rotation": {"angles_deg": (0.0, 0.0, 0.0)},
    "sensor.hum": {"amplitude": 0.0},
    "sensor.jitter": {"sigma": 0.0},
    "contact.stiffness": {"factor": 1.0},
    "contact.damping": {"factor": 1.0},
    "contact.dry_friction": {"force": 0.0, "stiffness": 0.0},
    "contact.preload": {"force": 0.0},
    "contact.adhesion": {"force": 0.0},
    "contact.touch_offset": {"offset": 0.0},
    "contact.backlash": {"width": 0.0},
    "contact.misalignment": {"angles_deg": (0.0, 0.0)},
    "platform.delay": {"delay": 0.0},
    "platform.backlash": {"width": 0.0},
    "platform.friction": {"stick": 0.0},
    "platform.scale": {"factor": 1.0},
    "dynamics.mass": {"factor": 1.0},
    "dynamics.inertia": {"factor": 1.0},
    "dynamics.port_offset": {"offset": (0.0, 0.0, 0.0)},
    "dynamics.force": {"viscous": 0.0, "coulomb": 0.0, "offset": 0.0, "static": 0.0},
    "dynamics.step_delay": {"ticks": 0},
    "log.skew": {"delay": 0.0},
    "contact.map": {"penetration": (), "rate": (), "stretch": (), "spring": (), "spring_rate": ()},
}
# Those without one: a limit (the larger the less), or a law in place of another.
WITHOUT_NEUTRAL = set(
    [
        "sensor.lag",
        "sensor.highpass",
        "sensor.deadzone",
        "sensor.saturation",
        "contact.power_law",
        "contact.hunt_crossley",
        "contact.hard_stop",
        "contact.relaxation",
        "contact.surface_friction",
        "frame.compliance",
        "frame.mode",
        "platform.lag",
        "platform.mode",
        "platform.speed_limit",
        "platform.response",
        "platform.drive",
        "dynamics.appendage",
        "dynamics.integrator",
        "loop.deadzone",
        "sensor.map",
    ]
)

SCALES = Scales(
    force=200.0,
    depth=2e-3,
    stiffness=1e5,
    tick=5e-4,
    noise=0.3,
    slow=0.02,
    fast=0.06,
    reading=(190.0, 120.0),
    travel=0.02,
    substeps=2,
    sticks={(2, 0.0): (1e-5, 3e-5)},
)
HELD_SCALES = Scales(
    force=150.0,
    depth=5e-4,
    stiffness=5e7,
    tick=5e-4,
    noise=0.1,
    slow=4e-3,
    fast=5e-3,
    captured=True,
    slides=False,
)
Candidates = Callable[[type[Effect]], list[Candidate]]


@pytest.fixture(scope="module")
def head_on() -> Scenario:
    return load_scenario("02-bumper")


@pytest.fixture
def believed(head_on: Scenario) -> Callable[[str], Any]:
    """Numbers of a link as believed, by the link's name."""
    links: dict[str, Callable[[], Any]] = {
        "platform": lambda: PlatformParameters(head_on.tick),
        "contact": lambda: ContactParameters.believed(head_on.mechanism.contact),
        "sensor": lambda: SensorParameters.believed(head_on.sensor),
        "compensation": InputParameters,
        "dynamics": DynamicsParameters,
        "log": LogParameters,
    }
    return lambda link: links[link]()


@pytest.fixture(scope="module")
def found() -> Candidates:
    """Candidates of an effect: on a contact, and on a held mechanism."""
    return lambda effect: [*effect.candidates(SCALES), *effect.candidates(HELD_SCALES)]


def flat(parameters: Any) -> dict[str, Any]:
    """Numbers of a link in a form that can be compared."""
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else copy.deepcopy(value)
        for name, value in vars(parameters).items()
    }


def test_names_parameters_and_units_stay_what_users_rely_on() -> None:
    found = {
        kind: {name: effect.unit(name) for name in effect.model_fields if name != "kind"}
        for kind, effect in EFFECTS.items()
    }
    assert found == VOCABULARY


def test_every_effect_has_an_example_and_its_neutral_size_is_known() -> None:
    assert set(EXAMPLES) == set(EFFECTS)
    assert set(NEUTRAL) == set(EFFECTS) - WITHOUT_NEUTRAL


def test_each_says_what_it_is_and_what_it_is_taken_for(subtests: pytest.Subtests) -> None:
    for kind, effect in EFFECTS.items():
        with subtests.test(kind):
            assert get_args(effect.model_fields["kind"].annotation) == (kind,)
            assert effect.__module__ != "hiltestbed.effects.base"
            assert effect.meaning().endswith(".")
            assert len(effect.meaning().split()) >= 3
            assert effect.link in LINKS
            assert effect.equation
            assert effect.reference
            assert effect.leading in effect.model_fields
            assert not effect.jumps or effect.jumps in effect.model_fields
            assert effect.resembles
            assert set(effect.resembles) <= set(EFFECTS)
            assert kind not in effect.resembles


def test_each_quantity_has_a_unit_a_meaning_and_each_that_is_searched_a_range(
    subtests: pytest.Subtests, found: Candidates
) -> None:
    for kind, effect in EFFECTS.items():
        searched = {name.partition(".")[0] for c in found(effect) for name in c.names}
        for name, field in effect.model_fields.items():
            if name == "kind":
                continue
            with subtests.test(kind, parameter=name):
                assert field.description
                if name in searched:
                    low, high, ratio = effect.searched(name)
                    assert low < high
                    assert low > 0.0 or not ratio


def test_a_search_starts_within_its_bounds_at_effects_that_act(
    subtests: pytest.Subtests, found: Candidates, believed: Callable[[str], Any]
) -> None:
    for kind, effect in EFFECTS.items():
        with subtests.test(kind):
            sought = found(effect)
            if not sought:
                assert (effect.candidates.__doc__ or "").startswith("None: "), (
                    "an effect that no search finds says how it is found"
                )
                continue
            assert len({c.key for c in sought}) >= len(sought) // 2, "candidates can be told apart"
            for c in sought:
                assert c.kind == kind
                assert c.choices >= 1
                assert len(c.low) == len(c.high) == len(c.log) == len(c.names)
                assert (c.low < c.high).all()
                assert c.grid
                for start in map(np.array, c.grid):
                    inside = (start >= c.low - 1e-12) & (start <= c.high + 1e-12)
                    assert len(start) == len(c.names)
                    assert inside.all() or not c.names, (c.names, start, c.low, c.high)
                    c.at(start).apply(believed(effect.link))


def test_it_changes_its_link_and_at_its_neutral_size_nothing(
    subtests: pytest.Subtests, believed: Callable[[str], Any]
) -> None:
    for kind, effect in EFFECTS.items():
        with subtests.test(kind):
            departing = believed(effect.link)
            effect(**example(kind)).apply(departing)
            assert flat(departing) != flat(believed(effect.link))
        size = NEUTRAL.get(kind)
        if size is not None:
            with subtests.test(kind, size="neutral"):
                departing = believed(effect.link)
                effect(**example(kind) | size).apply(departing)
                if kind == "sensor.hum":  # a tone of no amplitude stands in the list
                    assert departing.tone.pop()[:3] == (0.0, 0.0, 0.0)
                assert flat(departing) == flat(believed(effect.link))


def test_it_stands_in_a_scenario_and_comes_back_the_same(
    subtests: pytest.Subtests, head_on: Scenario
) -> None:
    held = load_scenario("13-ring-down")
    for kind, effect in EFFECTS.items():
        with subtests.test(kind):
            base = held if kind == "contact.backlash" else head_on
            s = base.model_copy(update={"effects": (effect(**example(kind)),)})
            again = Scenario.model_validate(s.model_dump(mode="json"))
            assert again.effects == s.effects
            assert again.effects[0].parameters() == {
                name: getattr(s.effects[0], name) for name in VOCABULARY[kind]
            }
            assert s.effects[0].unfit(base) is None
            worth = s.effects[0].worth(head_on.tick, 15.0)
            assert worth is None or abs(worth) < 1.0, "the delay that it is worth is a time or none"


def test_a_hypothesis_may_leave_what_a_scenario_allows(
    head_on: Scenario, believed: Callable[[str], Any]
) -> None:
    """A search passes through sizes that no scenario has."""
    late = EFFECTS["sensor.delay"].hypothesis({}, delay=-1e-4)
    p = believed("sensor")
    late.apply(p)
    assert p.delay == head_on.sensor.delay - 1e-4


OF_LINK: dict[str, Any] = {
    "contact": lambda effects: ContactParameters(1e5, 100.0, friction=0.1).with_effects(effects),
    "dynamics": lambda effects: DynamicsParameters().with_effects(effects),
    "platform": lambda effects: PlatformParameters(5e-4).with_effects(effects),
    "sensor": lambda effects: SensorParameters().with_effects(effects),
}


@pytest.mark.parametrize("link", OF_LINK)
def test_two_effects_of_a_link_give_the_same_parameters_in_either_order(link: str) -> None:
    made = [EFFECTS[k](kind=k, **v) for k, v in EXAMPLES.items() if EFFECTS[k].link == link]
    for pair in itertools.combinations(made, 2):
        one, other = (asdict(OF_LINK[link](order)) for order in (pair, pair[::-1]))
        np.testing.assert_equal(one, other, [e.kind for e in pair])
