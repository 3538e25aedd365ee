"""YAML 1.2 files as plain data with the place of each key.

A `Source` is the tree of a file (dicts, lists, numbers, strings) with the line and column of every
key, and with the `--set` overrides applied. This module is independent of the content of a
scenario.
"""

from __future__ import annotations

import copy
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltestbed.config.gallery import find_scenario, scenario_names
from hiltestbed.errors import Fault, InputError
from hiltestbed.run_folder.folders import is_file

# [byte] a scenario is a page or two; a file a hundred times larger is something else
SIZE_LIMIT = 500_000
VALUE_LIMIT = 100_000  # values after expansion of aliases: nested aliases grow without bound
DEPTH_LIMIT = 40

KeyPath = tuple[str | int, ...]

_PREFIX = "tag:yaml.org,2002:"
_SCALARS = {
    _PREFIX + name for name in ("null", "bool", "int", "float", "str", "timestamp", "binary")
}


def dotted(path: KeyPath) -> str:
    """`("approach", "velocity", 2)` as written on the command line: `approach.velocity.2`."""
    return ".".join(str(part) for part in path)


@dataclass
class Source:
    """The data of one file (or of a dict from Python), with the place of each key; `overridden` are
    the paths set by overrides.
    """

    file: str
    data: Any
    marks: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)
    overridden: frozenset[KeyPath] = frozenset()

    @property
    def folder(self) -> Path:
        """The folder to which paths in the file are relative."""
        return Path(self.file).parent

    def fault(self, path: KeyPath, message: str) -> Fault:
        """A fault at `path`, or at the nearest key above it that is in the file or in a `--set`."""
        key = dotted(path)
        for end in range(len(path), -1, -1):
            if path[:end] in self.overridden:
                return Fault(f"--set {dotted(path[:end])}", None, None, key, message)
        # a key that is not in the file was created by an override below it
        if path and path not in self.marks:
            for below in sorted(self.overridden, key=dotted):
                if below[: len(path)] == path:
                    return Fault(f"--set {dotted(below)}", None, None, key, message)
        for end in range(len(path), -1, -1):
            if path[:end] in self.marks:
                line, column = self.marks[path[:end]]
                return Fault(self.file, line, column, key, message)
        return Fault(self.file, *((1, 1) if self.marks else (None, None)), key, message)

    def relocated(self, fault: Fault, base: KeyPath) -> Fault:
        """The place of a fault of an override that stands in this source below `base`."""
        if not fault.file.startswith("--set "):
            return fault
        key = fault.file.removeprefix("--set ")
        message = fault.message if fault.key == key else f"{fault.key}: {fault.message}"
        return self.fault((*base, key), message)

    def with_set(self, overrides: Mapping[str, Any] | None) -> Source:
        """The same with dotted keys set, strings read as YAML. Raises InputError."""
        if not overrides:
            return self
        result = Source(self.file, copy.deepcopy(self.data), self.marks, self.overridden)
        faults = []
        for key, value in overrides.items():
            path = key_path(key)
            if isinstance(value, str):
                try:
                    value = parse_yaml(value, f"--set {key}")[0]
                except InputError as error:
                    said = (fault.message for fault in error.faults)
                    faults += [Fault(f"--set {key}", None, None, key, text) for text in said]
                    continue
            problem = "is not a key" if not key or "" in path else _assign(result.data, path, value)
            if problem:
                faults.append(Fault(f"--set {key}", None, None, key, problem))
            result.overridden |= {path}
        if faults:
            raise InputError(faults)
        return result


def key_path(key: str) -> KeyPath:
    """`approach.velocity.2` as `("approach", "velocity", 2)`: digits are the index of an item."""
    return tuple(int(part) if part.isdecimal() else part for part in key.split("."))


def _assign(data: Any, path: KeyPath, value: Any) -> str | None:
    """Sets `value` at `path`, creating mappings as needed; a message if that is impossible."""
    node = data
    for depth, part in enumerate(path):
        last = depth == len(path) - 1
        where = dotted(path[:depth]) or "the file"
        if isinstance(node, list):
            if not isinstance(part, int):
                return (
                    f"{where} is a list (got the key {part!r}); its items are numbered 0 "
                    f"to {max(len(node) - 1, 0)}"
                )
            size = len(node)
            if part > size:
                return f"{where} has {size} items (got number {part}); allowed is 0 to {size}"
            node += [None] * (part == len(node))
        elif isinstance(node, dict):
            part = str(part)
            node.setdefault(part)
        else:
            return f"{where} is {describe(node)}, which has no keys (got the key {part!r})"
        if last:
            node[part] = value  # type: ignore[index]
        elif node[part] is None:  # type: ignore[index]
            node[part] = [] if isinstance(path[depth + 1], int) else {}  # type: ignore[index]
        node = node[part]  # type: ignore[index]
    return None


def describe(value: Any) -> str:
    """A value as shown in a message, shortened if necessary."""
    if isinstance(value, dict):
        return "a mapping"
    if value is None:
        return "null"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def read_source(path: str | Path) -> Source:
    """Reads one YAML file of limited size. Raises InputError for anything else."""
    path = Path(path)
    text = _read_text(path)
    data, marks = parse_yaml(text, str(path))
    if data is None:
        text = "the file is empty; a YAML mapping is expected"
        raise InputError(Fault(str(path), 1, 1, "", text))
    if not isinstance(data, dict):
        text = f"the file holds {describe(data)}; a YAML mapping (key: value) is expected"
        raise InputError(Fault(str(path), 1, 1, "", text))
    return Source(str(path), data, marks)


