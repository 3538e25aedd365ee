"""Replay of a failure from a state saved before it."""

from __future__ import annotations

from pathlib import Path

from hiltestbed.errors import InputError
from hiltestbed.loop import Loop
from hiltestbed.run_folder.store import FAILURE, read_run
from hiltestbed.supervision.snapshot import restore


def replay_failure(folder: str | Path) -> tuple[Loop, tuple[int, str, str]]:
    """Run a failed run's loop again from its saved state to its failure.

    Args:
        folder: the folder of a run that diverged or was stopped.

    Returns:
        The loop after the tick that failed, and (tick, status, reason), the same as in the original
        run.

    Raises:
        InputError: the run did not fail, or its failure is not reproduced (other versions than
            those in its summary).
    """
    failed = read_run(folder)
    if failed.failure is None:
        raise InputError(
            f"{folder}: has no {FAILURE}, its status is {failed.summary['status']!r}; only a run "
            f"that failed can be replayed"
        )
    loop = Loop([failed.scenario])
    restore(loop, failed.failure)  # if this is not possible, the loop runs from its start
    while loop.k < failed.scenario.ticks and not loop.trouble:
        loop.step()
    if not loop.trouble:
        raise InputError(
            f"{folder}: did not fail again; it was run with {failed.summary['versions']}"
        )
    return loop, loop.trouble[0]
