"""Numba's dispatchers of kernels, with cached code that is compiled again whenever anything that it
depends on has changed.

Numba keeps a compiled kernel as long as the file of its function is unchanged. The functions that
it calls and the constants that it reads are compiled into it: if they are in another file, an
updated program would continue with the old ones. Here a kernel is marked by its own code, all
kernels that it calls, and the values of all constants that any of them reads.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.types import Dispatcher, NamedTuple, NamedUniTuple, Type
from numba.extending import typeof_impl

from hiltestbed.compiled.inner import inlined

_njit: Any = numba.njit
_marks: dict[FunctionType, str] = {}


def dispatcher_of(kernel: Any) -> Any:
    """``numba.njit`` of a kernel's function; cached code is marked by all that it depends on."""
    _register(type(kernel))
    function, options = kernel.py_func, kernel.options
    dispatcher: Any = _njit(**options)(function)
    inner = inlined(dispatcher)
    if not options.get("cache"):
        return dispatcher
    inner.enable_caching()
    try:
        caches = [compiled._cache for compiled in (dispatcher, inner)]
        kept = [cached._cache_file for cached in caches]
        [file._source_stamp for file in kept]
        for cached in caches:
            cached._index_key = _by_fields(cached._index_key)
    # a Numba with another cache: compiling at each start is slow, but never out of date
    except AttributeError:
        dispatcher = _njit(**options | {"cache": False})(function)
        inlined(dispatcher)
        return dispatcher
    for file in kept:
        file._source_stamp = Mark(function)
        file._load_index = _readable(file._load_index)
    return dispatcher


@cache
def _register(kind: type) -> None:
    """Let kernels name objects of this class and call their functions."""
    typeof_impl.register(kind)(lambda kernel, context: Dispatcher(kernel.dispatcher))


def _by_fields(index_key: Callable[..., tuple]) -> Callable[..., tuple]:
    """Also by the order of the fields of named tuples: Numba compares classes and types only."""

    def key(signature: Any, codegen: Any) -> tuple:
        return (*index_key(signature, codegen), _fields(getattr(signature, "args", signature)))

    return key


def _fields(kinds: Iterable[Any]) -> tuple:
    return tuple(
        (kind.fields, _fields(kind.types))
        for kind in kinds
        if isinstance(kind, (NamedTuple, NamedUniTuple))
    )


def _readable(load_index: Callable[[], dict]) -> Callable[[], dict]:
    """Without a class that an index names, renamed or moved by an update, no kernel is cached."""

    def load() -> dict:
        try:
            return load_index()
        except (AttributeError, ImportError):
            return {}

    return load


class Mark:
    """The mark of a cached kernel, computed at first use, when all that it names is defined."""

    __slots__ = ("_function",)

    def __init__(self, function: FunctionType) -> None:
        self._function = function

    def __eq__(self, other: object) -> bool:
        return str(other) == str(self)

    def __hash__(self) -> int:
        return hash(str(self))

    def __str__(self) -> str:
        if self._function not in _marks:
            reached: dict[FunctionType, str] = {}
            _reach(self._function, reached)
            text = "\n".join(sorted(reached.values()))
            _marks[self._function] = hashlib.sha256(text.encode()).hexdigest()
        return _marks[self._function]

    def __reduce__(self) -> tuple[type[str], tuple[str]]:
        return str, (str(self),)


def _reach(function: FunctionType, reached: dict[FunctionType, str]) -> None:
    """Add a function's description to ``reached``, and those of all that it calls."""
    if function in reached:
        return
    reached[function] = ""
    codes = [function.__code__]
    parts: list[str] = [f"{function.__module__}.{function.__qualname__}"]
    called: list[FunctionType] = []
    cells = (c.cell_contents for c in function.__closure__ or ())
    space = function.__globals__ | dict(zip(function.__code__.co_freevars, cells, strict=True))
    while codes:
        code = codes.pop()
        parts += [code.co_code.hex(), repr(code.co_names), repr(code.co_varnames)]
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        parts += [
            _description(constant, called)
            for constant in code.co_consts
            if not isinstance(constant, CodeType)
        ]
        for name in (*code.co_names, *code.co_freevars):
            value = space.get(name)
            parts.append(f"{name} {_description(value, called)}")
            if isinstance(value, ModuleType):
                parts += [
                    f"{name}.{part} {_description(getattr(value, part, None), called)}"
                    for part in code.co_names
                ]
    parts.append(_description(function.__defaults__, called))
    reached[function] = "\n".join(parts)
    for other in called:
        _reach(other, reached)


def _description(value: Any, called: list[FunctionType]) -> str:
    """The same in every process; functions that are compiled with the value go to ``called``."""
    # the latter of an intrinsic
    compiled = getattr(value, "py_func", getattr(value, "_defn", None))
    if isinstance(compiled, FunctionType):
        called.append(compiled)
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, (tuple, list)):
        return (
            f"{type(value).__qualname__}({', '.join(_description(part, called) for part in value)})"
        )
    if isinstance(value, frozenset):
        return f"frozenset({', '.join(sorted(_description(part, called) for part in value))})"
    if isinstance(value, type) and issubclass(value, tuple):
        return f"{value.__qualname__}{getattr(value, '_fields', ())}"
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes, np.generic)):
        return repr(value)
    return (
        str(value)
        if isinstance(value, Type)
        else f"{type(value).__module__}.{type(value).__qualname__}"
    )
