"""Kernels whose arrays are handed over once give what the kernel itself gives, and hold on to what
they need.
"""

import gc
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit, typeof

from hiltestbed.compiled.bound import GIVEN, Bound, Call, bound
from hiltestbed.compiled.dispatch import _by_fields
from hiltestbed.compiled.state import arrays_of


@njit(cache=True)
def _mix(k, scale, flag, count, a, b, mask, empty, out):
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = (
                k * scale * a[i, j]
                + (b[i] if mask[i] else 0.0)
                + (count if flag else 0)
                + empty.shape[0]
            )
    return out[0, 0] > 0.0


@njit(cache=True)
def _add(amount, total):
    total[0] += amount


@njit(cache=True)
def _add_each(now, totals):
    for m in range(len(now)):
        for i in range(now[m].shape[0]):
            totals[m][i] += now[m][i]


def _arrays(kind: str) -> list[np.ndarray]:
    """a, b, mask, empty and out of the kernel, in several layouts."""
    rng = np.random.default_rng(3)
    store, row = rng.normal(size=(4, 3, 5)), rng.normal(size=8)
    mask, empty = np.array([True, False, True, False, True, False, True, False]), np.zeros((0, 2))
    if kind == "contiguous":
        return [
            np.ascontiguousarray(store[:, 0]),
            row[:4].copy(),
            mask[:4].copy(),
            empty,
            np.zeros((4, 5)),
        ]
    if kind == "views":
        return [store[:, -1], row[::2], mask[1::2], empty, np.zeros((4, 2, 5))[:, 1]]
    return [store[1:2, -1], row[:1], mask[:1], empty, np.zeros((5, 1)).T]


@pytest.mark.parametrize("kind", ["contiguous", "views", "one run"])
def test_a_bound_kernel_gives_what_the_kernel_gives(kind: str) -> None:
    a, b, mask, empty, out = _arrays(kind)
    expected = np.zeros_like(out)
    told = _mix(3, 0.7, True, 2, a, b, mask, empty, expected)
    call = bound(_mix, ..., 0.7, True, 2, a, b, mask, empty, out)
    assert call(3) == told
    assert np.array_equal(out, expected)
    a *= 2.0  # it reads the arrays as they are, not as they were
    _mix(4, 0.7, True, 2, a, b, mask, empty, expected)
    call(4)
    assert np.array_equal(out, expected)


class _Scale(NamedTuple):
    factor: float
    on: bool
    total: np.ndarray


class _Swapped(NamedTuple):
    factor: float
    total: np.ndarray
    on: bool


class _Outer(NamedTuple):
    scale: _Scale
    count: int


@njit(cache=True)
def _scaled(outer, pair):
    if outer.scale.on:
        outer.scale.total[0] += outer.scale.factor * outer.count * pair[0][0] + pair[1]


def test_tuples_are_bound_with_their_parts() -> None:
    total, one = np.zeros(1), np.ones(1)
    bound(_scaled, _Outer(_Scale(0.5, True, total), 3), (2.0 * one, 1.0))()
    bound(_scaled, _Outer(_Scale(9.0, False, total), 3), (one, 1.0))()
    assert total[0] == 0.5 * 3 * 2.0 + 1.0


def test_a_kernel_is_cached_by_the_fields_of_its_tuples() -> None:
    """A field that moves within a class of the same name would be read from its old place."""
    key = _by_fields(lambda signature, codegen: ())
    given = [typeof(c(factor=1.0, on=True, total=np.ones(1))) for c in (_Scale, _Swapped)]
    first, second = (key((kind,), None) for kind in given)
    assert first != second
    assert first != key((typeof(np.ones(1)),), None)


def test_what_is_bound_lives_as_long_as_the_call() -> None:
    calls = [bound(_add, 1.0, np.full(64, 0.5)) for _ in range(50)]
    nested = [partial(call) for call in calls]
    del calls
    gc.collect()
    np.full(100_000, -1.0)  # takes the place of what might have been freed
    for call in nested:
        call()
        inner = call.func
        assert isinstance(inner, Bound)
        assert inner.kept[1][1][0] == 1.5


def test_a_callers_arrays_are_looked_at_by_identity() -> None:
    """Two arrays of equal numbers are two arrays; the first is written no more once the second is
    given, and again when it returns.
    """
    call, first, second = Call(_add, ..., GIVEN), np.zeros(1), np.zeros(1)
    call.on(first)(1.0)
    call.on(second)(2.0)
    call.on(first)(4.0)
    assert (first[0], second[0]) == (5.0, 2.0)
    many = [np.zeros(1) for _ in range(10)]
    for _ in range(2):
        for array in many:
            call.on(array)(1.0)
    assert all(array[0] == 2.0 for array in many)


def test_a_list_of_arrays_may_differ_in_length_and_layout() -> None:
    now = [np.arange(3.0), np.arange(8.0)[::2]]
    totals = [np.ones(3), np.ones((4, 2))[:, 1]]
    call = bound(_add_each, now, totals)
    call()
    call()
    assert [t.tolist() for t in totals] == [[1.0, 3.0, 5.0], [1.0, 5.0, 9.0, 13.0]]


def test_tables_of_addresses_are_no_state() -> None:
    class Block:
        def __init__(self) -> None:
            self.total = np.zeros(1)
            self.call, self.calls = bound(_add, ..., self.total), Call(_add, ..., GIVEN)
            self.calls.on(self.total)(1.0)

    assert list(arrays_of(Block())) == ["total"]
