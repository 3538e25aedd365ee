"""The effects of a scenario act at once: the order in which they are listed does not matter."""

from __future__ import annotations

import itertools
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from hiltestbed.contact.parameters import ContactParameters
from hiltestbed.effects import EFFECTS
from hiltestbed.numerical_model.parameters import DynamicsParameters
from hiltestbed.platform.parameters import PlatformParameters
from hiltestbed.sensor.parameters import SensorParameters
from tests.effects.examples import EXAMPLES

OF_LINK: dict[str, Any] = {
    "contact": lambda effects: ContactParameters(1e5, 100.0, friction=0.1).with_effects(effects),
    "dynamics": DynamicsParameters.of,
    "platform": lambda effects: PlatformParameters(5e-4).with_effects(effects),
    "sensor": lambda effects: SensorParameters().with_effects(effects),
}


@pytest.mark.parametrize("link", OF_LINK)
def test_two_effects_of_a_link_give_the_same_parameters_in_either_order(link: str) -> None:
    made = [EFFECTS[k](kind=k, **v) for k, v in EXAMPLES.items() if EFFECTS[k].link == link]
    for pair in itertools.combinations(made, 2):
        one, other = (asdict(OF_LINK[link](order)) for order in (pair, pair[::-1]))
        np.testing.assert_equal(one, other, [e.kind for e in pair])
