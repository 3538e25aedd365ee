"""What imports what: no circle among the modules of the package, imports for type checkers alone and
those inside functions included.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import hiltestbed
from tests.scripts import program
from tests.slow import slow

ROOT = Path(hiltestbed.__file__).parent


def modules() -> dict[str, Path]:
    """Name of every module of the package to its file."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def targets(
    node: ast.Import | ast.ImportFrom, known: dict[str, Path], importer: str
) -> Iterator[str]:
    """The modules of the package that an import loads."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in known)
        return
    module = node.module or ""
    if node.level:
        package = importer if known[importer].name == "__init__.py" else importer.rpartition(".")[0]
        above = package.split(".")[: len(package.split(".")) - node.level + 1]
        module = ".".join([*above, *filter(None, [module])])
    for alias in node.names:
        inner = f"{module}.{alias.name}"
        if inner in known:
            yield inner
        elif module in known:
            yield module


def every_import(tree: ast.Module) -> Iterator[ast.Import | ast.ImportFrom]:
    """All imports, wherever they stand."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node


def at_load(tree: ast.Module) -> Iterator[ast.Import | ast.ImportFrom]:
    """Those that run when the module is loaded."""
    yield from (node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom)))


@cache
def trees() -> dict[str, ast.Module]:
    return {n: ast.parse(path.read_text(encoding="utf-8")) for n, path in modules().items()}


def graph(imports, steps) -> dict[str, set[str]]:
    """Each module to the ``steps`` to what its ``imports`` name."""
    known, out = modules(), {}
    for name, tree in trees().items():
        nodes = imports(tree)
        found = {
            step for node in nodes for t in targets(node, known, name) for step in steps(name, t)
        }
        out[name] = found & set(known) - {name}
    return out


def circles(imported: dict[str, set[str]]) -> list[set[str]]:
    """The sets of modules that reach each other."""
    names = sorted(imported)
    number = {name: i for i, name in enumerate(names)}
    edges = [(number[a], number[b]) for a in names for b in imported[a]]
    rows, columns = zip(*edges, strict=True)
    matrix = csr_array((np.ones(len(edges)), (rows, columns)), shape=(len(names),) * 2)
    count, part = connected_components(matrix, connection="strong")
    found = [{n for n in names if part[number[n]] == i} for i in range(count)]
    return [one for one in found if len(one) > 1]


def packages_to(importer: str, module: str) -> Iterator[str]:
    """A module and the packages around it, but not the importer's own."""
    parts = module.split(".")
    steps = (".".join(parts[:end]) for end in range(2, len(parts) + 1))
    yield from (step for step in steps if not f"{importer}.".startswith(f"{step}."))


def test_no_module_imports_itself_by_way_of_others() -> None:
    loaded, named = graph(at_load, packages_to), graph(every_import, lambda importer, name: [name])
    assert len(loaded) > 200
    assert "hiltestbed.loop" in loaded["hiltestbed.simulation"]
    assert circles(loaded) == circles(named) == []


def test_no_block_of_the_loop_sees_a_scenario() -> None:
    """build.py takes their parameters out of it; interfaces of methods see the fields of a scenario."""
    blocks = tuple(f"hiltestbed.{p}." for p in ("sensor", "identification", "compensation"))
    blocks += ("hiltestbed.supervision.", "hiltestbed.effects.")
    seen = {
        name
        for name, tree in trees().items()
        if name.startswith(blocks)
        and any(alias.name == "Scenario" for node in every_import(tree) for alias in node.names)
    }
    assert not seen


def test_a_circle_is_seen_wherever_its_imports_stand() -> None:
    source = """
if TYPE_CHECKING:
    from a import b
def late():
    import c
"""
    seen = [ast.unparse(node) for node in every_import(ast.parse(source))]
    assert sorted(seen) == ["from a import b", "import c"]
    assert circles({"a": {"b"}, "b": {"c", "d"}, "c": {"a"}, "d": set()}) == [{"a", "b", "c"}]


@pytest.mark.parametrize(
    "first",
    [
        "replay",
        slow("compensation.force_methods.phase_lead"),
        slow("identification.methods.rls"),
    ],
)
def test_whatever_is_imported_first_the_table_of_methods_is_whole(first: str) -> None:
    text = f"import hiltestbed.{first}, hiltestbed as h; h.load_scenario('26-force-compensation')"
    assert program("-c", text).returncode == 0


def test_a_scenario_is_loaded_without_the_physics() -> None:
    """Of every shipped scenario: keys and numbers, no MuJoCo, Pinocchio or compiled code."""
    text = (
        "import sys, hiltestbed; from hiltestbed.config.gallery import scenario_names\n"
        "loaded = [hiltestbed.load_scenario(name) for name in scenario_names()]\n"
        "heavy = ('numba', 'mujoco', 'pinocchio', 'scipy')\n"
        "print(len(loaded) > 20, [name for name in heavy if name in sys.modules])"
    )
    assert program("-c", text).stdout.strip() == "True []"
