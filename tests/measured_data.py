"""Where measured data lies that does not belong into the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def measured_data(name: str) -> Path:
    """The folder of a set of measured data; skips the test where there is none."""
    root = Path(os.environ.get("HILTESTBED_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (root / name).exists():
        pytest.skip(f"no {name} in {root}; point HILTESTBED_DATA at the folder that holds it")
    return root / name
