"""A scenario to start from, with a comment at every key, taken from the schema."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hiltestbed.config.gallery import find_scenario
from hiltestbed.config.validation import description_of
from hiltestbed.config.yaml_source import read_source
from hiltestbed.errors import InputError
from hiltestbed.run_folder.folders import safe_name
from hiltestbed.scenario import Scenario

WIDTH = 110
# in which a scenario to start from differs from the reference scenario
CHANGES: dict[str, Any] = {
    "compensation": {"force": {"kind": "resynchronised"}, "motion": {"kind": "feedforward"}},
    "safety": {"force": 5.0e4, "energy": None},
}
HEAD = """\
# Check it:  hiltestbed check {file}
# Run it:    hiltestbed run {file}
# All keys: hiltestbed schema
"""


def template(name: str, changes: Mapping[str, Any] | None = None) -> str:
    """The reference scenario under another ``name`` as YAML text, with ``changes`` of keys."""
    data = read_source(find_scenario("reference-bumper")).data | CHANGES | {"name": name}
    del data["physics_rate"]  # a multiple of the rate, which may change
    data |= changes or {}
    return HEAD.format(file=f"{name}.yaml") + "\n".join(_lines(data, (), data)) + "\n"


def free_file(name: str) -> Path:
    """NAME.yaml in the current folder. Raises InputError if it exists or the name is not a valid
    file name.
    """
    stem = name.removesuffix(".yaml")
    if safe_name(stem) != stem:
        raise InputError(
            f"new: invalid name for a scenario (got {name!r}); allowed are letters, digits, '-', "
            f"'_' and '.', such as my-rig"
        )
    path = Path(f"{stem}.yaml")
    if path.exists():
        raise InputError(f"{path}: exists already; choose another name")
    return path


def write_template(name: str) -> Path:
    """Write NAME.yaml into the current folder. Raises InputError, see :func:`free_file`."""
    path = free_file(name)
    path.write_text(template(path.stem), encoding="utf-8")
    return path


def _lines(data: dict[str, Any], path: tuple[str, ...], whole: dict[str, Any]) -> Iterator[str]:
    indent = "  " * len(path)
    for key, value in data.items():
        text = description_of(Scenario, whole, (*path, key))
        yield from (f"{indent}# {line}" for line in textwrap.wrap(text, WIDTH - len(indent)))
        if isinstance(value, dict):
            yield f"{indent}{key}:"
            yield from _lines(value, (*path, key), whole)
        else:
            yield f"{indent}{key}: {_scalar(value)}"


def _scalar(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, list):
        return f"[{', '.join(map(_scalar, value))}]"
    return (
        f"{value:g}"
        if isinstance(value, float) and abs(value) < 1e4
        else f"{value:.1e}"
        if isinstance(value, float)
        else str(value)
    )
