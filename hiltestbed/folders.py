"""Names of result folders, and what else is written into them."""

from __future__ import annotations

from contextvars import ContextVar
from pathlib import Path

FIGURES_APART: ContextVar[bool] = ContextVar("figures_apart", default=False)  # figures of a report beside it as well, as PNG and SVG


def is_file(path: Path) -> bool:
    """Whether a file is there; False for a name that no file system takes."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def free_folder(path: Path) -> Path:
    """`path`, or the first of path-2, path-3, ... that does not exist."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}-{number}")
    return candidate


def safe_name(name: str) -> str:
    """A scenario's or a campaign's name as the name of a folder."""
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in name).strip(".-")[:100] or "unnamed"
