"""`hiltestbed bench robustness [--for MINUTES] [--workers N]`: random trials, in processes that may
crash or hang.

How the trials of a process ended is saved when it ends, so that the same command goes on where it
was stopped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltestbed.bench.result import BenchResult
from hiltestbed.compiled.warm import cores
from hiltestbed.report.page import Report
from tests.equipment.kept import Kept
from tests.equipment.robustness.trials import REFUSED, REMARKED, SURVIVED, TRIALS

QUICK, LONG = 0.5, 60.0  # [min] default time limits
TARGETS = {
    "scenario": 5_000,
    "extremes": 5_000,
    "text": 5_000,
    "dataset": 2_000,
    "distortion": 1_000,
    "file": 20_000,
    "campaign": 1_000,
    "packet": 10_000,
    "kill": 200,
}
# trials per process; PLAIN for the other kinds
BATCH = {"file": 1000, "packet": 1000, "text": 500, "campaign": 500, "kill": 10}
PLAIN = 200
# fraction of a kind's target in its first batch, so that every kind gets its share of a short time
FIRST = 0.01
CONTAINED = {"file"}  # kinds that normal use runs in a separate process, which contains a crash
SHOWN = 50  # largest number of faults listed
EACH = 10  # largest number of trials listed per fault
POLL = 0.05  # [s]
STRETCH = "stretch"  # kind of the record of one command's duration
Progress = Callable[[int, int], None]


@dataclass
class Tally:
    """Results of the trials of one kind."""

    tried: int = 0
    wall: float = 0.0
    ended: Counter[str] = field(default_factory=Counter)
    faults: dict[str, dict[str, Any]] = field(default_factory=dict)
    following: int = 0
    busy: int = 0

    def count(self, record: dict[str, Any]) -> None:
        """Count a trial. Of each place of a fault, the text of the first and all numbers are
        kept.
        """
        self.tried += 1
        if "fault" not in record:
            self.ended[record["ended"]] += 1
            return
        self.ended["failed"] += 1
        first = {"kind": record["kind"], "numbers": [], "fault": record["fault"]}
        self.faults.setdefault(record["place"], first)["numbers"].append(record["number"])


def robustness(
    quick: bool = False,
    progress: Progress | None = None,
    minutes: float | None = None,
    workers: int | None = None,
    keep: Path | None = None,
) -> BenchResult:
    """Trials of every kind, in ``workers`` processes, until the numbers in ``TARGETS`` are reached
    or the time is up.

    ``keep``: file to which the trials are saved, to go on from.
    """
    limit = 60.0 * (minutes if minutes is not None else QUICK if quick else LONG)
    start = time.monotonic()
    count = workers or cores()
    kept = Kept(keep, lambda record: (record["kind"], record["number"]))
    with (
        tempfile.TemporaryDirectory(prefix="hiltestbed-") as shared,
        ThreadPoolExecutor(count) as pool,
    ):
        work = _Work(start + limit, Path(shared), kept)
        stretches = work.take_up()
        running = [pool.submit(work.go_on) for _ in range(count)]
        try:
            while not all(one.done() for one in running):
                time.sleep(POLL)
                if progress:
                    progress(round(min(time.monotonic() - start, limit)), round(limit))
        except BaseException:
            work.until = 0.0
            raise
        finally:
            with work.lock:
                kept.add(
                    {"kind": STRETCH, "number": len(stretches), "wall": time.monotonic() - start}
                )
        for one in running:
            one.result()
    if all(tally.tried >= TARGETS[kind] for kind, tally in work.tallies.items()):
        kept.done()
    return _result(work.tallies, sum(stretches) + time.monotonic() - start, count)


@dataclass
class _Work:
    """The remaining trials, from which one thread per worker takes batches.

    Attributes:
        until: end of the time. shared: folder of all workers. kept: trials that have ended.
        tallies: of each kind.
    """

    until: float
    shared: Path
    kept: Kept
    tallies: dict[str, Tally] = field(default_factory=lambda: {kind: Tally() for kind in TRIALS})
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take_up(self) -> list[float]:
        """Count the trials of the commands before, and return their durations [s]."""
        records = self.kept.records.values()
        for record in records:
            if record["kind"] != STRETCH:
                tally = self.tallies[record["kind"]]
                tally.following = max(tally.following, record["number"] + 1)
                tally.wall += record.get("wall", 0.0)
                tally.count(record)
        return [record["wall"] for record in records if record["kind"] == STRETCH]

    def go_on(self) -> None:
        """Run batches of the kind that is furthest behind, until all are done."""
        while time.monotonic() < self.until:
            with self.lock:
                left = {k: TARGETS[k] - t.tried - t.busy for k, t in self.tallies.items()}
                kind = max(left, key=lambda k: left[k] / max(TARGETS[k], 1))
                if left[kind] <= 0:
                    return
                tally = self.tallies[kind]
                count = min(BATCH.get(kind, PLAIN), left[kind])
                if tally.tried == 0:
                    count = max(1, min(count, round(FIRST * TARGETS[kind])))
                first = tally.following
                tally.following += count
                tally.busy += count
            self._batch(kind, first, count)

    def _batch(self, kind: str, first: int, count: int) -> None:
        """Run trials from ``first`` on, with a new process whenever one is lost."""
        tally, begin, following = self.tallies[kind], time.monotonic(), first
        while following < first + count and time.monotonic() < self.until:
            records = self._process(kind, following, first + count - following)
            following += len(records)
            with self.lock:
                tally.busy -= len(records)
                for record in records:
                    tally.count(record)
                    self.kept.add(record)
        with self.lock:
            tally.busy -= first + count - following
            tally.wall += time.monotonic() - begin

    def _process(self, kind: str, first: int, count: int) -> list[dict[str, Any]]:
        """The records of the trials of one process, up to the one that it was lost in; it is
        killed when the time is up.
        """
        worker = Path(__file__).with_name("worker.py")
        order = [sys.executable, *map(str, (worker, kind, first, count, self.shared))]
        places = [str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH", "")]
        env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))}
        none, pipe, stopped = subprocess.DEVNULL, subprocess.PIPE, False
        # in a session of its own: Ctrl-C is for the command, which then ends it here
        with subprocess.Popen(
            order, stdin=none, stdout=pipe, stderr=pipe, env=env, start_new_session=True
        ) as process:
            while True:
                try:
                    out, err = process.communicate(timeout=1.0)
                    break
                except subprocess.TimeoutExpired:
                    if time.monotonic() >= self.until:
                        stopped = True
                        process.kill()
        messages = [json.loads(line) for line in out.split(b"\n")[:-1]]
        records = [{"kind": kind, **message} for message in messages if "number" in message]
        if process.returncode and not stopped:
            how = "hangs" if b"Timeout" in err else f"ends with {process.returncode}"
            contained = kind in CONTAINED and how != "hangs"
            ended = {"ended": "contained"} if contained else {"fault": f"the process {how}"}
            records.append({"kind": kind, "number": first + len(records), "place": how, **ended})
        return records


def _result(tallies: dict[str, Tally], wall: float, workers: int) -> BenchResult:
    records = [
        {
            "kind": kind,
            "tried": t.tried,
            "wanted": TARGETS[kind],
            "survived": t.ended[SURVIVED],
            "refused": t.ended[REFUSED],
            "remarked": t.ended[REMARKED],
            "stopped": t.ended["stopped"] + t.ended["diverged"],
            "contained": t.ended["contained"],
            "failed": t.ended["failed"],
            "wall": t.wall,
            "other": {k: n for k, n in t.ended.items() if k.startswith("taken")},
        }
        for kind, t in tallies.items()
    ]
    faults = [fault for t in tallies.values() for fault in t.faults.values()]
    tried, failed = (sum(r[name] for r in records) for name in ("tried", "failed"))
    summary = {
        "tried": tried,
        "failed": failed,
        "minutes": wall / 60.0,
        "workers": workers,
        "faults": faults,
        "kinds": {r["kind"]: r for r in records},
    }
    report = Report("Robustness")
    report.lead(
        f"{tried} random trials, {failed} of which ended neither in a result nor in a clear "
        f"refusal."
    )
    report.text(f"{wall / 60.0:.1f} minutes with {workers} processes.")
    columns = [name for name in records[0] if name not in ("wall", "other")]
    report.table(columns, [[str(r[c]) for c in columns] for r in records])
    if faults:
        rows = [
            [f["kind"], _few(f["numbers"]), str(len(f["numbers"])), f["fault"]]
            for f in faults[:SHOWN]
        ]
        report.heading("Faults")
        report.table(["kind", "trials", "times", "fault"], rows)
    lines = [(r["kind"], ", ".join(f"{r[c]} {c}" for c in columns[1:] if r[c])) for r in records]
    lines += [("failed", f"{failed} of {tried}")]
    return BenchResult("robustness", records, summary, report, lines)


def _few(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers[:EACH])) + (", ..." if len(numbers) > EACH else "")
