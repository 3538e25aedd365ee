"""Whether the inner loops are compiled already: numba keeps them on disk, and the first run after an install makes them."""

from __future__ import annotations

from pathlib import Path


def cache_folder() -> Path:
    """Where numba keeps the compiled kernel of the figures, which every run needs."""
    from hiltestbed.metrics import _update

    return Path(_update.stats.cache_path)


def compiled() -> bool:
    """Whether a run has been made with this installation, so that its kernels are on disk."""
    return any(cache_folder().glob("metrics._update-*.nbc"))
