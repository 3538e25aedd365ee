"""Compiled kernels whose arrays are bound once.

At each call of a compiled kernel, Numba determines type, address, shape and strides of every array
argument. For a kernel with twenty arrays of one run, this takes longer than the computation. The
blocks of the loop work on buffers at fixed addresses, so this can be done
in advance: :func:`bound` writes addresses, shapes and strides into a table, and compiles a call
that reads them there and takes only the address of the table and the arguments that change from
call to call. The kernel itself is the same, and so are its results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

REMEMBERED = 4  # sets of a caller's arrays that stay bound
GIVEN = object()  # placeholder for an array that the caller of a block passes


class Bound(partial):
    """A kernel with its arrays; ``kept`` references them and their table for as long as the kernel
    can be called. The other attribute keeps ``partial`` from flattening a nested one, which would
    lose the references.
    """

    __slots__ = ("kept",)
    kept: tuple[Any, ...]
    whole: bool

    def __new__(cls, call: Any, table: Any, *kept: Any) -> Bound:
        self = super().__new__(cls, call, int(table.ctypes.data))
        self.kept, self.whole = (table, *kept), True
        return self


def bound(kernel: Any, *given: Any) -> Callable[..., Any]:
    """``kernel`` with its arguments ``given`` in order: arrays, numbers, tuples of these (named or
    not), lists of arrays of one dtype and dimension, None for what a kernel is compiled without,
    and ``...`` for the numbers that each call passes.

    Arrays must keep their memory: they may be written, but not replaced. Numbers are bound with
    their current values.
    """
    from hiltestbed.compiled.table import tabled

    call, table, arrays = tabled(kernel, given)
    return Bound(call, table, given, arrays)


class Call:
    """A kernel with some arrays of the caller, which are the same at almost every call; it is bound
    again if one of them changes.
    """

    __slots__ = ("_a", "_b", "_bound", "_c", "_d", "_e", "_f", "_g", "_given", "_kernel", "_known")

    def __init__(self, kernel: Any, *given: Any) -> None:
        """``given``: as for :func:`bound`, with :data:`GIVEN` for each array that is passed to
        :meth:`on`: at most seven.
        """
        self._kernel, self._given = kernel, given
        self._a: Any = self  # not an array, so that the first call binds
        self._b = self._c = self._d = self._e = self._f = self._g = None
        self._bound: Any = None
        self._known: dict[tuple[int, ...], tuple[tuple[Any, ...], Any]] = {}

    def on(
        self,
        a: Any = None,
        b: Any = None,
        c: Any = None,
        d: Any = None,
        e: Any = None,
        f: Any = None,
        g: Any = None,
    ) -> Callable[..., Any]:
        """The kernel bound to the caller's arrays, in the order of its arguments; it is called with
        the numbers that change.
        """
        # written out: a loop over the arguments takes several times as long, at every tick
        if (
            a is self._a
            and b is self._b
            and c is self._c
            and d is self._d
            and e is self._e
            and f is self._f
            and g is self._g
        ):
            return self._bound
        self._a, self._b, self._c, self._d, self._e, self._f, self._g = arrays = a, b, c, d, e, f, g
        # the arrays are referenced, so that their ids cannot be reused
        key = tuple(map(id, arrays))
        if key not in self._known:
            if len(self._known) >= REMEMBERED:
                self._known.clear()
            given = _filled(self._given, iter(arrays))
            self._known[key] = arrays, bound(self._kernel, *given)
        self._bound = self._known[key][1]
        return self._bound


def _filled(given: tuple[Any, ...], rest: Iterator[Any]) -> tuple[Any, ...]:
    """``given``, and plain tuples in it, with the next of ``rest`` for each :data:`GIVEN`."""
    return tuple(
        next(rest) if v is GIVEN else _filled(v, rest) if type(v) is tuple else v for v in given
    )
