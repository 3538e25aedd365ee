"""The documentation: every block that can run does run, and the reference has every key, effect,
method, column and public name.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import hiltestbed
from hiltestbed.config.check import KINDS, json_schema
from hiltestbed.effects import EFFECTS
from hiltestbed.signals import GROUPS
from tests.scripts import module
from tests.slow import slow

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(
    r"(?P<skip><!-- not run: [^>]*-->\n)?```(?P<language>python|console)\n(?P<text>.*?)```",
    re.DOTALL,
)
PAGES = sorted(
    p
    for p in (*DOCS.rglob("*.md"), ROOT / "README.md")
    if any(not b["skip"] for b in BLOCK.finditer(p.read_text()))
)
LONG = ("my-data",)  # a diagnosis and its figures
OPEN = ("view",)  # commands that need a display


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    return module(DOCS / "reference_pages.py")


@pytest.fixture(scope="module")
def pages(reference: ModuleType) -> dict[str, str]:
    return reference.pages() | module(DOCS / "gallery_pages.py").pages()


@pytest.mark.usefixtures("tables_as_shipped")
@pytest.mark.parametrize(
    "page",
    [slow(p) if p.stem in LONG else p for p in PAGES],
    ids=[str(p.relative_to(ROOT)) for p in PAGES],
)
def test_the_blocks_of_a_page_run_one_after_the_other(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call
) -> None:
    """In one folder and one namespace, as a reader would type them; the numbers that a page shows
    below a command are those that it prints.
    """
    pytest.importorskip("pandas")
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.chdir(tmp_path)
    printed = ""
    namespace: dict[str, object] = {}
    for block in BLOCK.finditer(page.read_text()):
        if block["skip"]:
            continue
        if block["language"] == "python":
            # what is run is this repository's own documentation
            exec(compile(block["text"], str(page), "exec"), namespace)
            continue
        for line in block["text"].splitlines():
            if line.startswith("$ hiltestbed "):
                arguments = shlex.split(
                    line.removeprefix("$ hiltestbed ").replace(
                        "PLUGINS", str(ROOT / "examples" / "plugins")
                    ),
                    comments=True,
                )
                if arguments[0] not in OPEN:
                    status, printed, _ = call(*arguments)
                    assert status == 0, line
            elif not line.startswith("$"):
                shown = re.findall(r"-?\d[\d.e+]*", line)
                assert not [number for number in shown if number not in printed], line


def described(schema: dict) -> Iterator[tuple[str, str]]:
    """Every key of a schema with its description."""
    for definition in (schema, *schema.get("$defs", {}).values()):
        for key, about in definition.get("properties", {}).items():
            yield key, about.get("description", "")


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_is_in_the_reference_with_its_meaning(kind: str, pages: dict[str, str]) -> None:
    page = pages[f"reference/{kind}.md"] + pages["reference/effects.md"]
    for key, meaning in described(json_schema(kind)):  # type: ignore[arg-type]
        assert f"`{key}`" in page or key == "kind"
        assert meaning, f"{kind}: {key} has no description"


def test_every_effect_method_column_and_name_is_in_the_reference(
    pages: dict[str, str], reference: ModuleType
) -> None:
    for kind, cls in EFFECTS.items():
        assert f"### `{kind}`" in pages["reference/effects.md"]
        assert cls.equation in pages["reference/effects.md"]
    for group in GROUPS.values():
        assert all(f"`{column}`" in pages["reference/columns.md"] for column in group.columns)
    for name in hiltestbed.__all__:
        assert f"## `{name}`" in pages["reference/python.md"]
    ours = ["run", "check", "sweep", "diagnose", "compare", "new", "doctor", "bench", "schema"]
    for command in (*ours, "view"):
        assert f"## `hiltestbed {command}`" in pages["reference/commands.md"]
    assert set(reference.EXIT_STATUS) == {0, 1, 2, 3}


def test_a_page_with_a_picture_names_the_command_that_made_it() -> None:
    for page in (*DOCS.rglob("*.md"), ROOT / "README.md"):
        text = page.read_text()
        if re.search(r"\.(png|gif)[\")]", text):
            assert re.search(r"`[^`]*(python docs/examples/|hiltestbed view )[^`]*`", text), page


def test_a_table_of_figures_stands_with_the_command_that_makes_them() -> None:
    """In its section; four decimals or more make a table one of figures."""
    for page in (*DOCS.rglob("*.md"), ROOT / "README.md"):
        for section in re.split(r"^(?=#+ )", page.read_text(), flags=re.MULTILINE):
            tables = re.findall(r"(?:^\|.*\n)+", section, flags=re.MULTILINE)
            if any(len(re.findall(r"\d\.\d", table)) > 3 for table in tables):
                named = re.search(r"hiltestbed\s+[a-z]+|python |pytest ", section)
                assert named, f"{page.name}: {section.splitlines()[0]}"


LINK = re.compile(r"\]\((?!https?://|mailto:|#)([^)#]+)")
BESIDE = ("README", "CHANGELOG", "CONTRIBUTING", "SECURITY", "SUPPORT")


def test_links_lead_somewhere_where_the_repository_is_read() -> None:
    for page in (*DOCS.rglob("*.md"), *(ROOT / f"{name}.md" for name in BESIDE)):
        for target in LINK.findall(page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_links_lead_somewhere_on_the_site(pages: dict[str, str]) -> None:
    """To a page or a file below the documentation, or to one that is made from the code."""
    links = module(DOCS / "repository_links.py")
    for page in DOCS.rglob("*.md"):
        here = page.relative_to(DOCS)
        for target in LINK.findall(links.for_the_site(page.read_text(), here.as_posix())):
            path = (page.parent / target).resolve()
            assert path.is_relative_to(DOCS.resolve()), f"{here}: {target} leaves the site"
            assert path.exists() or str(path.relative_to(DOCS.resolve())) in pages, (
                f"{here}: {target}"
            )
