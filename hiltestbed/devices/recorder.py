"""Recording in a separate process, which writes the rows that the loop sends it to a file: the loop
never waits for a disk. If the loop's process dies, everything that it has sent is still written.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np

from hiltestbed.devices.realtime import PATIENCE, Companion, ordinary, say
from hiltestbed.errors import HiltestbedError
from hiltestbed.frames import Array
from hiltestbed.signals import Trace, groups

READY = b"ready\n"


class Recorder:
    """The loop's end of the recording of rows in ``path``: 64-bit floats, row by row."""

    def __init__(self, path: Path) -> None:
        """Start the process; HiltestbedError if it does not start."""
        self.path = path
        self._process, self._unsent = Companion("recorder", path), bytearray()
        try:
            ready = self._process.has_said(READY, PATIENCE)
        except BaseException:
            self._process.end()
            raise
        if not ready:
            self._process.end()
            raise HiltestbedError(
                f"{path}: the process that records did not start; check that the folder can be "
                f"written to"
            )

    def push(self, row: Array) -> None:
        """Record a row (columns,): what the process cannot take now is sent with the next ones."""
        self._unsent += row.tobytes()
        del self._unsent[: self._process.send(self._unsent)]

    def finish(self) -> None:
        """End the recording; HiltestbedError if the file does not hold all rows."""
        status = self._process.end(bytes(self._unsent))
        if status != 0:
            raise HiltestbedError(
                f"{self.path}: the process that records has failed (status {status}); the file "
                f"holds what it had written"
            )


class TraceRecorder(Recorder):
    """Writes the rows of a run as they are produced: 64-bit floats in ``path``, and the columns'
    names in a JSON file next to it.

    If the loop's process dies, ``numpy.fromfile(path).reshape(-1, len(columns))`` is the run up to
    that point.
    """

    def __init__(self, trace: Trace, path: Path) -> None:
        """``trace``: of one run. Raises HiltestbedError if the file cannot be written."""
        own = groups(trace.joints)
        self._trace = trace
        columns = ["t", *(c for name in trace.data for c in own[name].columns), "contact"]
        path.parent.mkdir(parents=True, exist_ok=True)
        super().__init__(path)
        path.with_suffix(".json").write_text(json.dumps({"columns": columns}), encoding="utf-8")

    def push_tick(self, k: int) -> None:
        """Record row ``k`` of the trace, which is complete."""
        trace = self._trace
        parts = (values[k, 0] for values in trace.data.values())
        self.push(np.concatenate([trace.t[k : k + 1], *parts, trace.contact[k]]))


def discard(path: Path) -> None:
    """Remove the files of a :class:`TraceRecorder`, after the complete run has been written."""
    for file in (path, path.with_suffix(".json")):
        file.unlink(missing_ok=True)


def main() -> int:
    """Entry point of the process."""
    ordinary()
    try:
        file = open(sys.argv[1], "wb", buffering=0)  # noqa: SIM115 (closed below)
    except OSError:
        return 1
    with file:
        if not say(READY):
            return 1
        while rows := os.read(0, 1 << 20):
            file.write(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
