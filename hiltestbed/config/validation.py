"""From a `Source` to a pydantic model, or to all faults at once, with messages that say what is
allowed.
"""

from __future__ import annotations

import copy
import difflib
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    ValidationError,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from hiltestbed.config.models import models_folder
from hiltestbed.config.yaml_source import KeyPath, Source, describe
from hiltestbed.errors import InputError
from hiltestbed.plugins import OneOf
from hiltestbed.run_folder.folders import is_file

Model = TypeVar("Model", bound=BaseModel)
Problem = tuple[KeyPath, str]


class Strictly(BaseModel):
    """Base of every model that is read from a file: no unknown keys, no silent conversion, no NaN
    or infinity, immutable.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    def idle(self, scenario: Any) -> Iterable[Problem]:
        """Keys below this one that have no effect in ``scenario`` because of other settings, each
        with the reason and what to do.

        The path of a section means every key in it.
        """
        return ()


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
# lists in a file, tuples in memory
Vector2 = Annotated[tuple[float, ...], Strict(False), Field(min_length=2, max_length=2)]
Vector3 = Annotated[tuple[float, ...], Strict(False), Field(min_length=3, max_length=3)]


class UserFile(NamedTuple):
    """Marks a key that names a file of the user's, which belongs to the scenario: its content is in
    the hash, and a copy of it in the run folder.

    Attributes:
        mjcf: whether it is an MJCF file, which belongs there with all the files that it names.
        shipped: whether it may also name one of the shipped models, which stay where they are.
    """

    mjcf: bool = True
    shipped: bool = False

    def found(self, name: str, info: ValidationInfo) -> str:
        """The path of the file: absolute, relative paths start at the folder of the file that
        names it; that of a shipped one as it is.
        """
        path = (info.context or {}).get("folder", Path()) / name
        with suppress(OSError, ValueError):  # a name that the file system does not accept
            path = path.resolve()
        if is_file(path):
            return str(path)
        if self.shipped and is_file(models_folder() / name):
            return name
        raise PydanticCustomError(
            "no_file",
            "no such file (looked for {path})",
            {"path": str(path)},
        )


_MJCF, _SHIPPED, _OTHER = UserFile(), UserFile(shipped=True), UserFile(mjcf=False)
ModelFile = Annotated[str, AfterValidator(_MJCF.found), _MJCF]
ModelOrShipped = Annotated[str, AfterValidator(_SHIPPED.found), _SHIPPED]
AnyFile = Annotated[str, AfterValidator(_OTHER.found), _OTHER]


def user_files(model: BaseModel) -> dict[KeyPath, tuple[Path, UserFile]]:
    """The files of the user's that a scenario or a section names, by the path of the key."""
    found: dict[KeyPath, tuple[Path, UserFile]] = {}
    for key, value in model:
        mark = next(
            (m for m in type(model).model_fields[key].metadata if isinstance(m, UserFile)), None
        )
        if mark is not None and Path(value).is_absolute():
            found[key,] = Path(value), mark
        several = isinstance(value, (list, tuple))
        items = {(key, i): v for i, v in enumerate(value)} if several else {(key,): value}
        for head, item in items.items():
            if isinstance(item, BaseModel):
                found |= {(*head, *path): entry for path, entry in user_files(item).items()}
    return found


def refuse(problems: Iterable[Problem]) -> None:
    """For validators: raises all `problems` (path below the model, message), if there are any."""
    found = list(problems)
    if found:
        raise PydanticCustomError(
            "problems", "{count} problems", {"count": len(found), "problems": found}
        )


def validate(
    model: type[Model],
    source: Source,
    specimen: Mapping[str, Any] | None = None,
    further: Callable[[Model], Iterable[Problem]] = lambda _: (),
) -> Model:
    """`source.data` as `model`. Raises InputError with every fault, the `further` ones included.

    Checks of several keys together only run if each key is valid by itself. Therefore each rejected
    value is replaced by that of a valid `specimen` (or removed), and the rest is validated again: a
    misspelt key does not hide two rates that do not divide.
    """
    data = source.data
    problems: list[Problem] = []
    while True:
        new: list[Problem] = []
        try:
            result = model.model_validate(data, context={"folder": source.folder})
            found = further(result)
        except ValidationError as error:
            result, found = None, _problems(model, data, error)
        new = [item for item in found if not _overlaps(item[0], problems)]
        if result is not None and not problems + new:
            return result
        problems += new
        if not new:
            said = [source.fault(*item) for item in problems if not _is_misspelt(item, problems)]
            raise InputError(
                sorted(said, key=lambda f: (f.line is None, f.line or 0, f.column or 0))
            )
        data = copy.deepcopy(data)
        for path, _ in new:
            known = not path or path[-1] != "kind" or _holds(specimen or {}, path)
            _repair(data, path if known else path[:-1], specimen or {})


