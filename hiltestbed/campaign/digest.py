"""The hash of a trace without storing the trace: a campaign holds one block of rows per run."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np

from hiltestbed.frames import Array
from hiltestbed.signals import GROUPS, RunTrace, groups

if TYPE_CHECKING:
    from hiltestbed.loop import Loop

BLOCK = 128  # rows between two updates of the hashes: 64 runs take 5 MB


class TraceDigest:
    """Replaces a Trace: takes the same rows, a block at a time, and gives `sha256(i)` of run i
    instead of the rows.

    The hash covers every column except `t`, row by row in the order of the trace file, as
    little-endian float64. A run that ended early is hashed up to its last row.
    """

    def __init__(self, loop: Loop) -> None:
        n = len(loop.scenarios)
        self._trouble = loop.trouble  # not the loop itself: this would keep its models in memory
        self._hashes = [hashlib.sha256() for _ in range(n)]
        self._done = 0
        self.length = np.zeros(n, dtype=int)  # set by the simulation when it ends
        self.data = {
            group.name: np.zeros((BLOCK, n, len(group.parts)))
            for group in groups(loop.plant.units).values()
        }
        self.contact = np.zeros((BLOCK, n), dtype=bool)

    def filled(self, ticks: int) -> None:
        """Hash a full block; the first ``ticks`` rows are written."""
        if ticks - self._done == BLOCK:
            self._take(ticks)

    def _take(self, end: int) -> None:
        """Hash the rows from the last block's end to `end`."""
        count = end - self._done
        for i, digest in enumerate(self._hashes):
            rows = min(count, self._trouble[i][0] + 1 - self._done) if i in self._trouble else count
            if rows > 0:
                parts = [self.data[name][:rows, i] for name in GROUPS]
                digest.update(_matrix(parts, self.contact[:rows, i]))
        self._done = end

    def run(self, i: int) -> None:
        """None: the rows are not kept."""

    def sha256(self, i: int) -> str:
        """The hash of run i, in hexadecimal; valid once the loop has ended."""
        if self._done < self.length.max():
            self._take(int(self.length.max()))
        return self._hashes[i].hexdigest()


def _matrix(parts: list[Array], contact: Array) -> bytes:
    return (
        np.concatenate([*parts, contact[:, None].astype(float)], axis=1)
        .astype("<f8", copy=False)
        .tobytes()
    )


def trace_sha256(trace: RunTrace) -> str:
    """The same hash, of a stored trace."""
    return hashlib.sha256(_matrix([trace.data[name] for name in GROUPS], trace.contact)).hexdigest()
