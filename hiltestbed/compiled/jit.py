"""Kernels: functions that Numba compiles when they are first called.

A module that defines kernels is imported without Numba, so that what only reads settings does not
wait for it. :mod:`hiltestbed.compiled.dispatch` compiles them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from operator import attrgetter
from types import FunctionType
from typing import Any

import numpy as np

# a call of the kernels that are seldom called takes 2 ms, compiling them 5 s: less than half of it
INTERPRETED_CALLS = 1000


_awaiting: list[Callable[[], Any]] = []


class Kernel:
    """A function to be compiled; kernels may call it, too.

    Attributes:
        py_func: the function itself. options: as of ``numba.njit``.
    """

    def __init__(self, function: FunctionType, options: dict[str, Any]) -> None:
        self.py_func, self.options = function, options
        self.__doc__ = function.__doc__

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of the function."""
        from hiltestbed.compiled.dispatch import dispatcher_of

        while _awaiting:
            _awaiting.pop()()
        return dispatcher_of(self)

    # a call goes to the dispatcher without a frame of its own: some kernels take less than one
    __call__ = property(attrgetter("dispatcher"))


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """As ``numba.njit``, at the first call, and again if what it depends on has changed."""
    return lambda function: Kernel(function, options)


def before_the_first_kernel(prepare: Callable[[], Any]) -> None:
    """Call ``prepare`` once Numba is needed, which takes a tenth of a second to import."""
    _awaiting.append(prepare)


@cache
def interpreted(kernel: Any) -> FunctionType:
    """A kernel, or a function, as plain Python, with the kernels that it calls: for a few calls
    before a run, which take less time than compiling. The results are the same to the last bit.
    """
    function = getattr(kernel, "py_func", kernel)
    space = dict(function.__globals__)
    for name in function.__code__.co_names:
        if isinstance(space.get(name), Kernel):
            space[name] = interpreted(space[name])
    return FunctionType(
        function.__code__, space, function.__name__, function.__defaults__, function.__closure__
    )


class Seldom:
    """A kernel that is :func:`interpreted` for a program's first calls, and then compiled."""

    def __init__(self, kernel: Any) -> None:
        self._kernel, self._left = kernel, INTERPRETED_CALLS

    def __call__(self, *args: Any) -> Any:
        if not self._left:
            return self._kernel(*args)
        self._left -= 1
        return interpreted(self._kernel)(*args)


@njit(cache=True)
def copied(values, out):
    """Copy an array to another of its shape, in a kernel.

    For ``out[:] = values``, Numba compiles the message about shapes that differ, for seconds.
    """
    for i, value in np.ndenumerate(values):
        out[i] = value
