"""Python that is in no package: a file as a module, a program in a process of its own."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

CLI = ("-m", "hiltestbed.cli")


def module(path: Path) -> ModuleType:
    """The module of a file, run; known by its name, as its data classes need."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None  # noqa: PT018
    found = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = found
    spec.loader.exec_module(found)
    return found


def program(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """Of these arguments of Python, at its end, with its two streams as text."""
    given = {"capture_output": True, "text": True, "errors": "replace", "timeout": 300} | options
    return subprocess.run([sys.executable, *arguments], **given)
