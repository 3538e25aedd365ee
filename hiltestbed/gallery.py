"""Where the models and scenarios lie that come with hiltestbed: in the installed package, or in the source tree."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def shipped(kind: str) -> Path:
    """The folder of shipped `models` or `scenarios`."""
    installed = _PACKAGE / "_data" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def find_scenario(name: str | Path) -> Path:
    """`name` itself when such a path exists, else what is shipped under that name (`02-bumper`, `scenarios/02-bumper.yaml`)."""
    path = Path(name)
    if path.exists() or path.is_absolute():
        return path
    below = Path(*path.parts[1:]) if path.parts[:1] == ("scenarios",) else path
    below = below if below.suffix else below.with_name(below.name + ".yaml")
    for candidate in (shipped("scenarios") / below, shipped("scenarios") / "campaigns" / below):
        if ".." not in below.parts and candidate.is_file():
            return candidate
    return path


def scenario_names() -> list[str]:
    """The names of the shipped scenarios."""
    return sorted(path.stem for path in shipped("scenarios").glob("*.yaml"))
