"""The schema of a scenario: what it lists, what it says of each key, and that it takes what the
loader takes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from ruamel.yaml import YAML

from hiltestbed.compensation.settings import FORCE_METHODS, MOTION_METHODS
from hiltestbed.config.check import json_schema
from hiltestbed.contact.settings import MECHANISMS
from hiltestbed.effects import EFFECTS
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.scenario import load_scenario, resolved
from tests.effects.examples import EXAMPLES, example

ROOT = Path(__file__).parents[2]
SHIPPED = sorted(p for p in (ROOT / "scenarios").rglob("*.yaml") if "campaigns" not in p.parts)


def plain(path: Path) -> Any:
    return YAML(typ="safe").load(path)


def union(where: dict[str, Any], schema: dict[str, Any]) -> list[str]:
    """The kinds of a discriminated union."""
    assert where["discriminator"]["propertyName"] == "kind"
    models = [schema["$defs"][m["$ref"].rpartition("/")[2]] for m in where["oneOf"]]
    return [model["properties"]["kind"]["const"] for model in models]


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    return json_schema("scenario")


@pytest.fixture(scope="module")
def validator(schema: dict[str, Any]) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema)


def test_it_is_a_json_schema(schema: dict[str, Any]) -> None:
    jsonschema.Draft202012Validator.check_schema(schema)


def test_what_is_told_apart_by_kind_is_listed_whole() -> None:
    schema = json_schema("scenario")  # of now: with the plugins that have been loaded since
    keys, compensation = schema["properties"], schema["$defs"]["Compensation"]["properties"]
    assert set(union(keys["effects"]["items"], schema)) == set(EFFECTS)
    assert set(union(keys["mechanism"], schema)) == set(MECHANISMS)
    assert set(union(keys["identification"], schema)) == set(IDENTIFIERS)
    assert set(union(compensation["force"], schema)) == set(FORCE_METHODS)
    assert set(union(compensation["motion"], schema)) == set(MOTION_METHODS)


def test_it_takes_every_shipped_scenario_and_its_resolved_form(
    validator: jsonschema.Draft202012Validator, subtests: pytest.Subtests
) -> None:
    for path in SHIPPED:
        with subtests.test(path.stem):
            assert validator.is_valid(plain(path))
            assert validator.is_valid(resolved(load_scenario(path)))


def test_it_takes_every_effect_and_no_other_parameter(
    validator: jsonschema.Draft202012Validator, subtests: pytest.Subtests
) -> None:
    data = plain(ROOT / "scenarios" / "reference-bumper.yaml")
    for kind, parameters in EXAMPLES.items():
        with subtests.test(kind):
            assert validator.is_valid(data | {"effects": [example(kind)]})
            assert not validator.is_valid(data | {"effects": [example(kind) | {"sise": 1.0}]})
            assert not validator.is_valid(data | {"effects": [parameters]}), "an effect has a kind"


def keys(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key of the schema and what it says of it."""
    for name, node in {"Scenario": schema, **schema["$defs"]}.items():
        for key, value in node.get("properties", {}).items():
            yield f"{name}.{key}", value


def test_every_key_and_object_is_described_in_words_that_need_no_others(
    schema: dict[str, Any], subtests: pytest.Subtests
) -> None:
    """A text begins with what it describes: no bare unit, no fragment, no word that points at
    another text.
    """
    elsewhere = re.compile(
        r"\bthe same\b(?! (seed|trace|tick|time))|\blikewise\b|\bditto\b|\bas above\b|\bidem\b",
        re.IGNORECASE,
    )
    for key, about in (*keys(schema), ("Scenario", schema), *schema["$defs"].items()):
        with subtests.test(key):
            said = about.get("description", "")
            assert len(said.split()) >= 2, said
            assert re.match(r"[A-Z]", said), said
            assert not elsewhere.search(said), said


def test_numbers_of_a_unit_say_so(schema: dict[str, Any]) -> None:
    """Of the keys that are a number or a list of numbers each names its unit in brackets, or is a
    count, a name or a switch.
    """
    counts = ("seed", "order", "lag", "ticks")
    for key, value in keys(schema):
        kinds = {value.get("type"), *(v.get("type") for v in value.get("anyOf", ()))}
        if "number" in kinds or value.get("items", {}).get("type") == "number":
            assert "[" in value["description"] or key.rpartition(".")[2] in counts, key
