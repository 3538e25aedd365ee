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
from operator import is_
from typing import Any

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
    """A kernel with arrays of its caller, nearly always the same; else it is bound again."""

    __slots__ = ("_bound", "_given", "_kernel", "_last")

    def __init__(self, kernel: Any, *given: Any) -> None:
        """``given``: as for :func:`bound`, with :data:`GIVEN` for each array of :meth:`on`."""
        self._kernel, self._given = kernel, given
        self._last: tuple[Any, ...] = (self,)  # not an array, so that the first call binds
        self._bound: Any = None

    def on(self, *arrays: Any) -> Callable[..., Any]:
        """The kernel bound to these arrays of its caller; it is called with the numbers that
        change.
        """
        if not all(map(is_, arrays, self._last)):
            self._last = arrays
            self._bound = bound(self._kernel, *_filled(self._given, iter(arrays)))
        return self._bound


def _filled(given: tuple[Any, ...], rest: Iterator[Any]) -> tuple[Any, ...]:
    """``given``, and plain tuples in it, with the next of ``rest`` for each :data:`GIVEN`."""
    return tuple(
        next(rest) if v is GIVEN else _filled(v, rest) if type(v) is tuple else v for v in given
    )
