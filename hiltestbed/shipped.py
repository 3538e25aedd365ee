"""Where the models and scenarios lie that come with hiltestbed: in the installed package, or in the source tree."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def shipped(kind: str) -> Path:
    """The folder of shipped `models` or `scenarios`."""
    installed = _PACKAGE / "_data" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def find_scenario(name: str | Path) -> Path:
    """`name` itself when such a path exists, else the shipped scenario of that name (`head_on`, `scenarios/head_on.yaml`)."""
    path = Path(name)
    if path.exists() or path.is_absolute():
        return path
    candidate = shipped("scenarios") / (path.name if path.suffix else path.name + ".yaml")
    return candidate if path.parent.name in ("", "scenarios") and candidate.is_file() else path


def scenario_names() -> list[str]:
    """The names of the shipped scenarios."""
    return sorted(path.stem for path in shipped("scenarios").glob("*.yaml"))
