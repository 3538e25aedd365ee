"""What imports what: no circle among the modules of the package, as far as it is imported when a
module is loaded.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import hiltestbed

ROOT = Path(hiltestbed.__file__).parent


def modules() -> dict[str, Path]:
    """Name of every module of the package to its file."""
    found = {}
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def loaded_at_import(tree: ast.Module) -> Iterator[ast.Import | ast.ImportFrom]:
    """The imports that run when the module is loaded: not those of functions, not those for type
    checkers alone.
    """
    waiting: list[ast.AST] = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node
        elif isinstance(node, ast.If):
            named = ast.unparse(node.test)
            waiting += (
                node.orelse if named.endswith("TYPE_CHECKING") else [*node.body, *node.orelse]
            )
        elif not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            waiting += [
                child
                for child in ast.iter_child_nodes(node)
                if isinstance(child, ast.stmt | ast.excepthandler)
            ]


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


def graph() -> dict[str, set[str]]:
    known = modules()
    out = {}
    for name, path in known.items():
        nodes = loaded_at_import(ast.parse(path.read_text(encoding="utf-8")))
        direct = {target for node in nodes for target in targets(node, known, name)}
        out[name] = {
            step
            for target in direct
            for step in packages_to(target)
            if not f"{name}.".startswith(f"{step}.")
        }
    return out


def packages_to(module: str) -> Iterator[str]:
    """A module and the packages around it, whose __init__ runs before it."""
    parts = module.split(".")
    yield from (".".join(parts[:end]) for end in range(2, len(parts) + 1))


def test_no_module_imports_itself_by_way_of_others() -> None:
    try:
        tuple(TopologicalSorter(graph()).static_order())
    except CycleError as error:
        raise AssertionError("import circle: " + " <- ".join(error.args[1])) from None


def test_the_walk_sees_imports() -> None:
    found = graph()
    assert "hiltestbed.loop" in found["hiltestbed.simulation"]
    # imported by the command that needs it
    assert "hiltestbed.diagnosis.diagnose" not in found["hiltestbed.cli.studies"]
    assert len(found) > 200
