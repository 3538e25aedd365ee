"""The process that runs trials: `PYTHONPATH=. python tests/equipment/robustness/worker.py KIND FIRST
COUNT [SHARED]`, with a line of JSON before and after each.

Trial N of a kind is always the same: `... KIND N 1` repeats it. SHARED is a folder for files that
are made once for all workers.
"""

from __future__ import annotations

import faulthandler
import json
import sys
import tempfile
import time
import traceback
from pathlib import Path
from zlib import crc32

import numpy as np

from tests.equipment.robustness.trials import TRIALS

# [s] after which a trial hangs: it may have to compile kernels, on a machine that is busy
HANGS, COMMAND_HANGS = 900.0, 4000.0


def serve(kind: str, first: int, count: int, shared: Path | None = None) -> None:
    """Run trials and print how each ended; one that hangs ends the process."""
    with (
        tempfile.TemporaryDirectory(prefix="hiltestbed-", dir=shared) as place,
        np.errstate(all="ignore"),
    ):
        folder = Path(place) if shared else Path(place) / "trials"
        folder.mkdir(exist_ok=True)
        for number in range(first, first + count):
            print(json.dumps({"begin": number}), flush=True)
            faulthandler.dump_traceback_later(COMMAND_HANGS if kind == "kill" else HANGS, exit=True)
            start = time.perf_counter()
            try:
                ended = TRIALS[kind](np.random.default_rng([crc32(kind.encode()), number]), folder)
                message = {"ended": ended}
            except Exception as error:
                last = traceback.extract_tb(error.__traceback__)
                ours = next((f for f in reversed(last) if "hiltestbed" in f.filename), last[-1])
                where = f"{Path(ours.filename).name}:{ours.lineno}"
                message = {
                    "fault": f"{type(error).__name__} at {where}: {str(error)[:200]}",
                    "place": f"{type(error).__name__} {where}",
                }
            message |= {"number": number, "wall": time.perf_counter() - start}
            print(json.dumps(message), flush=True)


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), *map(Path, sys.argv[4:]))
