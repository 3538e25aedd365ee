"""Random values that a JSON Schema allows, with frequent extremes; a few that it does not allow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from numpy.random import Generator

WORDS = (
    "",
    "\x1b[31m",
    "a" * 300,
    *["x", "reference", "[/x]", "<script>", "../../up", "ß→µ", "nan", "${HOME}", "-", "1e5"],
)
NUMBERS = -1, 0, 1e308, -1e-308, math.inf, math.nan, 10**30
ODD = (None, True, "x", "1e5", [], {}, [[1]], {"kind": "?"}, *NUMBERS)
DEEPEST = 8
WRONG = 0.01  # fraction of values that the schema does not allow
LARGEST = 1e9


def value_of(
    schema: Mapping[str, Any], rng: Generator, root: Mapping[str, Any] | None = None, depth: int = 0
) -> Any:
    """A random value of ``schema``; ``root`` contains the definitions that it refers to."""
    root = schema if root is None else root
    if rng.random() < WRONG:
        return ODD[int(rng.integers(len(ODD)))]
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return value_of(root.get("$defs", {}).get(name, {}), rng, root, depth + 1)
    for choice in ("oneOf", "anyOf", "enum"):
        if choice in schema:
            picked = schema[choice][int(rng.integers(len(schema[choice])))]
            return picked if choice == "enum" else value_of(picked, rng, root, depth + 1)
    if "const" in schema:
        return schema["const"]
    kind = schema.get("type")
    if isinstance(kind, list):
        kind = kind[int(rng.integers(len(kind)))]
    if kind == "object":
        return _mapping(schema, rng, root, depth)
    if kind == "array":
        return _list(schema, rng, root, depth)
    if kind == "number":
        return number(schema, rng)
    if kind == "integer":
        return int(max(min(number(schema, rng), 2.0**62), -(2.0**62)))
    return {"boolean": bool(rng.random() < 0.5), "null": None}.get(
        kind or "", WORDS[int(rng.integers(len(WORDS)))]
    )


def number(schema: Mapping[str, Any], rng: Generator) -> float:
    """A number within the limits of ``schema``: a limit or 0, or in between, often logarithmic."""
    low = schema.get("minimum", schema.get("exclusiveMinimum", -LARGEST))
    high = schema.get("maximum", schema.get("exclusiveMaximum", LARGEST))
    if rng.random() < 0.15:
        return float([low, high, 0.0][int(rng.integers(3))])
    if low >= 0:
        least = math.log(max(low, 1e-12))
        return math.exp(rng.uniform(least, max(math.log(max(high, 1e-12)), least)))
    if rng.random() < 0.5:
        return float(rng.uniform(low, high))
    return float(rng.standard_normal() * 10.0 ** rng.integers(-6, 3))


def _mapping(
    schema: Mapping[str, Any], rng: Generator, root: Mapping[str, Any], depth: int
) -> dict[str, Any]:
    required = set(schema.get("required", ()))
    out = {}
    for name, inner in schema.get("properties", {}).items():
        if name in required or (depth < DEEPEST and rng.random() < 0.3):
            out[name] = value_of(inner, rng, root, depth + 1)
        elif "const" in inner:
            out[name] = inner["const"]
    free = schema.get("additionalProperties")
    if not schema.get("properties") and isinstance(free, dict):
        for _ in range(int(rng.integers(0, 3))):
            out[WORDS[int(rng.integers(len(WORDS)))]] = value_of(free, rng, root, depth + 1)
    return out


def _list(
    schema: Mapping[str, Any], rng: Generator, root: Mapping[str, Any], depth: int
) -> list[Any]:
    if "prefixItems" in schema:
        return [value_of(inner, rng, root, depth + 1) for inner in schema["prefixItems"]]
    low = schema.get("minItems", 0)
    count = int(rng.integers(low, schema.get("maxItems", low + 2) + 1))
    return [value_of(schema.get("items", {}), rng, root, depth + 1) for _ in range(count)]
