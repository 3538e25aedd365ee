"""States of the loop between two ticks, kept so that a failure can be replayed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.compiled.state import arrays_of
from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.loop import Loop

INTERVAL = 512  # ticks between two snapshots: copying the state takes as long as about ten ticks


@dataclass
class Snapshot:
    """State of one run before tick ``k``: this run's part of each array that has changed."""

    k: int
    arrays: dict[str, Array]


class Snapshots:
    """The last two states of a loop."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._live = arrays_of(loop.blocks)
        self._initial = {name: array.copy() for name, array in self._live.items()}
        self._kept: list[tuple[int, dict[str, Array]]] = []
        self._failures: dict[int, Snapshot] = {}

    def keep(self) -> None:
        """Save the state if a snapshot is due; call before every tick."""
        if self._loop.k % INTERVAL == 0:
            changed = {
                n: a.copy()
                for n, a in self._live.items()
                if not np.array_equal(a, self._initial[n], equal_nan=a.dtype.kind == "f")
            }
            self._kept = [*self._kept[-1:], (self._loop.k, changed)]

    def failures(self) -> dict[int, Snapshot]:
        """For each failed run, a state from which to replay it; call after every tick."""
        for i in self._loop.trouble.keys() - self._failures.keys():
            k, arrays = self._kept[0]
            runs = len(self._loop.scenarios)
            self._failures[i] = Snapshot(
                k, {name: _part(array, i, runs) for name, array in arrays.items()}
            )
        return self._failures


def _part(array: Array, i: int, runs: int) -> Array:
    """Run ``i`` of an array whose leading axis is the run; a shared array unchanged."""
    return array[i : i + 1].copy() if array.shape[:1] == (runs,) else array.copy()


def restore(loop: Loop, snapshot: Snapshot) -> bool:
    """Put a new loop of one run into the state of ``snapshot``.

    Returns False, with the loop unchanged, if the shapes differ: the run was in a batch with longer
    buffers. It then fails in the same way when run from its start.
    """
    live = arrays_of(loop.blocks)
    if any(
        name not in live or live[name].shape != array.shape
        for name, array in snapshot.arrays.items()
    ):
        return False
    for name, array in snapshot.arrays.items():
        live[name][...] = array
    loop.k = snapshot.k
    return True


def flatten(snapshot: Snapshot) -> dict[str, Array]:
    """The snapshot as named arrays, for a file."""
    return {"k": np.array(snapshot.k)} | snapshot.arrays


def unflatten(arrays: dict[str, Array]) -> Snapshot:
    """The inverse of :func:`flatten`."""
    return Snapshot(
        int(arrays["k"]), {name: array for name, array in arrays.items() if name != "k"}
    )