def _overlaps(path: KeyPath, problems: list[Problem]) -> bool:
    """Whether `path` equals, or is above or below, one that was rejected already."""
    return any(path[: len(other)] == other or other[: len(path)] == path for other, _ in problems)


def _is_misspelt(missing: Problem, problems: list[Problem]) -> bool:
    """Whether a missing key is there under a misspelt name, which alone is then reported."""
    path, message = missing
    hint = f"unknown key (did you mean {str(path[-1])!r}?)" if path else ""
    return message.startswith("is missing") and any(
        other[:-1] == path[:-1] and text.startswith(hint) for other, text in problems
    )


def _holds(data: Any, path: KeyPath) -> bool:
    for part in path:
        item = isinstance(data, list) and isinstance(part, int) and part < len(data)
        if not item and not (isinstance(data, dict) and part in data):
            return False
        data = data[part]  # type: ignore[index, call-overload]
    return bool(path)


def _repair(data: Any, path: KeyPath, specimen: Any) -> None:
    """Sets `path` to the specimen's value or removes it; for a list, whose length counts, all."""
    for depth, part in enumerate(path):
        specimen = specimen[part] if _holds(specimen, (part,)) else None
        if not isinstance(data, dict):
            return
        if depth == len(path) - 1 or isinstance(data.get(part), list):
            data.pop(part, None)
            if specimen is not None:
                data[part] = copy.deepcopy(specimen)
            return
        data = data.get(part)


def _problems(model: type[BaseModel], data: Any, error: ValidationError) -> Iterator[Problem]:
    for detail in error.errors(include_url=False):
        if detail["type"] == "default_factory_not_called":
            continue
        if detail["type"] == "too_short" and len(detail["input"]) != detail["ctx"]["actual_length"]:  # type: ignore[typeddict-item]
            continue  # pydantic counts only the valid items; the invalid ones have their own faults
        path = _path(data, detail["loc"])
        if detail["type"] == "problems":
            yield from (((*path, *below), message) for below, message in detail["ctx"]["problems"])  # type: ignore[typeddict-item]
        elif detail["type"] == "union_tag_invalid":
            yield (*path, "kind"), _message(detail)
        elif detail["type"] == "extra_forbidden":
            owner = _model_at(model, data, path[:-1])
            allowed = list(_fields(owner)) if owner is not None else []
            hint = nearest(str(path[-1]), allowed)
            yield path, f"unknown key{hint}; allowed: {', '.join(allowed) or 'none'}"
        else:
            yield path, _message(detail)


def _path(data: Any, location: tuple[int | str, ...]) -> KeyPath:
    """pydantic's location without the union tags that it contains besides the keys."""
    path: list[int | str] = []
    for index, part in enumerate(location):
        if isinstance(data, dict) and part in data:
            path.append(part)
            data = data[part]
        elif isinstance(data, (list, tuple)) and isinstance(part, int):
            path.append(part)
            data = data[part] if part < len(data) else None
        elif index == len(location) - 1 and not (
            isinstance(data, dict) and data.get("kind") == part
        ):
            path.append(part)
    return tuple(path)


def nearest(name: str, allowed: Iterable[str]) -> str:
    """A hint ` (did you mean 'x'?)`, or nothing if no name is similar."""
    close = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.5)
    return f" (did you mean {close[0]!r}?)" if close else ""


def _model_at(model: type[BaseModel], data: Any, path: KeyPath) -> type[BaseModel] | None:
    """The model at `path`; among the members of a union, the one with the `kind` in the data."""
    annotation: Any = model
    for part in path:
        found = _pick(annotation, data)
        inside = _annotation(found, str(part)) if found is not None else None
        annotation = inside if inside is not None else _items(annotation)
        data = data[part] if _holds(data, (part,)) else None
        if annotation is None:
            return None
    return _pick(annotation, data)


