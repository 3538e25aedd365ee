"""What the machine brings: its cores, and whether the inner loops are compiled already.

Numba keeps compiled loops on disk; the first run after an install makes them.
"""

from __future__ import annotations

import os
from pathlib import Path


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cache_folder() -> Path:
    """Where numba keeps the compiled kernel of the figures, which every run needs."""
    from hiltestbed.metrics import _update

    return Path(_update.stats.cache_path or "")


def compiled() -> bool:
    """Whether a run has been made with this installation, so that its kernels are on disk."""
    return any(cache_folder().glob("metrics._update-*.nbc"))
