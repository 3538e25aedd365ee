"""The door of HILDOCK-1 for entrants in any language: text lines over UDP, one a datagram. An FMU
stands behind the same door, in a process of its own.

hildock 1 start CASE TICKS TICK MASS START SPEED DELAY NOISE   ->  ready CASE
CASE K FORCE                                             ->  CASE K POSITION
end CASE                                                 ->  done CASE [STIFFNESS DAMPING]
bye

Any answer may be `fault` and why the entrant cannot go on.
"""

from __future__ import annotations

import math
import socket
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

from hiltestbed.bench.hildock.fmu import LONGEST, entrant
from hiltestbed.bench.hildock.problem import MASS, SPEED, START, TICK
from hiltestbed.errors import HiltestbedError, InputError

DEADLINE = 1.0  # [s] for one answer


class UdpEntrant:
    """A method behind `udp://host:port`."""

    def __init__(self, url: str, deadline: float = DEADLINE) -> None:
        """deadline: [s] within which each answer has to come.

        Raises:
            InputError: `url` is not of this form.
        """
        try:
            parts = urlsplit(url)
            address = (parts.hostname, parts.port)
        except ValueError:
            parts, address = urlsplit(""), (None, None)
        if parts.scheme != "udp" or None in address or parts.path not in ("", "/"):
            raise InputError(
                f"bench hildock --enter: no address of an entrant (got {url!r}); allowed is "
                f"udp://HOST:PORT, for instance udp://127.0.0.1:5005, or the path of an .fmu"
            )
        self.name, self.deadline, self._case = url, deadline, 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(deadline)
        try:
            self._socket.connect(address)
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"bench hildock --enter: {url} cannot be reached ({error.strerror or error}); "
                f"check host and port"
            ) from error

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        self._case = case
        told = " ".join(f"{v:.17g}" for v in (TICK, MASS, START, SPEED, delay, noise))
        asked = f"hildock 1 start {case} {ticks} {told}"
        self._numbers(self._ask(asked, "the start"), ["ready", str(case)], (0,), "the start")

    def step(self, tick: int, force: float) -> float:
        what = f"tick {tick}"
        words = self._ask(f"{self._case} {tick} {force:.17g}", what)
        return self._numbers(words, [str(self._case), str(tick)], (1,), what)[0]

    def end(self) -> tuple[float, float] | None:
        words = self._ask(f"end {self._case}", "the end")
        found = self._numbers(words, ["done", str(self._case)], (0, 2), "the end")
        return (found[0], found[1]) if found else None

    def close(self) -> None:
        try:
            self._socket.send(b"bye")
        except OSError:
            pass  # it is gone already, which is what `bye` asks for
        finally:
            self._socket.close()

    def _fault(self, what: str, wrong: str) -> HiltestbedError:
        return HiltestbedError(f"bench hildock: {self.name}: case {self._case}, {what}: {wrong}")

    def _ask(self, line: str, what: str) -> list[str]:
        try:
            self._socket.send(line.encode("ascii"))
            answer = self._socket.recv(LONGEST)
        except TimeoutError as error:
            raise self._fault(
                what, f"no answer within {self.deadline:g} s; the entrant stopped or is too slow"
            ) from error
        except OSError as error:
            raise self._fault(
                what, f"{error.strerror or error}; start the entrant first, and keep it running"
            ) from error
        return answer.decode("ascii", "replace").split()

    def _numbers(
        self, words: list[str], begins: list[str], sizes: tuple[int, ...], what: str
    ) -> list[float]:
        if words[:1] == ["fault"]:
            raise self._fault(what, " ".join(words[1:]))
        given = " ".join(words)[:80]
        if words[: len(begins)] != begins or len(words) - len(begins) not in sizes:
            count = " or ".join(map(str, sizes))
            raise self._fault(
                what,
                f"the answer is another one (got {given!r}); allowed is "
                f"{' '.join(begins)!r} followed by {count} numbers",
            )
        try:
            values = [float(w) for w in words[len(begins) :]]
        except ValueError:
            values = [math.nan]
        if not all(map(math.isfinite, values)):
            raise self._fault(
                what, f"the answer is no finite number (got {given!r}); look for 0/0 in the entrant"
            )
        return values


class FmuEntrant(UdpEntrant):
    """A method in an FMU for co-simulation."""

    def __init__(self, file: Path, deadline: float = DEADLINE) -> None:
        """deadline: [s] within which each answer has to come.

        Raises:
            MissingExtra: FMPy is not installed. InputError: the FMU lacks what the page asks for.
        """
        entrant(file)
        command = [sys.executable, "-m", "hiltestbed.bench.hildock.fmu", str(file)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        assert self._process.stdout is not None  # it is a pipe
        with self._process.stdout as said:
            port = said.readline().strip()
        if not port:
            raise HiltestbedError(f"bench hildock: {file}: the process that steps it has ended")
        super().__init__(f"udp://127.0.0.1:{port}", deadline)
        self.name = str(file)

    def close(self) -> None:
        super().close()
        assert self._process.stdin is not None  # it is a pipe
        self._process.stdin.close()
        try:
            self._process.wait(self.deadline)
        except subprocess.TimeoutExpired:  # the FMU does not return
            self._process.kill()
            self._process.wait()


def entered(door: str) -> UdpEntrant:
    """The entrant behind an address, or in an FMU, for `--enter`. Raises InputError."""
    return FmuEntrant(Path(door)) if door.endswith(".fmu") else UdpEntrant(door)
