"""What the program writes to the terminal: control characters escaped, whoever writes them.

Names in a file may contain terminal escape sequences, and a path bytes that are no UTF-8. Within
:func:`escaped`, both standard streams show such characters as text, for every writer: the program,
a library, Python's warnings. Only :func:`console` and :func:`overwrite` reach the terminal itself,
and escape what they are given.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import IO, TYPE_CHECKING, Any

from hiltestbed.errors import HiltestbedError, printable

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderResult

CLEAR = "\r\x1b[K"  # back to the start of the line, and clear it


class Results(io.TextIOBase):
    """Standard output."""

    def __init__(self, plain: Any) -> None:
        self._plain = plain

    def write(self, text: str) -> int:
        """Raises HiltestbedError if it cannot be written, BrokenPipeError if nobody reads."""
        with self._kept():
            self._plain.write(text)
        return len(text)

    def flush(self) -> None:
        with self._kept():
            self._plain.flush()

    def fileno(self) -> int:
        return self._plain.fileno()

    def isatty(self) -> bool:
        return self._plain.isatty()

    def writable(self) -> bool:
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._plain.encoding

    @contextmanager
    def _kept(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            _discard(self._plain)
            self._lost(error)

    def _lost(self, error: OSError) -> None:
        if isinstance(error, BrokenPipeError):
            raise error
        raise HiltestbedError(
            f"standard output cannot be written ({error.strerror}); the files that the command "
            f"writes are not affected"
        ) from None


class Messages(Results):
    """Standard error: a message that cannot be written is dropped, and the work goes on."""

    def _lost(self, error: OSError) -> None:
        pass


class Escaped(Results):
    """A stream with control characters escaped; no terminal: nothing is coloured or moved."""

    def __init__(self, whole: Results) -> None:
        super().__init__(whole)
        self.whole = whole

    def write(self, text: str) -> int:
        self.whole.write(printable(text))
        return len(text)

    def flush(self) -> None:
        self.whole.flush()

    def isatty(self) -> bool:
        return False


@contextmanager
def escaped() -> Iterator[None]:
    """Both standard streams escaped; a closed one is replaced by the null device."""
    for number in range(3):
        # otherwise the next file that is opened takes the number of the closed stream, and its
        # messages
        with contextlib.suppress(OSError):
            os.fstat(number)
            continue
        os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    before = sys.stdout, sys.stderr
    out, err = (
        stream or os.fdopen(number, "w", closefd=False) for number, stream in enumerate(before, 1)
    )
    for stream in (out, err):
        if isinstance(stream, io.TextIOWrapper):
            # a terminal without UTF-8 gets a replacement mark for other characters
            stream.reconfigure(errors="replace")
    sys.stdout, sys.stderr = Escaped(Results(out)), Escaped(Messages(err))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _discard(stream: Any) -> None:
    """Lead a stream and its unwritten text to the null device: Python flushes again at exit."""
    with contextlib.suppress(OSError):  # a stream without a file has nothing to lead elsewhere
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, stream.fileno())
        os.close(null)


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform in ("win32", "darwin") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def terminal() -> bool:
    """Whether standard error is a terminal, so that a line on it can be overwritten."""
    return _plain(sys.stderr).isatty()


def overwrite(line: str, end: str = "") -> None:
    """Write ``line`` to standard error over the one there; below it without a terminal."""
    stream = _plain(sys.stderr)
    stream.write(f"{CLEAR}{printable(line)}{end}" if stream.isatty() else f"{printable(line)}\n")
    stream.flush()


def console(stream: IO[str] | None = None) -> Console:
    """A rich console (left out: standard output) that escapes what it shows, not its colours."""
    from rich.console import Console, RenderHook

    class Escape(RenderHook):
        def process_renderables(
            self, renderables: list[ConsoleRenderable]
        ) -> list[ConsoleRenderable]:
            return [EscapedParts(part) for part in renderables]

    found = Console(file=_plain(stream or sys.stdout), highlight=False)
    found.push_render_hook(Escape())
    return found


class EscapedParts:
    """A rich renderable with the text of its segments escaped."""

    def __init__(self, whole: ConsoleRenderable) -> None:
        self._whole = whole

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        from rich.segment import Segment

        segments: Iterable[Segment] = console.render(self._whole, options)
        for segment in segments:
            yield segment if segment.control else Segment(printable(segment.text), segment.style)


def _plain(stream: Any) -> Any:
    return stream.whole if isinstance(stream, Escaped) else stream
