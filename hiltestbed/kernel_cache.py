"""Where compiled kernels are kept: beside the package or in the user's cache, and in a temporary folder where neither can be written.

Without any of them Numba refuses to load a kernel that is to be kept. Set before Numba is imported; NUMBA_CACHE_DIR overrides it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, MutableMapping
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def settle(package: Path, environment: MutableMapping[str, str], writable: Callable[[Path], bool] | None = None) -> None:
    """Name a folder in ``environment`` for the kernels of ``package`` where those that Numba would take cannot be written."""
    can = writable or _writable
    given = environment.get(VARIABLE)
    if given:
        if not can(Path(given)):
            environment[VARIABLE] = _temporary()
        return
    home = environment.get("HOME")
    cache = Path(environment.get("XDG_CACHE_HOME") or (Path(home) / ".cache" if home else "/nonexistent"))
    if not can(package / "__pycache__") and not can(cache / "numba"):
        environment[VARIABLE] = _temporary()


def _writable(folder: Path) -> bool:
    """Whether a file can be made in ``folder``, or the folder in the nearest one that exists."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _temporary() -> str:
    """A folder of this user's alone, the same for every process; a new one where something else has taken its name."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"hiltestbed-kernels-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
        if folder.is_symlink() or (hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022)):
            raise OSError(folder)  # kernels are code: none is loaded from a folder that another user may write
    except OSError:
        return tempfile.mkdtemp(prefix="hiltestbed-kernels-")
    return str(folder)
