"""Progress of long runs on standard error: a bar on a terminal, a line every ten seconds in a log, nothing for short runs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from hiltestbed import interrupt

QUIET = 1.0  # [s] a run that ends within it shows nothing
LOG_INTERVAL = 10.0  # [s]


@contextmanager
def progress_bar(name: str, duration: float) -> Iterator[Callable[[int, int], None]]:
    """A callback (ticks done, ticks in all) for a run of `duration` [s] of simulated time."""
    with _bar_or_lines(name, lambda part: f"{part * duration:.2f} of {duration:g} s simulated") as update:
        yield update


@contextmanager
def count_bar(name: str) -> Iterator[Callable[[int, int], None]]:
    """A callback (parts done, parts in all)."""
    with _bar_or_lines(name, lambda part: f"{100.0 * part:.0f} % done") as update:
        yield update


@contextmanager
def case_bar() -> Iterator[Callable[[int, int, Mapping[str, int]], None]]:
    """A callback (cases done, cases in all, how many ended in which status) that tells rate and time left, from this session alone."""
    start = shown = time.monotonic()
    first: int | None = None
    terminal = sys.stderr.isatty()

    def update(done: int, total: int, statuses: Mapping[str, int]) -> None:
        nonlocal shown, first
        interrupt.check()
        now = time.monotonic()
        ran = sum(statuses.values())
        first = done - ran if first is None else first
        if not terminal and now - shown < LOG_INTERVAL and done < total:
            return
        shown = now
        rate = ran / max(now - start, 1e-9)
        before = f" ({first} from before)" if first else ""
        odd = "".join(f", {count} {status}" for status, count in statuses.items() if status != "completed")
        left = f"{(total - done) / rate:.0f} s left" if rate > 0 else ""
        line = f"{done} of {total} cases{before}, {rate:.1f} a second, {left}{odd}"
        sys.stderr.write(f"\r\x1b[K{line}" if terminal else f"{line}\n")
        sys.stderr.flush()

    try:
        yield update
    finally:
        if terminal and first is not None:
            sys.stderr.write("\n")


@contextmanager
def step_line(name: str) -> Iterator[Callable[[str], None]]:
    """A callback that is told what is being done: one line that changes on a terminal, a line now and then in a log."""
    start = shown = time.monotonic()
    terminal = sys.stderr.isatty()

    def update(step: str) -> None:
        nonlocal shown
        interrupt.check()
        now = time.monotonic()
        if not terminal and now - shown < LOG_INTERVAL:
            return
        shown = now
        line = f"{name}: {now - start:.0f} s: {step}"
        sys.stderr.write(f"\r\x1b[K{line[:110]}" if terminal else f"{line}\n")
        sys.stderr.flush()

    try:
        yield update
    finally:
        if terminal:
            sys.stderr.write("\r\x1b[K")


@contextmanager
def _bar_or_lines(name: str, told: Callable[[float], str]) -> Iterator[Callable[[int, int], None]]:
    start = shown = time.monotonic()
    bar = None

    def update(done: int, total: int) -> None:
        nonlocal bar, shown
        interrupt.check()
        now = time.monotonic()
        if bar is None and now - start > QUIET and done < total and sys.stderr.isatty():
            bar = _bar(name, total)
        if bar is not None:
            bar.update(bar.task_ids[0], completed=done)
        elif now - shown > LOG_INTERVAL:
            shown = now
            left = (now - start) * (total - done) / max(done, 1)
            sys.stderr.write(f"{name}: {told(done / total)}, {left:.0f} s left\n")

    try:
        yield update
    finally:
        if bar is not None:
            bar.stop()


def _bar(name: str, total: int):
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    bar.add_task(name, total=total)
    bar.start()
    return bar
