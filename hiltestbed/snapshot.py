"""States of the loop between two ticks, kept so that a failure can be replayed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.frames import Array

if TYPE_CHECKING:
    from hiltestbed.loop import Loop

INTERVAL = 512  # ticks between two snapshots: copying the state costs some ten ticks


@dataclass
class Snapshot:
    """The state of one run before tick ``k``: block name to buffer name to that run's part of the array."""

    k: int
    blocks: dict[str, dict[str, Array]]


class Snapshots:
    """The last two states of a loop."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._kept: list[tuple[int, dict[str, dict[str, Array]]]] = []
        self._failures: dict[int, Snapshot] = {}

    def keep(self) -> None:
        """Keep the state when one is due; call before every tick."""
        if self._loop.k % INTERVAL == 0:
            state = {block: {name: array.copy() for name, array in arrays.items()} for block, arrays in self._loop.buffers().items()}
            self._kept = [*self._kept[-1:], (self._loop.k, state)]

    def failures(self) -> dict[int, Snapshot]:
        """For each run that has failed, a state from which its failure follows; call after every tick."""
        for i in self._loop.trouble.keys() - self._failures.keys():
            k, blocks = self._kept[0]
            runs = len(self._loop.scenarios)
            self._failures[i] = Snapshot(k, {b: {name: _part(a, i, runs) for name, a in arrays.items()} for b, arrays in blocks.items()})
        return self._failures


def _part(array: Array, i: int, runs: int) -> Array:
    """Run ``i`` of an array whose leading axis is the run; an array shared by all runs as it is."""
    return array[i : i + 1].copy() if array.shape[:1] == (runs,) else array.copy()


def restore(loop: Loop, snapshot: Snapshot) -> None:
    """Put a loop of one run into the state of ``snapshot``."""
    for block, arrays in loop.buffers().items():
        for name, array in arrays.items():
            array[...] = snapshot.blocks[block][name]
    loop.k = snapshot.k


def flatten(snapshot: Snapshot) -> dict[str, Array]:
    """The snapshot as named arrays, for a file."""
    out = {f"{block}/{name}": array for block, arrays in snapshot.blocks.items() for name, array in arrays.items()}
    return {"k": np.array(snapshot.k)} | out


def unflatten(arrays: dict[str, Array]) -> Snapshot:
    """The inverse of :func:`flatten`."""
    blocks: dict[str, dict[str, Array]] = {}
    for key, array in arrays.items():
        if key != "k":
            block, name = key.split("/")
            blocks.setdefault(block, {})[name] = array
    return Snapshot(int(arrays["k"]), blocks)
