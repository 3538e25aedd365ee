"""Recording in a separate process, which reads the loop's rows from a ring and writes them to a
file: the loop never waits for a disk.

    recorder = Recorder(columns=80, rows=20_000, path=folder / "rows.f64")
    recorder.push(row)                       # in the loop
    rows = recorder.finish()                 # (k, 80); the process has ended

The file holds 64-bit floats, row by row. If the loop's process dies, everything it has pushed is
still written.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from hiltestbed.devices.realtime import ended, ordinary, started
from hiltestbed.devices.ring import READY, Array, Ring, attached
from hiltestbed.errors import HiltestbedError
from hiltestbed.signals import Trace, groups

NAP = 0.005  # [s] between two reads of the ring
BACKLOG = 4000  # rows by which the recording may lag: two seconds at 2 kHz


class Recorder:
    """The loop's end of the recording; ``ring.dropped`` counts the rows that it fell behind by."""

    def __init__(self, columns: int, rows: int, path: Path) -> None:
        """Start the process; HiltestbedError if it does not start."""
        self.path = path
        self.ring = Ring(columns, rows)
        self._process = started(
            "recorder", self.ring.name, path, os.getpid(), stdout=subprocess.PIPE
        )
        try:
            ready = self._process.stdout is not None and self._process.stdout.readline()
        except BaseException:
            self._process.kill()
            self._ended()
            raise
        if ready != READY + "\n":
            self._ended()
            raise HiltestbedError(
                f"{path}: the process that records did not start; check that the folder can be "
                f"written to"
            )

    def push(self, row: Array) -> bool:
        """Record a row (columns,); False if it was dropped."""
        return self.ring.push(row)

    def finish(self) -> Array:
        """End the recording; all rows (k, columns), as mapped from the file, or HiltestbedError."""
        self.ring.finish()
        status, columns = self._ended(), self.ring.columns
        if status != 0:
            raise HiltestbedError(
                f"{self.path}: the process that records has failed (status {status}); the file "
                f"holds what it had written"
            )
        if self.path.stat().st_size == 0:
            return np.zeros((0, columns))
        return np.memmap(self.path, np.float64, "r").reshape(-1, columns)

    def _ended(self) -> int:
        """The status of the process, which is to end."""
        status = ended(self._process)
        if self._process.stdout:
            self._process.stdout.close()
        self.ring.close()
        return status


class TraceRecorder:
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
        self._row = np.empty(len(columns))
        path.parent.mkdir(parents=True, exist_ok=True)
        self._recorder = Recorder(len(columns), BACKLOG, path)
        path.with_suffix(".json").write_text(json.dumps({"columns": columns}), encoding="utf-8")

    def push(self, k: int) -> None:
        """Record row ``k`` of the trace, which is complete."""
        row, trace, at = self._row, self._trace, 1
        row[0] = trace.t[k]
        for values in trace.data.values():
            width = values.shape[2]
            row[at : at + width] = values[k, 0]
            at += width
        row[at] = trace.contact[k, 0]
        self._recorder.push(row)

    def finish(self) -> None:
        """End the recording; the files remain."""
        self._recorder.finish()


def discard(path: Path) -> None:
    """Remove the files of a :class:`TraceRecorder`, after the complete run has been written."""
    for file in (path, path.with_suffix(".json")):
        file.unlink(missing_ok=True)


def main() -> int:
    """Entry point of the process."""
    name, path, parent = sys.argv[1:]
    ordinary()
    try:
        file = open(path, "wb")  # noqa: SIM115 (closed below: the ring is announced in between)
    except OSError:
        return 1
    with file, attached(name) as rings:
        if not rings:
            return 1
        finished = False
        while not finished:
            finished = rings[0].finished or os.getppid() != int(parent)
            file.write(rings[0].take().tobytes())
            file.flush()
            time.sleep(NAP)
    return 0


if __name__ == "__main__":
    sys.exit(main())
