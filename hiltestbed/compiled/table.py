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


def tabled(kernel: Any, given: tuple[Any, ...]) -> tuple[Any, Any]:
    """A compiled call of ``kernel`` that takes the address of a table, and the table of ``given``:
    as for :func:`hiltestbed.compiled.bound.bound`.
    """
    words: list[int] = []
    kinds = [_entered(value, words) for value in given]
    table = np.array(words, dtype=np.int64)
    key = (kernel, *kinds)
    if key not in _calls:
        _calls[key] = _compiled(kernel, kinds)
    return _calls[key], table


def _entered(value: Any, words: list[int]) -> tuple[Any, ...] | None:
    """Append a value to the ``words`` of a table. Returns the index of its first word and its type;
    of a tuple or a list its class and the same of each of its parts; None if each call passes it.
    """
    if value is ...:
        return None
    if value is None:
        return (type(None),)
    if isinstance(value, (tuple, list)):
        parts = [_entered(part, words) for part in value]
        if isinstance(value, list):  # of one type, so that a kernel can count through them
            parts = [(part[0], part[1].copy(layout="A")) for part in parts if part]
        return type(value), *parts
    at = len(words)
    if isinstance(value, np.ndarray):
        words += [value.ctypes.data, *value.shape, *value.strides]
        return at, _type_of(value)
    if isinstance(value, (float, np.floating)):
        words.append(int(np.float64(value).view(np.int64)))
        return at, types.float64
    words.append(int(value))
    return at, types.boolean if isinstance(value, (bool, np.bool_)) else types.int64


def _type_of(array: Any) -> Any:
    """Numba's type, the same for one run as for several: NumPy takes a strided array for contiguous
    if its leading axis has a single entry.
    """
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
        "number": _number,
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
        how = "array" if isinstance(kind[1], types.Array) else "number"
        return f"{how}(table, {kind[0]}, {name})"

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


def _entry(builder: Any, table: Any, at: Any, kind: Any) -> Any:
    """The word at ``at`` of the table, as ``kind``."""
    place = builder.add(table, builder.mul(at, at.type(WORD)))
    return builder.load(builder.inttoptr(place, kind.as_pointer()))


@intrinsic
def _number(typingctx, table, at, kind):
    """The number at an index of the table."""
    found = kind.instance_type if hasattr(kind, "instance_type") else kind.dtype

    def make(context, builder, signature, args):
        if found == types.boolean:
            word = _entry(builder, args[0], args[1], context.get_value_type(types.int64))
            return builder.icmp_signed("!=", word, word.type(0))
        return _entry(builder, args[0], args[1], context.get_value_type(found))

    return found(types.int64, types.int64, kind), make


@intrinsic
def _array(typingctx, table, at, kind):
    """The array whose address, shape and strides begin at an index of the table."""
    found = kind.instance_type

    def make(context, builder, signature, args):
        ary = make_array(found)(context, builder)
        word = context.get_value_type(types.intp)
        first = [
            _entry(builder, args[0], builder.add(args[1], args[1].type(i)), word)
            for i in range(1 + 2 * found.ndim)
        ]
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
