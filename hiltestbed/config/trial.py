"""A foreign MJCF is compiled in a process of its own first: if MuJoCo hangs, crashes or exhausts
memory over it, only that process ends, and the model is refused.

The process gets the model on its standard input and answers on its standard output.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hiltestbed.config.mjcf import PackedMjcf
from hiltestbed.errors import InputError

# chosen: compiling 200,000 triangles, the most that a surface may have, takes 3 s and 0.5 GB
TIME = 10  # [s] of the processor
PATIENCE = 120.0  # [s] of the clock, with other work on the machine
MEMORY = 4 << 30  # [byte] of address space
LARGEST = 1e9  # in SI units: beyond the size of any number of a mechanism or a rig
BODY = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_pos",
    "geom_size",
    "geom_pos",
    "dof_armature",
)


def refuse_unfit(file: Path, model: PackedMjcf) -> tuple[str, ...]:
    """Raise InputError if the ``model`` in an MJCF ``file`` does not compile within the limits, or
    compiles to numbers that no body has; returns MuJoCo's remarks on it.
    """
    answer = _tried(model.text, tuple(model.files.items()), str(file))
    if "fault" in answer:
        raise InputError(f"{file}: {answer['fault']}")
    return tuple(answer["remarks"])


def in_own_process(
    module: str, order: dict[str, Any], patience: float
) -> subprocess.CompletedProcess[bytes]:
    """Run ``python -m module`` with ``order`` as JSON on its standard input, and with the import
    path of this process. Raises TimeoutExpired after ``patience`` [s].
    """
    paths = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    # threads of a linear algebra library reserve address space
    environment = {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, "-m", module], input=json.dumps(order).encode(), capture_output=True,
        timeout=patience, env=os.environ | environment,
    )  # fmt: skip


def limit_resources(**limits: int) -> None:
    """Limit resources of this process, by the names of their limits: AS [byte], CPU [s]."""
    try:
        import resource
    except ImportError:  # no such limits on this system
        return
    for name, most in limits.items():
        what = getattr(resource, f"RLIMIT_{name}")
        hard = resource.getrlimit(what)[1]
        soft = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (soft, hard))


@lru_cache(maxsize=64)
def _tried(text: str, files: tuple[tuple[str, bytes], ...], file: str) -> dict:
    hexed = [[name, content.hex()] for name, content in files]
    order = {"text": text, "files": hexed, "file": file}
    try:
        ended = in_own_process("hiltestbed.config.trial", order, PATIENCE)
    except subprocess.TimeoutExpired:
        return {"fault": f"MuJoCo does not compile it within {PATIENCE:.0f} s; simplify it"}
    try:
        return json.loads(ended.stdout.splitlines()[-1])
    except (ValueError, IndexError):
        return {
            "fault": f"MuJoCo does not compile it within {TIME} s of processor time and "
            f"{MEMORY >> 30} GB of memory (status {ended.returncode}); simplify it"
        }


def _serve() -> None:
    """Compile the model on standard input, and answer what was found."""
    import warnings

    order = json.loads(sys.stdin.buffer.read())
    files = {name: bytes.fromhex(content) for name, content in order["files"]}
    limit_resources(CPU=TIME, AS=MEMORY)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        answer = _compiled(PackedMjcf(order["text"], files), order["file"])
    said = dict.fromkeys(" ".join(str(w.message).split()) for w in caught)
    sys.stdout.write("\n" + json.dumps({"remarks": list(said)} | answer) + "\n")


def _compiled(packed: PackedMjcf, file: str) -> dict:
    import mujoco

    try:
        model = packed.spec().compile()
    except ValueError as error:
        reason = error
        try:  # the same fault, with its line in the user's file
            mujoco.MjSpec.from_file(file).compile()
        except ValueError as original:
            reason = original
        return {"fault": f"is not a model that MuJoCo compiles: {' '.join(str(reason).split())}"}
    except (RuntimeError, mujoco.FatalError, MemoryError) as error:
        return {"fault": f"is not a model that MuJoCo compiles: {' '.join(str(error).split())}"}
    unfit = _unfit(model)
    return {"fault": unfit} if unfit else {}


def _unfit(model: object) -> str:
    """Which number of a compiled ``model`` no body has; empty: none."""
    for name in sorted(dir(model), key=lambda name: name not in BODY):  # those of the file first
        array = None if name.startswith("_") else getattr(model, name)
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            continue
        bad = np.isnan(array) if name not in BODY else ~(np.abs(array) <= LARGEST)
        if bad.any():
            row = int(np.argwhere(bad)[0][0])
            kind, what = name.split("_", 1)
            of = {"body": "body", "geom": "geom", "jnt": "joint", "site": "site"}.get(kind)
            owner = getattr(model, of)(row).name if of else ""
            value = array[row] if array.ndim == 1 else array[row].tolist()
            return (
                f"the {what} of {of or kind} {owner or row!r} is {value}; give finite numbers "
                f"below {LARGEST:g}"
            )
    return ""


if __name__ == "__main__":
    _serve()
