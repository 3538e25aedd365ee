"""Registries of built-in and user-defined components.

Effects, compensation methods, identifiers, mechanisms and platforms are classes with a literal
``kind``. The built-in ones are found in the modules of their packages. A user's module is loaded by
``--plugin MODULE`` (a module name or a .py file), by :func:`load`, or through the entry-point group
``hiltestbed.plugins``, and registers its classes with :func:`register`::

    from hiltestbed.effects import Effect, quantity
    from hiltestbed.plugins import register

    @register
    class SoftStart(Effect): ...
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, Generic, TypeVar, get_args

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from hiltestbed.errors import HiltestbedError, InputError

T = TypeVar("T")
GROUP = "hiltestbed.plugins"
ENVIRONMENT = "HILTESTBED_PLUGINS"  # modules that every process loads, separated as in PATH


class Registry(Mapping[str, type[T]], Generic[T]):
    """Classes of one sort of component, by their ``kind`` in a scenario.

    Attributes:
        what: name of the sort, for messages. base: the common base class.
    """

    def __init__(self, what: str, base: type[T], homes: Sequence[str]) -> None:
        """``homes``: modules or packages of built-in classes, imported at first use."""
        self.what, self.base = what, base
        self._homes = homes
        self._found: dict[str, type[T]] = {}
        self._loading = self._whole = False
        _REGISTRIES.append(self)

    def add(self, cls: type[T]) -> type[T]:
        """Add a class. Raises InputError if a part is missing or the kind is in use."""
        kind = kind_of(cls)
        where = _place(cls)
        if kind is None:
            raise InputError(
                f"plugin class {where}: lacks `kind`; give it as kind: Literal['name'] = 'name'"
            )
        ways = [part.split("|") for part in getattr(cls, "PARTS", ())]
        lacking = [" or ".join(way) for way in ways if not any(_has(cls, part) for part in way)]
        if lacking:
            raise InputError(
                f"plugin class {where}: the {self.what} {kind!r} lacks {', '.join(lacking)}; "
                f"the documentation (Plugins) and {self.base.__module__}.{self.base.__name__} "
                f"explain each part"
            )
        for part, allowed in getattr(cls, "CHOICES", {}).items():
            given = getattr(cls, part)
            if not isinstance(given, frozenset | set) or given - allowed:
                raise InputError(
                    f"plugin class {where}: `{part}` of the {self.what} {kind!r} is {given!r}; "
                    f"allowed is a set of any of "
                    f"{', '.join(map(repr, sorted(allowed)))}"
                )
        known = self._found.get(kind)
        if known is not None and (known.__module__, known.__qualname__) != (
            cls.__module__,
            cls.__qualname__,
        ):
            raise InputError(
                f"plugin class {where}: the {self.what} {kind!r} exists already "
                f"({known.__module__}); choose another kind"
            )
        self._found[kind] = cls
        return cls

    def _load(self) -> None:
        """Import the built-in classes. Raises ImportError at each access until it can."""
        # the modules imported here read the table while it is being filled
        if self._whole or self._loading:
            return
        self._loading = True
        try:
            for home in self._homes:
                module = import_module(home)
                for info in iter_modules(getattr(module, "__path__", ())):
                    import_module(f"{home}.{info.name}")
            self._whole = True
        finally:
            self._loading = False

    def __getitem__(self, kind: str) -> type[T]:
        self._load()
        return self._found[kind]

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(self._found)

    def __len__(self) -> int:
        self._load()
        return len(self._found)


_REGISTRIES: list[Registry[Any]] = []
_DEPENDENTS: list[Callable[[], None]] = []
_LOADED: dict[str, str] = {}
_POINTS_READ: list[bool] = []


def kind_of(cls: type) -> str | None:
    """The literal ``kind`` of a class, or None."""
    fields = getattr(cls, "model_fields", {})
    names = get_args(fields["kind"].annotation) if "kind" in fields else ()
    return names[0] if len(names) == 1 and isinstance(names[0], str) else None


def _place(cls: type) -> str:
    """The file that defines a class, or its module if there is no file."""
    return (
        f"{getattr(sys.modules.get(cls.__module__), '__file__', None) or cls.__module__}: "
        f"{cls.__qualname__}"
    )


def _has(cls: type, part: str) -> bool:
    """Whether a class defines a part itself: a docstring, or not the base's placeholder."""
    if part == "docstring":
        return bool((cls.__dict__.get("__doc__") or "").strip())
    value = inspect.getattr_static(cls, part, None)
    return (
        value is not None
        and not getattr(getattr(value, "__func__", value), "placeholder", False)
        and value not in ("", {})
    )


