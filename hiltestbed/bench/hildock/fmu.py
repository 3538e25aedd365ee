"""An FMU behind the door of HILDOCK-1: a program that answers its lines with one instance a case.

`python -m hiltestbed.bench.hildock.fmu FILE` prints its port. In a process of its own an FMU may
hang, crash or print without taking the benchmark with it, and is late as any other entrant is.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
from pathlib import Path

import numpy as np

from hiltestbed.devices.cosimulation import CoSimulation, described
from hiltestbed.errors import HiltestbedError

INPUTS, PARAMETERS, FOUND = ("y",), ("h", "m", "x0", "v0", "delay", "noise"), ("k", "c")
LONGEST = 4096  # bytes of one datagram


def entrant(file: Path) -> CoSimulation:
    """The FMU with what the page asks of it: y in, x out, k and c if it has both, and the six
    parameters. Raises MissingExtra; InputError with every fault.
    """
    outputs = {v.name for v in described(file).modelVariables if v.causality == "output"}
    found = FOUND if outputs.issuperset(FOUND) else ()
    return CoSimulation(file, INPUTS, ("x", *found), PARAMETERS)


def serve(file: Path, here: socket.socket) -> None:
    """Answer until `bye`. A stiffness and damping of 0 is none that was identified."""
    fmu, h = entrant(file), 0.0
    outputs = np.zeros(0)
    while True:
        line, peer = here.recvfrom(LONGEST)
        words = line.decode("ascii").split()
        try:
            if words[0] == "bye":
                return
            if words[0] == "hildock":
                fmu.close()  # of a case that diverged
                h = float(words[5])
                fmu.open([float(w) for w in words[5:]])
                answer = f"ready {words[3]}"
            elif words[0] == "end":
                fmu.close()
                known = outputs[1:] if (outputs[1:] > 0.0).any() else ()
                answer = " ".join(["done", words[1], *(f"{v:.17g}" for v in known)])
            else:
                outputs = fmu.step(np.array([float(words[2])]), h)
                answer = f"{words[0]} {words[1]} {outputs[0]:.17g}"
        except HiltestbedError as error:
            fmu.close()
            answer = f"fault {str(error).removeprefix(f'{file}: ')}"
        here.sendto(answer.encode("ascii", "replace"), peer)


def _outlived() -> None:
    """End with the benchmark, whose end closes the standard input, even while the FMU hangs."""
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    threading.Thread(target=_outlived, daemon=True).start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        sys.stdout.write(f"{own.getsockname()[1]}\n")
        sys.stdout.flush()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # an FMU may print what it likes
        serve(Path(sys.argv[1]), own)
