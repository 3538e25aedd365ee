"""The process that runs trials: `PYTHONPATH=. python tests/equipment/robustness/worker.py KIND FIRST
COUNT [SHARED]`, with a line of JSON before and after each.

Trial N of a kind is always the same: `... KIND N 1` repeats it. SHARED is a folder for files that
are made once for all workers.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
import traceback
from pathlib import Path
from zlib import crc32

import numpy as np

from tests.equipment.robustness.trials import TRIALS


def serve(kind: str, first: int, count: int, shared: Path | None = None) -> None:
    """Run trials and print how each ended."""
    with (
        tempfile.TemporaryDirectory(prefix="hiltestbed-", dir=shared) as place,
        np.errstate(all="ignore"),
    ):
        folder = Path(place) if shared else Path(place) / "trials"
        folder.mkdir(exist_ok=True)
        for number in range(first, first + count):
            _send({"begin": number})
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
            _send(message | {"number": number, "wall": time.perf_counter() - start})


def _send(message: dict) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    serve(
        sys.argv[1],
        int(sys.argv[2]),
        int(sys.argv[3]),
        Path(sys.argv[4]) if len(sys.argv) > 4 else None,
    )
