"""The reference pages, made from the code: every scenario key, effect, method, column, command and
public name.

MkDocs calls :func:`on_files` while it builds; nothing of this is kept on disk. `python
docs/reference_pages.py DIR` writes the pages.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hiltestbed.effects.departure import Departure

EXIT_STATUS = {
    0: "done",
    1: "anything else that failed: a file that cannot be written, an interrupted run, a missing "
    "extra",
    2: "bad input: every fault, with file, line and column",
    3: "the simulation diverged, a safety limit stopped it, or its reference makes energy; the "
    "folder is written all the same",
}


def pages() -> dict[str, str]:
    """Path below the documentation to Markdown text."""
    return {
        "reference/commands.md": commands(),
        "reference/scenario.md": keys("scenario", "Scenario"),
        "reference/campaign.md": keys("campaign", "Campaign"),
        "reference/dataset.md": keys("dataset", "Dataset"),
        "reference/axis.md": keys("axis", "Axis"),
        "reference/arm.md": keys("arm", "Arm"),
        "reference/effects.md": effects(),
        "reference/methods.md": methods(),
        "reference/columns.md": columns(),
        "reference/python.md": python(),
    }


def on_files(files: Any, config: Any) -> Any:
    """MkDocs' hook: add the pages."""
    from mkdocs.structure.files import File

    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_content(html: str, **_: Any) -> str:
    """MkDocs' hook: formulas as MathML, which browsers show without a script."""
    from html import unescape

    from latex2mathml.converter import convert

    def mathml(found: re.Match[str]) -> str:
        return convert(
            unescape(found[3]).strip(), display="block" if found[1] == "div" else "inline"
        )

    return re.sub(
        r'<(div|span) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', mathml, html, flags=re.DOTALL
    )


def keys(kind: str, title: str) -> str:
    """Every key of a kind of file, from its JSON Schema."""
    from hiltestbed.config.check import json_schema

    schema = json_schema(kind)  # type: ignore[arg-type]
    lines = [
        f"# {title}",
        "",
        f"Every key of {_a(kind)} file, as `hiltestbed schema {kind}` prints it. Units stand in "
        f"brackets.",
        "",
    ]
    lines += _section("the file", schema)
    for name, definition in schema.get("$defs", {}).items():
        if kind in ("scenario", "axis", "arm") and _is_effect(definition):
            continue  # they have a page of their own
        if "properties" in definition:
            lines += _section(_called(name, definition), definition)
    return "\n".join(lines) + "\n"


def _a(word: str) -> str:
    return f"an {word}" if word[0] in "aeiou" else f"a {word}"


def _is_effect(definition: Mapping[str, Any]) -> bool:
    return "." in str(definition.get("properties", {}).get("kind", {}).get("const", ""))


def _called(name: str, definition: Mapping[str, Any]) -> str:
    kind = definition.get("properties", {}).get("kind", {}).get("const")
    return f"`{{kind: {kind}}}`" if kind else name


def _section(title: str, definition: Mapping[str, Any]) -> Iterator[str]:
    from hiltestbed.config.keys import OF_ITS_KEYS, default_of, takes

    yield from (f"## {title}", "", _cell(definition.get("description", "")), "")
    yield from ("| key | takes | default | meaning |", "|---|---|---|---|")
    required = definition.get("required", ())
    for key, about in definition.get("properties", {}).items():
        default = default_of(about, key in required)
        default = (
            "**must be given**"
            if key in required
            else f"`{default}`"
            if default and default != OF_ITS_KEYS
            else default
        )
        yield (
            f"| `{key}` | {_cell(takes(about))} | {_cell(default)} | "
            f"{_cell(about.get('description', ''))} |"
        )
    yield ""


ACT_ON = {  # link to what holds for all of its effects
    "platform": (
        "They act on the commanded position, on each of the three translations alike; the "
        "attitude follows its command.",
        "",
    ),
}


def effects() -> str:
    """The vocabulary."""
    from hiltestbed.axis.effects.base import AXIS_EFFECTS
    from hiltestbed.effects import EFFECTS
    from hiltestbed.effects.departure import LINKS

    lines = [
        "# Effects",
        "",
        "One vocabulary for `effects:` in a scenario and for the causes of a diagnosis.",
        "",
    ]
    for link in LINKS:
        mine = {kind: cls for kind, cls in EFFECTS.items() if cls.link == link}
        lines += [f"## {link}", "", *ACT_ON.get(link, ())] if mine else []
        for kind, cls in mine.items():
            lines += _effect(kind, cls)
    lines += [
        "## Of one axis",
        "",
        "Those of a [drive, a servo, a damper or an arm](../tutorials/one-axis.md).",
        "",
    ]
    for kind, cls in AXIS_EFFECTS.items():
        lines += _effect(kind, cls)
    return "\n".join(lines) + "\n"


def _effect(kind: str, cls: type[Departure]) -> list[str]:
    axes = getattr(cls, "axes", ())
    lines = [
        f"### `{kind}`" + (f" of a {' or '.join(axes)}" if axes else ""),
        "",
        cls.meaning(),
        "",
        f"- Equation: `{cls.equation}`",
        f"- Source: {cls.reference}",
    ]
    if cls.resembles:
        lines.append(f"- Easily taken for: {', '.join(f'`{name}`' for name in cls.resembles)}")
    lines += ["", "| parameter | unit | meaning |", "|---|---|---|"]
    lines += [
        f"| `{name}` | {cls.unit(name) or '-'} | {_cell(field.description or '')} |"
        for name, field in cls.model_fields.items()
        if name != "kind"
    ]
    return [*lines, ""]


