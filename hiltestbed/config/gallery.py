"""Location of the shipped models and scenarios: in the installed package, or in the source tree."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from hiltestbed.errors import InputError

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped(kind: str) -> Path:
    """The folder of shipped `models` or `scenarios`."""
    installed = _PACKAGE / "_data" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def find_scenario(name: str | Path) -> Path:
    """`name` itself if such a path exists, else the shipped scenario (`02-bumper`)."""
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
    """The names of the shipped scenarios; those in subfolders as FOLDER/NAME."""
    root = shipped("scenarios")
    return sorted(
        str(path.relative_to(root).with_suffix(""))
        for path in root.rglob("*.yaml")
        if path.parent.name != "campaigns"
    )


def campaign_names() -> list[str]:
    """The names of the shipped campaigns."""
    return sorted(path.stem for path in (shipped("scenarios") / "campaigns").glob("*.yaml"))


def refuse_unknown(name: str | Path, names: list[str]) -> None:
    """Raises InputError with the shipped ``names`` if ``name`` is no file and none of them."""
    if not find_scenario(name).exists():
        close = get_close_matches(str(name), names, n=1, cutoff=0.4)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise InputError(
            f"{name}: no such file, and nothing of that name is shipped{hint}; allowed is a file, "
            f"or one of {', '.join(names)}"
        )
