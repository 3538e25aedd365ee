"""Location of compiled kernels: beside the package or in the user's cache, or in a temporary folder
if neither can be written.

Without any such folder Numba refuses to load a cached kernel. Must be set before Numba is imported;
NUMBA_CACHE_DIR overrides it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, MutableMapping
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def settle(
    package: Path,
    environment: MutableMapping[str, str],
    writable: Callable[[Path], bool] | None = None,
) -> None:
    """Set a folder for the kernels of ``package`` if Numba's default folders are not writable."""
    can = writable or _writable
    given = environment.get(VARIABLE)
    if given:
        if not can(Path(given)):
            environment[VARIABLE] = _temporary()
        return
    home = environment.get("HOME")
    cache = Path(
        environment.get("XDG_CACHE_HOME") or (Path(home) / ".cache" if home else "/nonexistent")
    )
    if not can(package / "__pycache__") and not can(cache / "numba"):
        environment[VARIABLE] = _temporary()


def _writable(folder: Path) -> bool:
    """Whether a file can be created in ``folder``, or that below its nearest existing parent."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _temporary() -> str:
    """A private folder of this user, the same for every process; a new one if its name is taken."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"hiltestbed-kernels-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
        if folder.is_symlink() or (
            hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022)
        ):
            # kernels are code: never load them from a folder that another user can write to
            raise OSError(folder)
    except OSError:
        return tempfile.mkdtemp(prefix="hiltestbed-kernels-")
    return str(folder)
