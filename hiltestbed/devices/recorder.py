"""The process that records: takes the loop's rows out of their ring and writes them to a file, so that the loop never waits for a disk.

    recorder = Recorder(columns=80, rows=20_000, path=folder / "rows.f64")
    recorder.push(row)                       # in the loop
    rows = recorder.finish()                 # (k, 80), and the process has ended

The file holds 64-bit numbers, row after row, and stays whole up to the last row taken when the loop's process dies.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from hiltestbed.devices.realtime import ordinary
from hiltestbed.devices.ring import Array, Ring
from hiltestbed.errors import HiltestbedError

NAP = 0.005  # [s] between two looks at the ring
PATIENCE = 20.0  # [s] for the process to begin, and to write what is left
READY = "ready"


class Recorder:
    """The loop's end of the recording.

    Attributes:
        ring: of the rows; ``ring.dropped`` is how many were lost because the recording fell behind.
    """

    def __init__(self, columns: int, rows: int, path: Path) -> None:
        """Start the process; returns when it is ready. Raises HiltestbedError where it is not."""
        self.path = path
        self.ring = Ring(columns, rows)
        command = [sys.executable, "-m", "hiltestbed.devices.recorder", self.ring.name, str(path), str(os.getpid())]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
        line = self._process.stdout.readline() if self._process.stdout else ""
        if line.strip() != READY:
            self._process.wait(PATIENCE)
            self.ring.close()
            raise HiltestbedError(f"{path}: the process that records did not start; check that the folder can be written to")

    def push(self, row: Array) -> bool:
        """Hand over a row (columns,); False where it was dropped."""
        return self.ring.push(row)

    def finish(self) -> Array:
        """End the recording: (k, columns) all rows, mapped from the file. Raises HiltestbedError where the process has failed."""
        self.ring.finish()
        columns = self.ring.columns
        try:
            status = self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        if self._process.stdout:
            self._process.stdout.close()
        self.ring.close()
        if status != 0:
            raise HiltestbedError(f"{self.path}: the process that records has failed (status {status}); the file holds what it had written")
        if self.path.stat().st_size == 0:
            return np.zeros((0, columns))
        return np.memmap(self.path, np.float64, "r").reshape(-1, columns)


def main() -> int:
    """The process itself: until the ring is finished and empty, or its parent has gone."""
    parser = argparse.ArgumentParser()
    parser.add_argument("ring")
    parser.add_argument("path")
    parser.add_argument("parent", type=int)
    arguments = parser.parse_args()
    ordinary()
    try:
        file = open(arguments.path, "wb")  # noqa: SIM115 (closed below: the ring is announced in between)
    except OSError:
        return 1
    ring = Ring.attach(arguments.ring)
    sys.stdout.write(READY + "\n")
    sys.stdout.flush()
    with file:
        while True:
            finished = ring.finished or os.getppid() != arguments.parent
            rows = ring.take()
            if len(rows):
                file.write(rows.tobytes())
                file.flush()
            elif finished:
                break
            else:
                time.sleep(NAP)
    ring.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
