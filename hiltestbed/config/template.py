"""A scenario to start from, with a comment at every key, taken from the schema."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hiltestbed.config.validation import description_of
from hiltestbed.errors import InputError
from hiltestbed.run_folder.folders import safe_name
from hiltestbed.scenario import Scenario

WIDTH = 110
START: dict[str, Any] = {
    "name": "",
    "description": "Two free-flying vehicles touch head-on through a flat bumper.",
    "seed": 1,
    "duration": 1.5,
    "rate": 2000,
    "spacecraft": {
        "chaser": {
            "mass": 500.0,
            "inertia": [200.0, 180.0, 150.0],
            "port": {"position": [0.0, 0.0, 1.0]},
        },
        "target": {
            "mass": 2000.0,
            "inertia": [900.0, 900.0, 700.0],
            "port": {"position": [0.0, 0.0, -1.0]},
        },
    },
    "approach": {"gap": 0.01, "velocity": [0.0, 0.0, 0.03], "offset": [0.0, 0.0]},
    "mechanism": {
        "kind": "bumper",
        "contact": {"stiffness": 1.0e5, "damping": 400.0, "friction": 0.0},
    },
    "rig": {"platform": {"kind": "pss33", "tracking": "servo"}},
    "sensor": {"delay": 0.005, "lowpass": None, "noise": 0.0, "torque_noise": 0.0},
    "compensation": {"force": {"kind": "resynchronised"}, "motion": {"kind": "feedforward"}},
    "identification": {"kind": "rls"},
    "safety": {"force": 5.0e4, "energy": None},
    "effects": [],
}
HEAD = """\
# Check it:  hiltestbed check {file}
# Run it:    hiltestbed run {file}
# All keys: hiltestbed schema
"""


def template(name: str, changes: Mapping[str, Any] | None = None) -> str:
    """The scenario ``name`` as YAML text; ``changes``: keys that differ from :data:`START`."""
    data = START | {"name": name} | dict(changes or {})
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
