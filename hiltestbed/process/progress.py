"""Progress of long runs on standard error: a bar on a terminal, a line every ten seconds in a log,
nothing for short runs.

The remaining time is estimated from the pace of the work itself: the clock starts with the first
part that is reported, so that imports and compiling do not count, and a single slow part (a kernel
compiled at the first touch) does not affect the pace.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

from hiltestbed.errors import printable
from hiltestbed.process import interrupt
from hiltestbed.process.output import console, overwrite, terminal

QUIET = 1.0  # [s] a shorter run shows nothing
LOG_INTERVAL = 10.0  # [s]
REMEMBERED = 32  # updates that determine the pace
FEWEST_INTERVALS = 3  # intervals, at least, for an estimate
LARGEST_SPREAD = 0.5  # largest 95 % interval of the pace, relative to it, for an estimate
Update = Callable[[float, float], None]


class UnitTime:
    """How long a unit of work takes, from the latest updates."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._before: tuple[float, float] | None = None
        self._paces: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)  # seconds, work

    def update(self, done: float) -> None:
        """Record that ``done`` units are done now."""
        now = self._clock()
        if self._before is not None and done > self._before[1]:
            self._paces.append((now - self._before[0], done - self._before[1]))
        if self._before is None or done > self._before[1]:
            self._before = (now, done)

    def left(self, work: float) -> float | None:
        """Seconds that ``work`` more units take; None while there are too few data.

        Uses the mean of the latest intervals. A single interval longer than five times the median
        for its work is left out; several of them count. If the intervals vary much, more are
        awaited until the 95 % interval of the mean is within :data:`LARGEST_SPREAD` of it.
        """
        if len(self._paces) < FEWEST_INTERVALS:
            return None
        middle = statistics.median(seconds / units for seconds, units in self._paces)
        slow = [part for part in self._paces if part[0] > 5.0 * middle * part[1]]
        usual = [part for part in self._paces if len(slow) != 1 or part is not slow[0]]
        pace = sum(seconds for seconds, _ in usual) / sum(units for _, units in usual)
        free = len(usual) - 1
        if free < 1:
            return None
        spread = math.sqrt(
            sum((seconds - pace * units) ** 2 for seconds, units in usual) * len(usual) / free
        )
        student = 2.0 + 9.0 / free**2  # Student's t for 95 %, accurate to 0.2
        return (
            work * pace
            if student * spread <= LARGEST_SPREAD * sum(seconds for seconds, _ in usual)
            else None
        )


def labelled(progress: Callable[[str], None] | None, label: str) -> Callable[[str], None] | None:
    """The callback for the parts of a step."""
    return (lambda text: progress(f"{label}: {text}")) if progress else None


def time_left_text(seconds: float | None, of: str = "") -> str:
    """`, 40 s left`, or nothing if unknown; of: of what, such as `in this step`."""
    if seconds is None:
        return ""
    time_left = f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
    return f", {time_left} left{f' {of}' if of else ''}"


def progress_bar(name: str, duration: float) -> AbstractContextManager[Update]:
    """A callback (ticks done, total ticks) for a run of `duration` [s] of simulated time."""
    return _bar_or_lines(name, lambda part: f"{part * duration:.2f} of {duration:g} s simulated")


def count_bar(name: str) -> AbstractContextManager[Update]:
    """A callback (work done, total work), in any unit of equal effort."""
    return _bar_or_lines(name, lambda part: f"{100.0 * part:.0f} % done")


class _Line:
    """When a line of progress is due: always on a terminal, otherwise every LOG_INTERVAL."""

    def __init__(self) -> None:
        self.start = self._shown = time.monotonic()
        self.on_terminal = terminal()

    def due(self) -> bool:
        interrupt.check()
        now = time.monotonic()
        due = self.on_terminal or now - self._shown >= LOG_INTERVAL
        self._shown = now if due else self._shown
        return due


@contextmanager
def case_bar() -> Iterator[Callable[[int, int, Mapping[str, int]], None]]:
    """A callback (cases done, total cases, number of cases per status) that shows rate and
    remaining time, of this session alone.
    """
    first: int | None = None
    line, pace = _Line(), UnitTime()

    def update(done: int, total: int, statuses: Mapping[str, int]) -> None:
        nonlocal first
        first = done - sum(statuses.values()) if first is None else first
        pace.update(done)
        if not line.due() and done < total:
            return
        one = pace.left(1.0)
        rate = f", {1.0 / one:.1f} a second" if one else ""
        before = f" ({first} from before)" if first else ""
        left = time_left_text(pace.left(total - done)) if done < total else ""
        odd = "".join(
            f", {count} {status}" for status, count in statuses.items() if status != "completed"
        )
        overwrite(f"{done} of {total} cases{before}{rate}{left}{odd}")

    try:
        yield update
    finally:
        if line.on_terminal and first is not None:
            sys.stderr.write("\n")


@contextmanager
def step_line(name: str) -> Iterator[Callable[[str], None]]:
    """A callback that takes the current step: an updated line, or occasional lines in a log."""
    line = _Line()

    def update(step: str) -> None:
        if line.due():
            text = f"{name}: {time.monotonic() - line.start:.0f} s: {step}"
            overwrite(text[:110] if line.on_terminal else text)

    try:
        yield update
    finally:
        if line.on_terminal:
            overwrite("")


@contextmanager
def _bar_or_lines(name: str, describe: Callable[[float], str]) -> Iterator[Update]:
    line, bar, pace = _Line(), None, UnitTime()

    def update(done: float, total: float) -> None:
        nonlocal bar
        pace.update(done)
        due = line.due() and done < total
        if bar is None and due and line.on_terminal and time.monotonic() - line.start > QUIET:
            bar = _bar(name, total)
        if bar is None and (line.on_terminal or not due):
            return
        left = time_left_text(pace.left(total - done))
        if bar is not None:
            bar.update(bar.task_ids[0], completed=done, left=left.lstrip(", "))
        else:
            sys.stderr.write(f"{name}: {describe(done / total)}{left}\n")

    try:
        yield update
    finally:
        if bar is not None:
            bar.stop()


def _bar(name: str, total: float):
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[left]}"),
    )
    bar = Progress(*columns, console=console(sys.stderr), transient=True)
    bar.add_task(escape(printable(name)), total=total, left="")
    bar.start()
    return bar