def placeholder(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a method of a base class that each class must define itself."""
    function.placeholder = True  # type: ignore[attr-defined]
    return function


def register(cls: type[T]) -> type[T]:
    """Class decorator: add a class to its base's registry. Raises InputError if it lacks a part."""
    for registry in _REGISTRIES:
        if issubclass(cls, registry.base):
            registry.add(cls)
            if is_users(cls):
                for refresh in _DEPENDENTS:
                    refresh()
            return cls
    bases = ", ".join(f"{r.base.__module__}.{r.base.__name__}" for r in _REGISTRIES)
    raise InputError(
        f"plugin class {_place(cls)}: derives from nothing that can be added; allowed are {bases}"
    )


def all_of(cls: type[T], sections: Sequence[Any]) -> list[T]:
    """``sections``, all of class ``cls``. Raises TypeError for another."""
    other = next((s for s in sections if not isinstance(s, cls)), None)
    if other is not None:
        raise TypeError(f"settings of {cls.__name__} expected (got {type(other).__name__})")
    return list(sections)


def depends(refresh: Callable[[], None]) -> Callable[[], None]:
    """Call ``refresh`` after each addition: for models whose schema lists a registry."""
    _DEPENDENTS.append(refresh)
    return refresh


def load(modules: Sequence[str] = ()) -> None:
    """Import the user's modules, by name or as .py files, and those of installed packages (entry
    points). Raises InputError.

    Child processes load the same modules, through the environment variable ``HILTESTBED_PLUGINS``.
    """
    asked = [
        *os.environ.get(ENVIRONMENT, "").split(os.pathsep),
        # a .py file with its absolute path: found from any folder, and loaded only once
        *(str(Path(name).resolve()) if name.endswith(".py") else name for name in modules),
    ]
    wanted = [name for name in dict.fromkeys(asked) if name and name not in _LOADED]
    points = [] if _POINTS_READ else sorted(entry_points(group=GROUP), key=lambda p: p.name)
    if points or wanted:
        import_module("hiltestbed.scenario")  # defines the registries to which a module may add
    for point in points:
        _LOADED[point.name] = _import(
            point.value.partition(":")[0], f"entry point {point.name!r} of the group {GROUP}"
        )
    _POINTS_READ.append(True)
    for name in wanted:
        _LOADED[name] = _import(name, f"--plugin {name}")
        os.environ[ENVIRONMENT] = os.pathsep.join(
            [*filter(None, os.environ.get(ENVIRONMENT, "").split(os.pathsep)), name]
        )


load_plugins = load  # its public name in the package


def is_users(cls: type) -> bool:
    """Whether a class comes from a user's module, not from hiltestbed itself."""
    return cls.__module__ in _LOADED.values() or not cls.__module__.startswith("hiltestbed.")


@contextmanager
def calling(cls: type, where: str) -> Iterator[None]:
    """What a user's ``cls`` raises becomes an InputError with its file, line and ``where``."""
    try:
        yield
    except HiltestbedError:
        raise
    except Exception as error:
        if not is_users(cls):
            raise
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise InputError(
            f"{where}: {last.filename}:{last.lineno}: {type(error).__name__}: {error}"
        ) from error


def _import(name: str, where: str) -> str:
    """Import a module by name or file; returns its name."""
    path = Path(name)
    if path.suffix == ".py":
        if not path.is_file():
            raise InputError(
                f"{where}: no such file; give a module that can be imported, or the path of a .py "
                f"file"
            )
        mark = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]
        module_name = f"hiltestbed_plugin_{path.stem}_{mark}"
        spec = importlib.util.spec_from_file_location(module_name, path)
        if spec is None or spec.loader is None:
            raise InputError(f"{where}: cannot be read as a Python module")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        run = lambda: spec.loader.exec_module(module)  # type: ignore[union-attr]  # noqa: E731
    else:
        module_name = name
        run = lambda: import_module(name)  # noqa: E731
    try:
        run()
    except InputError:
        sys.modules.pop(module_name, None)
        raise
    except ModuleNotFoundError as error:
        sys.modules.pop(module_name, None)
        own = error.name is not None and f"{module_name}.".startswith(f"{error.name}.")
        do = "give a module that can be imported, or the path of a .py file"
        raise InputError(
            f"{where}: {error}; {do if own else 'install what the module imports'}"
        ) from error
    except (Exception, SystemExit) as error:  # whatever the code of a user does
        sys.modules.pop(module_name, None)
        raise InputError(f"{where}: failed to load: {type(error).__name__}: {error}") from error
    return module_name


def loaded() -> dict[str, str]:
    """The user's modules, as the user names them, with the SHA-256 of their source."""
    out = {}
    for asked, name in _LOADED.items():
        file = getattr(sys.modules.get(name), "__file__", None)
        out[asked] = hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""
    return out


class OneOf:
    """Annotation of a field that takes any class of a registry, selected by ``kind``:
    ``Annotated[Base, OneOf(TABLE)]``.

    The schema lists the classes in the registry when the model is built; after a plugin was loaded,
    models are built again.
    """

    def __init__(self, registry: Registry[Any], default: str | None = None) -> None:
        """``default``: the kind of data without a kind."""
        self.registry, self.default = registry, default

    def pick(self, data: Any) -> str | None:
        """The kind of data from a file, or of an object of one of the classes."""
        kind = (
            data.get("kind", self.default)
            if isinstance(data, dict)
            else getattr(data, "kind", None)
        )
        return kind if isinstance(kind, str) else repr(kind) if kind is not None else None

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        choices = {kind: handler.generate_schema(cls) for kind, cls in self.registry.items()}
        return core_schema.tagged_union_schema(choices, discriminator=self.pick)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """The union as JSON Schema: ``kind`` tells its members, described each."""
        found = handler(schema)
        for member in found["oneOf"]:
            own = handler.resolve_ref_schema(member)
            kind = own["properties"]["kind"]
            summary = own.get("description", "").partition("\n\n")[0]
            kind["description"] = " ".join(summary.split())
            if kind["const"] != self.default and "kind" not in own.get("required", ()):
                own["required"] = ["kind", *own.get("required", ())]
        found["discriminator"] = {"propertyName": "kind"}
        return found
