"""A registry whose modules cannot be imported says so, each time, until they can."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hiltestbed import plugins
from hiltestbed.errors import InputError
from hiltestbed.plugins import Registry


class Part:
    """A base class."""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package of parts, the second of which needs a package that is not installed."""
    package = tmp_path / "parts_of_a_test"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "first.py").touch()
    (package / "second.py").write_text("import package_that_is_missing\n")
    monkeypatch.setattr(plugins, "_REGISTRIES", list(plugins._REGISTRIES))
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in [n for n in sys.modules if n.startswith(("parts_of_a", "package_that_is"))]:
        del sys.modules[name]


def test_the_missing_package_is_named_at_each_access(home: Path) -> None:
    table = Registry("part", Part, ("parts_of_a_test",))
    for access in (lambda: table["first"], lambda: list(table), lambda: len(table)) * 2:
        with pytest.raises(ModuleNotFoundError, match="package_that_is_missing"):
            access()
    (home / "package_that_is_missing.py").touch()
    assert len(table) == 0


@pytest.mark.parametrize(
    "body",
    [
        "raise RuntimeError('own words')",
        "assert False, 'own words'",
        "import sys; sys.exit('own words')",
        "class Odd(Exception): pass\nraise Odd('own words')",
        "import own_words",
    ],
)
def test_a_plugin_that_fails_at_import_is_told_each_time(body: str, tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(body)
    for _ in range(2):
        with pytest.raises(InputError, match=r"own\.py.*own.words"):
            plugins.load([str(file)])
