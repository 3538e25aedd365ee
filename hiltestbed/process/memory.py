"""A limit of the address space (`ulimit -v`), which libraries meet in their own ways: an import
that fails, a message from C, a signal, an error that names anything but memory.
"""

from __future__ import annotations

import subprocess
import sys

from hiltestbed.errors import HiltestbedError

LIBRARIES = "numpy, scipy.linalg, numba, mujoco, pinocchio, pyarrow, matplotlib.pyplot, rerun"


def limit() -> int | None:
    """[bytes] the limit of this process; None without one."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return None
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if soft == resource.RLIM_INFINITY else soft


def refuse_too_small() -> None:
    """Raises HiltestbedError if a limit is too low for the libraries: a process tries them."""
    if limit() is None:
        return
    done = subprocess.run(
        [sys.executable, "-c", f"import {LIBRARIES}"], capture_output=True, check=False
    )
    if done.returncode or done.stderr:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        raise HiltestbedError(sentence(lines[-1] if lines else "the process was ended"))


def sentence(error: object) -> str:
    """What to do about an error under the limit."""
    return (
        f"failed while the address space is limited to {(limit() or 0) / 1e9:.3g} GB (ulimit -v): "
        f"{' '.join(str(error).split())}; use ulimit -v unlimited, or a larger limit"
    )
