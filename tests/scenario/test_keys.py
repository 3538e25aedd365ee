"""The keys of a file, one by one: all of them, under the names with which they are set, and the
search among them.
"""

from __future__ import annotations

from typing import Any

import pytest

from hiltestbed.config.check import json_schema
from hiltestbed.config.keys import Key, at, keys_of, search
from hiltestbed.effects import EFFECTS
from hiltestbed.errors import InputError
from hiltestbed.platform.kinds import PLATFORMS
from hiltestbed.scenario import load_scenario, resolved

KEYS = list(keys_of(json_schema("scenario")))


def of_now() -> list[Key]:
    """With the plugins that other tests have loaded since."""
    return list(keys_of(json_schema("scenario")))


def leaves(data: Any, path: str = "") -> list[str]:
    if not (isinstance(data, dict) and data):
        return [path.removeprefix(".")]
    return [leaf for name, inner in data.items() for leaf in leaves(inner, f"{path}.{name}")]


@pytest.mark.parametrize("name", ["reference-bumper", "09-docking", "18-stewart", "22-air-bearing"])
def test_every_key_of_a_resolved_scenario_is_listed(name: str) -> None:
    known = {key.path for key in KEYS}
    assert set(leaves(resolved(load_scenario(name)))) <= known


def test_a_key_is_found_with_those_directly_below_it() -> None:
    of_sensor = {key.path for key in KEYS if f"{key.path}.".startswith("sensor.")}
    assert {key.path for key in at(KEYS, "sensor")} == of_sensor
    assert {key.path.count(".") for key in at(KEYS, "rig.platform")} == {1, 2}
    assert [key.path for key in at(KEYS, "sensor.delay")] == ["sensor.delay"]


def test_a_section_takes_its_kinds() -> None:
    (platform,) = (key for key in of_now() if key.path == "rig.platform")
    assert platform.takes == "section of kind " + ", ".join(PLATFORMS)


def test_an_item_of_a_list_and_a_free_name_have_keys_too() -> None:
    kinds = {key.kinds[-1] for key in at(of_now(), "effects.0") if key.path == "effects.N.kind"}
    assert kinds == set(EFFECTS)
    dataset = list(keys_of(json_schema("dataset")))
    assert {key.path for key in at(dataset, "channels.Fz.unit")} == {"channels.NAME.unit"}


def test_a_search_takes_words_of_name_kind_and_meaning() -> None:
    found = search(KEYS, "BANDWIDTH hz")
    expected = {"rig.platform.bandwidth", "rig.platform.controller.bandwidth"}
    assert expected <= {key.path for key in found}
    assert all("bandwidth" in f"{key.path}{key.kinds}{key.meaning}".lower() for key in found)
    assert search(KEYS, "unheard-of") == []


def test_an_unknown_key_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'sensr\.delay'\); nearest: sensor\.delay"):
        at(KEYS, "sensr.delay")