def _fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a model by their keys in a file."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _items(annotation: Any) -> Any:
    """The annotation of the items of a list or a mapping; None for anything else."""
    origin, members = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _items(members[0])
    if origin in (Union, types.UnionType):
        return next((found for found in map(_items, members) if found is not None), None)
    if origin in (list, tuple, dict) and members:
        return members[-1] if origin is dict else members[0]
    return None


def description_of(model: type[BaseModel], data: Any, path: KeyPath) -> str:
    """Description of the key at ``path``, by the `kind` in the data in a union; or empty."""
    owner = _model_at(model, data, path[:-1])
    field = _fields(owner).get(str(path[-1])) if owner is not None else None
    return (field.description or "") if field is not None else ""


def _annotation(model: type[BaseModel], key: str) -> Any:
    """The annotation of a field with its metadata; None if there is no such field."""
    field = _fields(model).get(key)
    if field is None:
        return None
    table = next((m for m in field.metadata if isinstance(m, OneOf)), None)
    return field.annotation if table is None else Annotated[field.annotation, table]  # type: ignore[valid-type]


def _pick(annotation: Any, data: Any) -> type[BaseModel] | None:
    """The model of an annotation; among several, the one with the `kind` in the data."""
    origin, members = get_origin(annotation), get_args(annotation)
    marks = members[1:] if origin is Annotated else ()
    table = next((m for m in marks if isinstance(m, OneOf)), None)
    if table is not None:
        kind, registry = table.pick(data), table.registry
        return registry[kind] if kind is not None and kind in registry else registry.base
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if origin not in (Union, types.UnionType, Annotated):
        return None
    models = [found for found in (_pick(member, data) for member in members) if found is not None]
    kind = data.get("kind") if isinstance(data, dict) else None
    kinds = [get_args(m.model_fields["kind"].annotation) if "kind" in m.model_fields else ()
             for m in models]  # fmt: skip
    named = [m for m, own in zip(models, kinds, strict=True) if kind in own]
    return (named or models or [None])[0]


_KINDS = {
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "a mapping (key: value)"),
    **dict.fromkeys(("int_type", "int_from_float"), "a whole number"),
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    "float_type": "a number",
    "string_type": "text",
    "bool_type": "true or false",
    "finite_number": "a finite number",
}
_BOUNDS = {
    "greater_than": (">", "gt"),
    "greater_than_equal": (">=", "ge"),
    "less_than": ("<", "lt"),
    "less_than_equal": ("<=", "le"),
}


def _message(detail: ErrorDetails) -> str:
    """pydantic's error as `what is wrong (got ...); what is allowed`."""
    kind, got, context = detail["type"], describe(detail["input"]), detail.get("ctx", {})
    if kind == "missing":
        return "is missing; this key must be given"
    if kind in _KINDS:
        return f"has the wrong type (got {got}); allowed is {_KINDS[kind]}"
    if kind in _BOUNDS:
        sign, name = _BOUNDS[kind]
        return f"is out of range (got {got}); allowed is {sign} {context[name]:g}"
    if kind == "literal_error":
        choices = context["expected"].replace("'", "").replace(" or ", ", ").split(", ")
        hint = nearest(str(detail["input"]), choices)
        return f"unknown value{hint} (got {got}); allowed: {', '.join(choices)}"
    if kind == "union_tag_invalid":
        choices = sorted(context["expected_tags"].replace("'", "").split(", "))
        allowed = f"allowed: {', '.join(choices)}; one of your own needs --plugin"
        hint = nearest(str(context["tag"]), choices)
        return f"unknown kind{hint} (got {context['tag']!r}); {allowed}"
    if kind == "union_tag_not_found":
        return f"has no kind (got {got}); give it as {{kind: ...}}"
    if kind in ("too_short", "too_long"):
        low, high = context.get("min_length"), context.get("max_length")
        limit = f"at least {low}" if kind == "too_short" else f"at most {high}"
        return f"has the wrong length (got {context['actual_length']} items); allowed is {limit}"
    if kind == "string_too_short":
        return "is empty; some text is expected"
    return f"{detail['msg'][:1].lower()}{detail['msg'][1:]} (got {got})"
