"""`hiltestbed bench robustness [--for MINUTES] [--workers N]`: random trials, in processes that may
crash or hang.

How each trial ended is saved as it ends, so that the same command goes on where it was stopped.
"""

from __future__ import annotations

import json
import math
import os
import selectors
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
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
# [s] busy, or asleep, without an answer, from which a trial counts as hanging: it may have to
# compile kernels
HANGS = 240.0
SLOW = {"kill": 4000.0}  # the same for kinds whose trials are whole commands
BEGIN = 600.0  # [s] the same for the first answer
CONTAINED = {"file"}  # kinds that normal use runs in a separate process, which contains a crash
SHOWN = 50  # largest number of faults listed
EACH = 10  # largest number of trials listed per fault
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

    def fault(self, kind: str, number: int, place: str, text: str) -> None:
        """Count a fault: for each place, the text of the first and the numbers of all are kept."""
        self.ended["failed"] += 1
        self.faults.setdefault(place, {"kind": kind, "numbers": [], "fault": text})[
            "numbers"
        ].append(number)


def robustness(
    quick: bool = False,
    progress: Progress | None = None,
    minutes: float | None = None,
    workers: int | None = None,
    keep: Path | None = None,
) -> BenchResult:
    """Trials of every kind, in ``workers`` processes, until the numbers in ``TARGETS`` are reached
    or the time is up.

    ``keep``: file to which the trials are saved as they end, to go on from.
    """
    limit = 60.0 * (minutes if minutes is not None else QUICK if quick else LONG)
    start = time.monotonic()
    count = workers or cores()
    kept = Kept(keep, lambda record: (record["kind"], record["number"]))
    with (
        tempfile.TemporaryDirectory(prefix="hiltestbed-") as shared,
        ThreadPoolExecutor(count) as pool,
    ):
        work = _Work({kind: Tally() for kind in TRIALS}, start + limit, Path(shared), kept)
        work.take_up()
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
                    {"kind": STRETCH, "number": work.stretches, "wall": time.monotonic() - start}
                )
        for one in running:
            one.result()
    if all(tally.tried >= TARGETS[kind] for kind, tally in work.tallies.items()):
        kept.done()
    return _result(work.tallies, work.earlier + time.monotonic() - start, count)


POLL = 0.05  # [s]
STRETCH = "stretch"  # kind of the record of one command's duration


@dataclass
class _Work:
    """The remaining trials, from which one thread per worker takes batches.

    Attributes:
        tallies: of each kind. until: end of the time. shared: folder of all workers. kept: trials
            that have ended.
        stretches, earlier: number and duration [s] of the commands before, on which this one goes
            on.
    """

    tallies: dict[str, Tally]
    until: float
    shared: Path
    kept: Kept
    stretches: int = 0
    earlier: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take_up(self) -> None:
        """Count the trials of the commands before."""
        for record in self.kept.records.values():
            if record["kind"] == STRETCH:
                self.stretches, self.earlier = self.stretches + 1, self.earlier + record["wall"]
                continue
            tally = self.tallies[record["kind"]]
            tally.following = max(tally.following, record["number"] + 1)
            tally.wall += record.get("wall", 0.0)
            _count(tally, record)

    def go_on(self) -> None:
        """Run batches of the kind that is furthest behind, until all are done."""
        while time.monotonic() < self.until:
            with self.lock:
                behind = {
                    k: (t.tried + t.busy) / TARGETS[k]
                    for k, t in self.tallies.items()
                    if t.tried + t.busy < TARGETS[k]
                }
                if not behind:
                    return
                kind = min(behind, key=lambda k: behind[k])
                tally = self.tallies[kind]
                count = min(BATCH.get(kind, PLAIN), TARGETS[kind] - tally.tried - tally.busy)
                count = (
                    max(1, min(count, round(FIRST * TARGETS[kind]))) if tally.tried == 0 else count
                )
                first = tally.following
                tally.following += count
                tally.busy += count
            self._batch(kind, first, count)

    def _batch(self, kind: str, first: int, count: int) -> None:
        """Run trials from ``first`` on, with a new process whenever one is lost."""
        tally, begin, following, current = self.tallies[kind], time.monotonic(), first, None
        while following < first + count and time.monotonic() < self.until:
            for message in _answers(
                kind, following, first + count - following, self.shared, lambda: self.until
            ):
                if "begin" in message:
                    current = message["begin"]
                    continue
                with self.lock:
                    if "lost" not in message:
                        record, current = {"kind": kind, **message}, None
                    elif message["lost"] != "time is up":
                        record = _lost(
                            kind, following if current is None else current, message["lost"]
                        )
                    else:
                        continue
                    following = int(record["number"]) + 1
                    tally.busy -= 1
                    _count(tally, record)
                    self.kept.add(record)
        with self.lock:
            tally.busy -= first + count - following
            tally.wall += time.monotonic() - begin


