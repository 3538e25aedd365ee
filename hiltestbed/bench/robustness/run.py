"""`hiltestbed bench robustness [--for MINUTES]`: trials at random, in processes that may crash or hang."""

from __future__ import annotations

import json
import selectors
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from hiltestbed.bench.result import BenchResult
from hiltestbed.bench.robustness.trials import REFUSED, REMARKED, SURVIVED, TRIALS
from hiltestbed.report import Report

QUICK, LONG = 0.5, 15.0  # [min] where nothing is asked for
BATCH = 40  # trials a process, of those that take long
HANGS = 60.0  # [s] without an answer, from which a trial hangs
BEGIN = 180.0  # [s] until the first answer: kernels may have to be compiled
CONTAINED = {"file"}  # kinds whose crash ends a process of its own when it is done in earnest
SHOWN = 50  # faults that are listed
Progress = Callable[[int, int], None]


@dataclass
class Tally:
    """What became of the trials of one kind."""

    tried: int = 0
    wall: float = 0.0
    ended: Counter[str] = field(default_factory=Counter)
    faults: dict[str, dict[str, Any]] = field(default_factory=dict)

    def fault(self, kind: str, number: int, place: str, text: str) -> None:
        """Count a fault; the first of each place is kept."""
        self.ended["failed"] += 1
        entry = self.faults.setdefault(place, {"kind": kind, "number": number, "fault": text, "times": 0})
        entry["times"] += 1


def robustness(quick: bool = False, progress: Progress | None = None, minutes: float | None = None) -> BenchResult:
    """Trials of every kind in turn until the time is up."""
    limit = 60.0 * (minutes if minutes is not None else QUICK if quick else LONG)
    start, tallies = time.monotonic(), {kind: Tally() for kind in TRIALS}
    following = dict.fromkeys(TRIALS, 0)
    while time.monotonic() - start < limit:
        kind = min(TRIALS, key=lambda k: tallies[k].wall)
        if following[kind] and tallies[kind].wall == 0.0:
            break  # nothing can be run at all
        following[kind] = _batch(kind, following[kind], tallies[kind], start + limit)
        if progress:
            progress(round(min(time.monotonic() - start, limit)), round(limit))
    return _result(tallies)


def _batch(kind: str, first: int, tally: Tally, until: float) -> int:
    """Runs trials from ``first`` on in one process; returns the number of the next."""
    count = BATCH * (25 if kind in ("packet", "text", "campaign") else 1)
    begin, following, current = time.monotonic(), first, None
    for told in _answers(kind, first, count, until):
        if "begin" in told:
            current = told["begin"]
        elif "lost" in told:
            if current is not None and told["lost"] != "time is up":
                following = current + 1
                tally.tried += 1
                if kind in CONTAINED and told["lost"] != "hangs":
                    tally.ended["contained"] += 1
                else:
                    tally.fault(kind, current, told["lost"], f"the process {told['lost']}")
        else:
            following, current = told["number"] + 1, None
            tally.tried += 1
            if "fault" in told:
                tally.fault(kind, told["number"], told["place"], told["fault"])
            else:
                tally.ended[told["ended"]] += 1
    tally.wall += max(time.monotonic() - begin, 1e-3)
    return following


def _answers(kind: str, first: int, count: int, until: float) -> Iterator[dict[str, Any]]:
    """What a worker says, and ``lost`` with how where it ends before it is done."""
    order = [sys.executable, "-m", "hiltestbed.bench.robustness.worker", kind, str(first), str(count)]
    with subprocess.Popen(order, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        pending, patience = b"", BEGIN
        with selectors.DefaultSelector() as waiting:
            waiting.register(process.stdout, selectors.EVENT_READ)
            while True:
                ready = waiting.select(min(patience, max(until - time.monotonic(), 0.0)))
                if not ready:
                    process.kill()
                    yield {"lost": "time is up" if time.monotonic() >= until else "hangs"}
                    return
                data = process.stdout.read1(65536)  # type: ignore[attr-defined]
                if not data:
                    break
                *lines, pending = (pending + data).split(b"\n")
                for line in lines:
                    told = json.loads(line)
                    patience = HANGS if "number" in told else patience
                    yield told
        if process.wait():
            yield {"lost": f"ends with {process.returncode}"}


def _result(tallies: dict[str, Tally]) -> BenchResult:
    records = [
        {"kind": kind, "tried": t.tried, "survived": t.ended[SURVIVED], "refused": t.ended[REFUSED], "remarked": t.ended[REMARKED],
         "stopped": t.ended["stopped"] + t.ended["diverged"], "contained": t.ended["contained"], "failed": t.ended["failed"],
         "wall": t.wall, "other": {k: n for k, n in t.ended.items() if k.startswith("taken")}}
        for kind, t in tallies.items()
    ]  # fmt: skip
    faults = [fault for t in tallies.values() for fault in t.faults.values()]
    tried, failed = sum(t.tried for t in tallies.values()), sum(t.ended["failed"] for t in tallies.values())
    summary = {"tried": tried, "failed": failed, "faults": faults, "kinds": {r["kind"]: r for r in records}}
    report = Report("Robustness")
    report.lead(f"{tried} trials at random, {failed} of which ended in something else than a result or a clear refusal.")
    columns = ("kind", "tried", "survived", "refused", "remarked", "stopped", "contained", "failed")
    report.table(list(columns), [[str(r[c]) for c in columns] for r in records])
    if faults:
        rows = [[f["kind"], str(f["number"]), str(f["times"]), f["fault"]] for f in faults[:SHOWN]]
        report.heading("Faults")
        report.table(["kind", "trial", "times", "fault"], rows)
    lines = [(r["kind"], ", ".join(f"{r[c]} {c}" for c in columns[1:] if r[c])) for r in records]
    lines += [("failed", f"{failed} of {tried}")]
    return BenchResult("robustness", records, summary, report, lines)
