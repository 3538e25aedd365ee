"""Every key of a kind of file, with what it takes and means, from its JSON Schema; and the search
among them.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hiltestbed.errors import InputError

OF_ITS_KEYS = "those of its keys"  # the default of a section
REQUIRED = "must be given"
NUMBER, NAME = "N", "NAME"  # in a key: any item of a list, any name of a mapping


@dataclass(frozen=True)
class Key:
    """A key of a file.

    Attributes:
        path: its dotted name; items of lists are ``N``, freely chosen names ``NAME``.
        kinds: the ``kind`` of each section above it that has several, outermost first.
        takes: values, in words. default: as in JSON, or what stands for it. meaning: one sentence.
    """

    path: str
    kinds: tuple[str, ...]
    takes: str
    default: str
    meaning: str

    @property
    def value(self) -> str:
        """What it takes and its default, in words; of a ``kind``, which is its name, the latter."""
        named = bool(self.kinds) and self.takes == self.kinds[-1]
        word = "" if self.default == REQUIRED else "default "
        default = f"{word}{self.default}" if self.default else ""
        if named:
            return "the default" if word and default else ""
        return "; ".join(filter(None, (self.takes, default)))


def text_of(keys: Sequence[Key]) -> str:
    """Each key once: its value, the kinds that have it, and its meaning; where these differ from
    kind to kind, a line for each.
    """
    of_path: dict[str, list[Key]] = {}
    for key in keys:
        of_path.setdefault(key.path, []).append(key)
    return "\n".join(_entry(path, alike) for path, alike in of_path.items())


def _entry(path: str, keys: Sequence[Key]) -> str:
    """One key, which several kinds of its section may have."""
    variants: dict[tuple[str, str], dict[str, None]] = {}
    for key in keys:
        variants.setdefault((key.value, key.meaning), {})["/".join(key.kinds)] = None
    values = {value for value, _ in variants}
    shared = values.pop() if len(values) == 1 else ""
    lines = []
    for (value, meaning), kinds in variants.items():
        own = f" ({value})" if value != shared else ""
        lines.append(f"    {', '.join(kinds)}{own}: {meaning}")
    if len(variants) == 1:
        kinds = ", ".join(filter(None, next(iter(variants.values()))))
        path = f"{path} (kind: {kinds})" if kinds else path
        lines = [f"    {keys[0].meaning}"]
    return "\n".join([f"{path}: {shared}" if shared else path, *lines])


def keys_of(schema: Mapping[str, Any]) -> Iterator[Key]:
    """Every key below a JSON Schema, each section after its own key."""
    yield from _below(schema, schema.get("$defs", {}), "", ())


def at(keys: Sequence[Key], path: str) -> list[Key]:
    """A key and those directly below it. Raises InputError with the nearest if there is none."""
    parts = path.split(".")
    found = [key for key in keys if _matches(key.path.split("."), parts)]
    if not found:
        known = list(dict.fromkeys(key.path for key in keys))
        close = difflib.get_close_matches(path, known, n=3, cutoff=0.5)
        close = close or [p for p in known if p.rpartition(".")[2] == parts[-1]][:3]
        hint = f"nearest: {', '.join(close)}; " if close else ""
        raise InputError(
            f"schema: no such key (got {path!r}); {hint}hiltestbed schema --search WORD finds "
            f"keys by their meaning"
        )
    return found


def search(keys: Sequence[Key], words: str) -> list[Key]:
    """The keys whose name, kind or meaning contains every one of the words, whatever their case."""
    wanted = words.lower().split()
    texts = [f"{key.path} {' '.join(key.kinds)} {key.meaning}".lower() for key in keys]
    return [k for k, text in zip(keys, texts, strict=True) if all(word in text for word in wanted)]


def takes(about: Mapping[str, Any]) -> str:
    """What a key takes, in words."""
    if "const" in about:
        return f"`{about['const']}`"
    if "enum" in about:
        return ", ".join(f"`{value}`" for value in about["enum"])
    if "$ref" in about:
        return about["$ref"].rpartition("/")[2]
    for union in ("anyOf", "oneOf"):
        if union in about:
            return " or ".join(dict.fromkeys(takes(member) for member in about[union]))
    if about.get("type") == "array":
        inner = takes(about["items"]) if isinstance(about.get("items"), Mapping) else "values"
        count = about.get("minItems") if about.get("minItems") == about.get("maxItems") else None
        return f"list of {count or ''} {inner}".replace("  ", " ")
    bounds = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    limits = ", ".join(f"{sign} {about[name]:g}" for name, sign in bounds.items() if name in about)
    return " ".join(filter(None, [str(about.get("type", "anything")), limits]))


def default_of(about: Mapping[str, Any], required: bool) -> str:
    """The default of a key, in JSON; a section's stand with its keys."""
    if required:
        return REQUIRED
    value = about.get("default", "")
    if isinstance(value, Mapping) and value:
        return OF_ITS_KEYS
    return json.dumps(value) if "default" in about else ""


def _below(
    about: Mapping[str, Any], definitions: Mapping[str, Any], path: str, kinds: tuple[str, ...]
) -> Iterator[Key]:
    """The keys below one place of the schema."""
    if "$ref" in about:
        yield from _below(definitions[about["$ref"].rpartition("/")[2]], definitions, path, kinds)
    for member in (*about.get("anyOf", ()), *about.get("oneOf", ())):
        yield from _below(member, definitions, path, kinds)
    if isinstance(about.get("items"), Mapping):
        yield from _below(about["items"], definitions, f"{path}.{NUMBER}", kinds)
    if isinstance(about.get("additionalProperties"), Mapping):
        yield from _below(about["additionalProperties"], definitions, f"{path}.{NAME}", kinds)
    properties = about.get("properties", {})
    kind = properties.get("kind", {}).get("const")
    kinds = (*kinds, kind) if kind else kinds
    for name, inner in properties.items():
        here = f"{path}.{name}" if path else name
        words = _section_of(inner, definitions) or takes(inner).replace("`", "")
        default = default_of(inner, name in about.get("required", ()))
        yield Key(here, kinds, words, default, inner.get("description", "-"))
        yield from _below(inner, definitions, here, kinds)


def _section_of(about: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """What a section with several kinds takes, or a list of them; empty for anything else."""
    items = about.get("items")
    if isinstance(items, Mapping) and (inner := _section_of(items, definitions)):
        return f"list of {inner}"
    refs = [m["$ref"].rpartition("/")[2] for m in about.get("oneOf", ()) if "$ref" in m]
    found = [definitions[ref].get("properties", {}).get("kind", {}) for ref in refs]
    kinds = [kind["const"] for kind in found if "const" in kind]
    every = kinds and len(kinds) == len(about["oneOf"])
    return f"section of kind {', '.join(kinds)}" if every else ""


def _matches(path: Sequence[str], wanted: Sequence[str]) -> bool:
    """Whether a key is the wanted one or directly below it; numbers and names stand for any."""
    below = len(path) - len(wanted)
    if below < 0 or below > 1 + (path[len(wanted)] in (NUMBER, NAME) if below else 0):
        return False
    return all(
        p in (w, NAME) or (p == NUMBER and w.isdigit()) for p, w in zip(path, wanted, strict=False)
    )