def _lost(kind: str, number: int, how: str) -> dict[str, Any]:
    """The record of a trial whose process was lost."""
    contained = kind in CONTAINED and how != "hangs"
    ended = {"ended": "contained"} if contained else {"fault": f"the process {how}", "place": how}
    return {"kind": kind, "number": number, **ended}


def _count(tally: Tally, record: dict[str, Any]) -> None:
    tally.tried += 1
    if "fault" in record:
        tally.fault(record["kind"], record["number"], record["place"], record["fault"])
    else:
        tally.ended[record["ended"]] += 1


# fraction of a kind's target in its first batch, so that every kind gets its share of a short time
FIRST = 0.01


class _Clock:
    """Wall and processor time of a process since its last answer: on a busy machine it may wait for
    a core longer than it works.
    """

    def __init__(self, pid: int) -> None:
        self._pid, self._wall, self._cpu = pid, time.monotonic(), worked(pid)

    def silent(self, patience: float) -> bool:
        """Whether the process hangs, see :func:`hangs`; ``patience`` [s]."""
        return hangs(time.monotonic() - self._wall, worked(self._pid) - self._cpu, patience)


def hangs(wall: float, busy: float, patience: float) -> bool:
    """Whether a process without an answer for ``wall`` seconds hangs: it was busy for ``patience``
    seconds, or it slept.

    A process counts as asleep if it was ``busy`` for less than a hundredth of the time; waiting for
    a core is not hanging. If the system does not report the busy time (NaN), only the wall clock
    counts.
    """
    return wall >= patience and (math.isnan(busy) or busy > patience or busy < 0.01 * wall)


def worked(pid: int) -> float:
    """Processor time of a process and of its ended children [s]; NaN if the system does not report
    it.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return math.nan
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _answers(
    kind: str, first: int, count: int, shared: Path, until: Callable[[], float]
) -> Iterator[dict[str, Any]]:
    """The messages of a worker, and ``lost`` with the reason if it ends too early; ``shared``: a
    folder of all workers.
    """
    worker = Path(__file__).with_name("worker.py")
    order = [sys.executable, *map(str, (worker, kind, first, count, shared))]
    places = [str(Path(__file__).parents[3]), os.environ.get("PYTHONPATH", "")]
    with subprocess.Popen(
        order,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))},
    ) as process:
        assert process.stdout is not None
        pending, patience, heard = b"", BEGIN, _Clock(process.pid)
        with selectors.DefaultSelector() as waiting:
            waiting.register(process.stdout, selectors.EVENT_READ)
            while True:
                ready = waiting.select(min(1.0, max(until() - time.monotonic(), 0.0)))
                silent = not ready and heard.silent(patience)
                if silent or time.monotonic() >= until():
                    process.kill()
                    yield {"lost": "hangs" if silent else "time is up"}
                    return
                if not ready:
                    continue
                heard = _Clock(process.pid)
                data = process.stdout.read1(65536)  # type: ignore[attr-defined]
                if not data:
                    break
                *lines, pending = (pending + data).split(b"\n")
                for line in lines:
                    message = json.loads(line)
                    patience = SLOW.get(kind, HANGS) if "number" in message else patience
                    yield message
        if process.wait():
            yield {"lost": f"ends with {process.returncode}"}


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
