"""What takes long, or depends on the wall clock: only ``./check --all`` runs it."""

from __future__ import annotations

import os
from typing import Any

import pytest

ALL = bool(os.environ.get("HILTESTBED_SLOW"))
SLOW = pytest.mark.skipif(not ALL, reason="takes long, or depends on the wall clock; ./check --all")


def slow(*values: Any) -> Any:
    """A further case of a law that another case shows in ./check."""
    return pytest.param(*values, marks=SLOW)