def referenced_source(source: Source) -> Source:
    """The file beside a source, or the shipped scenario, that it names under `scenario`. Raises
    InputError.
    """
    name = source.data["scenario"]
    target = source.folder / str(name)
    if is_file(target):
        return read_source(target)
    if str(name) in scenario_names():
        return read_source(find_scenario(str(name)))
    text = f"names no file and no shipped scenario (got {describe(name)}); looked for {target}"
    raise InputError(source.fault(("scenario",), text))


def _read_text(path: Path) -> str:
    def refuse(message: str) -> InputError:
        return InputError(Fault(str(path), None, None, "", message))

    try:
        if path.is_dir():
            raise refuse("is a folder; a YAML file is expected")
        if not path.exists():
            raise refuse("no such file")
        if not path.is_file():
            raise refuse("is not a regular file; a YAML file is expected")
        size = path.stat().st_size
        if size > SIZE_LIMIT:
            raise refuse(
                f"the file is too large (got {size / 1e6:.1f} MB); at most {SIZE_LIMIT / 1e6:g} "
                f"MB is read"
            )
        raw = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise refuse(f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if b"\0" in raw:
        raise refuse("is a binary file; a YAML file is expected")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - (raw.rfind(b"\n", 0, error.start) + 1) + 1
        byte = raw[error.start]
        message = f"is not UTF-8 text (got byte 0x{byte:02x}); a YAML file in UTF-8 is expected"
        raise InputError(Fault(str(path), line, column, "", message)) from None


def parse_yaml(text: str, file: str) -> tuple[Any, dict[KeyPath, tuple[int, int]]]:
    """YAML text as plain data, with the (line, column) of every key and list item, counted from 1.
    Raises InputError.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    def refuse(what: object, line: int = 1, column: int = 1) -> InputError:
        return InputError(Fault(file, line, column, "", f"is {what}"))

    try:
        node = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
        raise refuse(f"not YAML: {error.problem or error.context}", *place) from None
    except YAMLError as error:
        line = text.count("\n", 0, getattr(error, "position", 0)) + 1
        reason = getattr(error, "reason", None) or str(error).splitlines()[0]
        raise refuse(f"not YAML: {reason}", line) from None
    except RecursionError:
        raise refuse(f"nested too deeply; at most {DEPTH_LIMIT} levels are read") from None
    except ValueError as error:
        raise refuse(f"not YAML: {error}") from None
    builder = _Builder(file)
    data = None if node is None else builder.build(node, ())
    if builder.faults:
        raise InputError(builder.faults)
    return data, builder.marks


def dump_yaml(data: Any) -> str:
    """Plain data as YAML text, which reads back as the same data."""
    from ruamel.yaml import YAML

    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None  # lists of numbers on one line, mappings below each other
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    text = io.StringIO()
    yaml.dump(data, text)
    return text.getvalue()


def _place(node: Any) -> tuple[int, int]:
    """Line and column of a YAML node, counted from 1."""
    return node.start_mark.line + 1, node.start_mark.column + 1


class _Builder:
    """Plain data from YAML nodes; duplicate keys and unusable values become faults."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.marks: dict[KeyPath, tuple[int, int]] = {(): (1, 1)}
        self.faults: list[Fault] = []
        self.count = 0

    def fault(self, node: Any, path: KeyPath, message: str) -> None:
        self.faults.append(Fault(self.file, *_place(node), dotted(path), message))

    def build(self, node: Any, path: KeyPath) -> Any:
        self.count += 1
        if self.count > VALUE_LIMIT or len(path) > DEPTH_LIMIT:
            limit = f"{VALUE_LIMIT} values" if self.count > VALUE_LIMIT else f"{DEPTH_LIMIT} levels"
            self.faults.clear()
            self.fault(node, (), f"is too large; at most {limit} are read")
            raise InputError(self.faults)
        if node.id == "mapping":
            return self._mapping(node, path)
        if node.id == "sequence":
            items = []
            for index, item in enumerate(node.value):
                self.marks[(*path, index)] = _place(item)
                items.append(self.build(item, (*path, index)))
            return items
        return self._scalar(node, path)

    def _mapping(self, node: Any, path: KeyPath) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if key_node.id != "scalar":
                self.fault(key_node, path, "a key is a list or a mapping; a key is a name")
                continue
            key = str(key_node.value)
            there = (*path, key)
            if key in result:
                first = self.marks[there][0]
                text = f"is given twice (first in line {first}); each key may stand once"
                self.fault(key_node, there, text)
                self.build(value_node, there)
            else:
                self.marks[there] = _place(key_node)
                result[key] = self.build(value_node, there)
        return result

    def _scalar(self, node: Any, path: KeyPath) -> Any:
        tag, text = str(node.tag), node.value
        if tag not in _SCALARS:
            what = f"has the tag {tag.removeprefix(_PREFIX)!r}; plain YAML values alone are read"
            self.fault(node, path, what)
            return None
        try:
            if tag == _PREFIX + "null":
                return None
            if tag == _PREFIX + "bool":
                return text.lower() == "true"
            if tag == _PREFIX + "int":
                return _integer(text)
            if tag == _PREFIX + "float":
                return _float(text)
        except ValueError:
            self.fault(node, path, f"cannot be read as a number (got {describe(text)})")
            return None
        return text


def _integer(text: str) -> int:
    digits = text.replace("_", "")
    if len(digits) > 400:  # Python refuses to convert thousands of digits, and no value needs them
        raise ValueError(text)
    if digits.lstrip("+-")[:2] in ("0x", "0o", "0b"):
        return int(digits, 0)
    return int(digits)


def _float(text: str) -> float:
    lowered = text.replace("_", "").lower()
    if lowered.lstrip("+-") == ".inf":
        return -math.inf if lowered.startswith("-") else math.inf
    return math.nan if lowered == ".nan" else float(lowered)
