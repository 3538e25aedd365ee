"""A kernel on disk is good while all that it is made of is the same, wherever written."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import hiltestbed
from hiltestbed.compiled.jit import INTERPRETED_CALLS, Seldom
from hiltestbed.frames import quat_mul
from tests.scripts import program
from tests.slow import SLOW

LAW = """
from hiltestbed.compiled.jit import njit

FACTOR = {factor}


@njit(cache=True)
def law(x):
    return {sign}FACTOR * x
"""
USER = """
import law as laws
from hiltestbed.compiled.jit import njit
from law import FACTOR, law


@njit(cache=True)
def force(x):
    return law(x)


@njit(cache=True)
def constant(x):
    return FACTOR * x


@njit(cache=True)
def of_module(x):
    return laws.FACTOR * x


print(force(1.0), constant(1.0), of_module(1.0), *(sum(f.dispatcher.stats.cache_hits.values()) for f in (force, constant, of_module)))
"""


def printed(folder: Path, file: str, text: str, *arguments: str) -> str:
    """By a program of its own in the folder."""
    (folder / file).write_text(text)
    done = program("-B", file, *arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_an_old_kernel_is_taken_only_where_nothing_has_changed(tmp_path: Path) -> None:
    for factor, sign, expected in (
        (2.0, "", "2.0 2.0 2.0 0 0 0"),
        (2.0, "", "2.0 2.0 2.0 1 1 1"),
        (3.0, "", "3.0 3.0 3.0 0 0 0"),
        (3.0, "-", "-3.0 3.0 3.0 0 1 1"),
    ):
        (tmp_path / "law.py").write_text(LAW.format(factor=factor, sign=sign))
        assert printed(tmp_path, "user.py", USER) == expected


RECORD = """
from typing import NamedTuple


class {name}(NamedTuple):
    factor: float
"""
TAKER = """
from hiltestbed.compiled.jit import njit
from {module} import {name}


@njit(cache=True)
def twice(p):
    return 2.0 * p.factor


print(twice({name}(1.5)), sum(twice.dispatcher.stats.cache_hits.values()))
"""


@SLOW
def test_a_kernel_of_a_class_that_is_gone_is_compiled_anew(tmp_path: Path) -> None:
    """Renamed, and then in another module."""
    for module, name, hits in (
        ("records", "Record", 0),
        ("records", "Renamed", 0),
        ("moved", "Renamed", 0),
        ("moved", "Renamed", 1),
    ):
        (tmp_path / "records.py").unlink(missing_ok=True)
        (tmp_path / f"{module}.py").write_text(RECORD.format(name=name))
        found = printed(tmp_path, "taker.py", TAKER.format(module=module, name=name))
        assert found == f"3.0 {hits}", (module, name)


def test_every_kernel_of_the_package_is_marked() -> None:
    package = Path(hiltestbed.__file__).parent
    bare = re.compile(r"^\s*(from numba import .*\bnjit\b|@(numba\.)?jit\b)", re.MULTILINE)
    assert [
        file.name for file in package.rglob("*.py") if bare.search(file.read_text(encoding="utf-8"))
    ] == []


INSIDE = """
import sys

import numpy as np
from hiltestbed.compiled.jit import njit

if sys.argv[1] == "changed":

    @njit(cache=True)
    def other(x):
        return outer(x) + 1.0


@njit(cache=True)
def inner(x):
    if x[0] < 0.0:
        raise ValueError("below zero")
    return np.sqrt(x).sum()


@njit(cache=True)
def outer(x):
    return 2.0 * inner(x)


x = np.array([4.0, 9.0])
values = [outer(x), *([other(x)] if sys.argv[1] == "changed" else []), inner(x)]
try:
    outer(-x)
except ValueError as error:
    values.append(error)
print(*values)
"""


def test_a_kernel_inside_another_is_the_kernel_that_python_calls(tmp_path: Path) -> None:
    """Value and error, compiled or from the disk, and taken from there by a kernel that is new."""
    said = [printed(tmp_path, "inside.py", INSIDE, what) for what in ("", "", "changed")]
    assert said == ["10.0 5.0 below zero"] * 2 + ["10.0 11.0 5.0 below zero"]
    assert list(tmp_path.rglob("inner-inside.inner*.nbc"))


def test_a_kernel_that_is_seldom_called_gives_the_same_before_and_after_it_is_compiled() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 4))
    seldom, found = Seldom(quat_mul), np.empty((INTERPRETED_CALLS + 2, 4))
    for out in found:
        seldom(a, b, out)
    assert (found == found[0]).all()
