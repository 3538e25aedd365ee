"""The errors a caller may want to tell apart; everything hiltestbed raises on purpose is a HiltestbedError.

The exit status of the command line follows the class: InputError 2, Diverged and Stopped 3, any other 1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


def printable(text: str) -> str:
    """``text`` with control characters written out: names in a file may hold what a terminal would act on."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


class HiltestbedError(Exception):
    """Base of every error that hiltestbed raises on purpose."""

    exit_status = 1


@dataclass(frozen=True)
class Fault:
    """One fault of one input: where it stands, which key, and what is wrong (got ...); what is allowed.

    `file` may also be a place on the command line (`--set KEY`), which has neither line nor column (both None).
    """

    file: str
    line: int | None
    column: int | None
    key: str
    message: str

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}:{self.column or 1}"
        return printable(f"{place}: {self.key}: {self.message}" if self.key else f"{place}: {self.message}")


class InputError(HiltestbedError):
    """What was handed in cannot be used; `faults` holds every fault that was found, one line each in the message."""

    exit_status = 2

    def __init__(self, faults: Iterable[Fault] | Fault | str) -> None:
        if isinstance(faults, str):
            self.faults: tuple[Fault, ...] = ()
            super().__init__(faults)
            return
        self.faults = (faults,) if isinstance(faults, Fault) else tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


class Diverged(HiltestbedError):
    """A simulation left the finite numbers: when [s], which quantity, and the folder whose state replays it."""

    exit_status = 3

    def __init__(self, time: float, quantity: str, state: Path | None = None) -> None:
        self.time, self.quantity, self.state = time, quantity, state
        replay = f"; the state before it lies in {state}" if state is not None else ""
        super().__init__(f"diverged at t = {time:.6f} s: {quantity}{replay}")


class Stopped(HiltestbedError):
    """A safety limit ended a simulation: when [s] and which limit."""

    exit_status = 3

    def __init__(self, time: float, reason: str) -> None:
        self.time, self.reason = time, reason
        super().__init__(f"stopped at t = {time:.6f} s: {reason}")


class MissingExtra(HiltestbedError):
    """An optional dependency is not installed; the message is the install line."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs an optional dependency; install it with: pip install 'hiltestbed[{extra}]'")
