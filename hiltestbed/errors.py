"""The errors that a caller may want to distinguish; everything that hiltestbed raises on purpose is
a HiltestbedError.

The exit status of the command line follows the class: InputError 2, any other 1; a run that
diverged, was stopped or has no reference ends with 3.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any


def printable(text: str) -> str:
    """``text`` with control characters and lone surrogates escaped: names in a file may contain
    terminal escape sequences, and those of files bytes that are no UTF-8.

    The escapes are JSON's, so that JSON remains JSON.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text)


class HiltestbedError(Exception):
    """Base of every error that hiltestbed raises on purpose."""

    exit_status = 1


@dataclass(frozen=True)
class Fault:
    """One fault of one input: its place, its key, and the message "what is wrong (got ...); what is
    allowed".

    `file` may also be a command-line option (`--set KEY`), which has neither line nor column (both
    None).
    """

    file: str
    line: int | None
    column: int | None
    key: str
    message: str

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}:{self.column or 1}"
        return printable(
            f"{place}: {self.key}: {self.message}" if self.key else f"{place}: {self.message}"
        )


class InputError(HiltestbedError):
    """The input cannot be used; `faults` has every fault found, a line each in the message."""

    exit_status = 2

    def __init__(self, faults: Iterable[Fault] | Fault | str) -> None:
        if isinstance(faults, str):
            self.faults: tuple[Fault, ...] = ()
            super().__init__(faults)
            return
        self.faults = (faults,) if isinstance(faults, Fault) else tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


class MissingExtra(HiltestbedError):
    """An optional dependency is not installed; the message is the install line."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(
            f"{what} needs an optional dependency; install it with: pip install "
            f"'hiltestbed[{extra}]'"
        )


def of_extra(module: str, what: str, extra: str) -> Any:
    """The ``module``, which ``what`` needs and the ``extra`` installs. Raises MissingExtra."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtra(what, extra) from None
