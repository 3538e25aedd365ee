"""Tables of addresses, shapes and strides, and kernels compiled to read their arguments there."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numba import typeof, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from hiltestbed.compiled.jit import njit

WORD = np.dtype(np.int64).itemsize  # [bytes] of an entry of the table

# by kernel and types of its arguments: one entry per combination of types, not per block
_calls: dict[tuple[Any, ...], Any] = {}


def tabled(kernel: Any, given: tuple[Any, ...]) -> tuple[Any, Any, list[Any]]:
    """A compiled call of ``kernel`` with the address of a table, the table, and its arrays."""
    words: list[int] = []
    arrays: list[Any] = []
    kinds = [_entered(value, words, arrays) for value in given]
    key = (kernel, *kinds)
    if key not in _calls:
        _calls[key] = _compiled(kernel, kinds)
    return _calls[key], np.array(words, dtype=np.int64), arrays


def _entered(value: Any, words: list[int], arrays: list[Any]) -> tuple[Any, ...] | None:
    """Append a value to ``words`` and ``arrays``; a number is an array without dimensions. Returns
    the index of its first word, its type and whether it is a number; of a tuple or list its
    class and its parts; None if each call passes it.
    """
    if value is ...:
        return None
    if value is None:
        return (type(None),)
    if isinstance(value, (tuple, list)):
        parts = [_entered(part, words, arrays) for part in value]
        if isinstance(value, list):  # of one type, so that a kernel can count through them
            parts = [(part[0], part[1].copy(layout="A"), False) for part in parts if part]
        return type(value), *parts
    at, array = len(words), np.asarray(value)
    arrays.append(array)
    words += [array.ctypes.data, *array.shape, *array.strides]
    return at, _type_of(array), array is not value


def _type_of(array: Any) -> Any:
    """Numba's type; an axis of one entry, for which NumPy takes any stride, does not change it."""
    kind: Any = typeof(array)
    if kind.layout == "C" and array.size:
        expected = array.itemsize
        for length, stride in zip(reversed(array.shape), reversed(array.strides), strict=True):
            if stride != expected:
                return kind.copy(layout="A")
            expected *= length
    return kind


def _compiled(kernel: Any, kinds: list[Any]) -> Any:
    """A function of a table's address and a call's arguments, cached on disk beside its kernel."""
    function = kernel.py_func
    brought = [f"given_{i}" for i, kind in enumerate(kinds) if kind is None]
    space: dict[str, Any] = {
        "kernel": kernel,
        "array": _array,
        "__name__": function.__module__,
    }
    named: dict[str, Any] = {}  # types and classes of the arguments

    def read(i: int, kind: tuple[Any, ...] | None) -> str:
        """The expression for an argument, or for a part of it."""
        if kind is None:
            return f"given_{i}"
        if kind[0] is type(None):
            return "None"
        name = f"kind_{len(named)}"
        if isinstance(kind[0], type):
            named[name] = kind[0]
            parts = "".join(f"{read(i, part)}, " for part in kind[1:])
            return f"({parts})" if kind[0] in (tuple, list) else f"{name}({parts})"
        named[name] = kind[1]
        return f"array(table, {kind[0]}, {name}){'[()]' if kind[2] else ''}"

    passed = [read(i, kind) for i, kind in enumerate(kinds)]
    space |= named
    # Numba names its cache entries by file, function and line; the time stamp of the file decides
    # whether they are valid.
    mark = hashlib.sha256(repr([passed, *map(str, named.values())]).encode()).hexdigest()[:16]
    name = f"{function.__name__}_bound_{mark}"
    text = (
        f"def {name}({', '.join(['table', *brought])}):\n    return kernel({', '.join(passed)})\n"
    )
    exec(compile(text, function.__code__.co_filename, "exec"), space)
    return njit(cache=True)(space[name]).dispatcher


@intrinsic
def _array(typingctx, table, at, kind):
    """The array whose address, shape and strides begin at an index of the table."""
    found = kind.instance_type

    def make(context, builder, signature, args):
        ary = make_array(found)(context, builder)
        word = context.get_value_type(types.intp)
        places = (builder.add(args[1], args[1].type(i)) for i in range(1 + 2 * found.ndim))
        offsets = (builder.mul(place, place.type(WORD)) for place in places)
        entries = (builder.add(args[0], offset) for offset in offsets)
        first = [builder.load(builder.inttoptr(entry, word.as_pointer())) for entry in entries]
        pointer = context.get_data_type(found.dtype).as_pointer()
        populate_array(
            ary,
            data=builder.inttoptr(first[0], pointer),
            shape=cgutils.pack_array(builder, first[1 : 1 + found.ndim]) if found.ndim else (),
            strides=cgutils.pack_array(builder, first[1 + found.ndim :]) if found.ndim else (),
            itemsize=context.get_constant(
                types.intp, found.dtype.bitwidth // 8 if found.dtype != types.boolean else 1
            ),
            meminfo=None,
        )
        return ary._getvalue()

    return found(types.int64, types.int64, kind), make