def methods() -> str:
    """Every class that a scenario chooses by its kind, apart from the effects."""
    from hiltestbed.compensation.measurement import Measurement
    from hiltestbed.compensation.settings import FORCE_METHODS, MOTION_METHODS
    from hiltestbed.contact.settings import MECHANISMS
    from hiltestbed.identification.settings import IDENTIFIERS
    from hiltestbed.platform.kinds import PLATFORMS

    lines = ["# Methods, mechanisms, platforms", ""]
    tables = {
        "compensation.force": FORCE_METHODS,
        "compensation.motion": MOTION_METHODS,
        "identification": IDENTIFIERS,
        "mechanism": MECHANISMS,
        "rig.platform": PLATFORMS,
    }
    for key, table in tables.items():
        lines += [f"## `{key}`", "", "| kind | what it is | settings |", "|---|---|---|"]
        for kind, cls in sorted(table.items()):
            settings = ", ".join(f"`{name}`" for name in cls.model_fields if name != "kind")
            lines.append(
                f"| `{kind}` | {_cell((inspect.getdoc(cls) or '').partition(chr(10))[0])} | "
                f"{settings} |"
            )
        lines.append("")
    lines += ["## What a method may know at a tick", "", inspect.getdoc(Measurement) or "", ""]
    return "\n".join(lines) + "\n"


def columns() -> str:
    """The columns of trace.parquet."""
    from hiltestbed.signals import GROUPS

    lines = [
        "# Columns of a trace",
        "",
        "One row a tick; unit, frame and meaning stand in the metadata of each field, too.",
        "",
    ]
    lines += [
        "| columns | unit | frame | meaning |",
        "|---|---|---|---|",
        "| `t` | s | | time from the start, tick/rate |",
    ]
    for group in GROUPS.values():
        names = ", ".join(f"`{name}`" for name in group.columns)
        lines.append(
            f"| {names} | {', '.join(dict.fromkeys(group.units))} | {group.frame} | "
            f"{group.meaning} |"
        )
    lines += [
        "| `joint.NAME` | m, rad | mechanism | each joint of its moving parts, as in its MJCF |",
        "| `contact` | | | the mechanisms touch |",
        "",
    ]
    return "\n".join(lines) + "\n"


def commands() -> str:
    """The command line, from the program itself, and its exit status."""
    import typer

    from hiltestbed.cli import app

    group = typer.main.get_command(app)
    lines = [
        "# Commands",
        "",
        "`--plugin MODULE` and `--figures` (figures of reports as PNG and SVG, too) may stand "
        "with every command.",
        "",
    ]
    for name, command in sorted(group.commands.items()):  # type: ignore[attr-defined]
        lines += [
            f"## `hiltestbed {name}`",
            "",
            inspect.cleandoc(command.help or ""),
            "",
            "| | |",
            "|---|---|",
        ]
        for parameter in command.params:
            told = parameter.metavar or ""
            called = (
                f"{', '.join(parameter.opts)} {told}"
                if parameter.param_type_name == "option"
                else told or parameter.name
            )
            lines.append(f"| `{_cell(called)}` | {_cell(getattr(parameter, 'help', '') or '')} |")
        lines.append("")
    lines += ["## Exit status", "", "| status | meaning |", "|---|---|"]
    lines += [f"| {status} | {meaning} |" for status, meaning in EXIT_STATUS.items()]
    return "\n".join(lines) + "\n"


def python() -> str:
    """The public names of the package."""
    import hiltestbed

    lines = ["# Python", "", "Everything below is an attribute of `hiltestbed`.", ""]
    for name in hiltestbed.__all__:
        thing = getattr(hiltestbed, name)
        if not callable(thing):
            lines += [f"## `{name}`", "", f"`{thing}`", ""]
            continue
        lines += [f"## `{name}`", ""]
        if inspect.isclass(thing):
            lines += [_indented(inspect.getdoc(thing) or ""), ""]
            for method, function in inspect.getmembers(thing, inspect.isfunction):
                if not method.startswith("_") and function.__module__.startswith("hiltestbed"):
                    lines += [
                        f"- `{method}{_signature(function)}`: "
                        f"{(inspect.getdoc(function) or '').partition(chr(10))[0]}"
                    ]
            lines.append("")
        else:
            lines += [
                "```text",
                f"{name}{_signature(thing)}",
                "```",
                "",
                _indented(inspect.getdoc(thing) or ""),
                "",
            ]
    return "\n".join(lines) + "\n"


def _signature(function: Any) -> str:
    return str(inspect.signature(function)).replace("'", "")


def _indented(text: str) -> str:
    """A docstring as preformatted text: its columns are meant."""
    return "```text\n" + text + "\n```"


def _cell(text: str) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


if __name__ == "__main__":
    root = Path(sys.argv[1])
    for path, text in pages().items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text, encoding="utf-8")
