"""Stability verdicts of scenario files, kept in the user's cache: a verdict takes longer than all
other checks of a file, and most files are checked more than once.

A verdict is kept under a hash of all that it is computed from: the resolved scenario with the
content of its files, the code, the shipped models and the versions of the libraries. The folder can
be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from hiltestbed import plugins
from hiltestbed.run_folder.versions import provenance
from hiltestbed.scenario import identity, load_scenario


def stability_of_file(
    path: str | Path, set: Mapping[str, Any] | None = None
) -> dict[str, Any] | None:
    """:func:`hiltestbed.analysis.stability.stability` of a valid scenario file, with dotted keys
    overridden.
    """
    scenario = load_scenario(path, set)
    kept = None
    if not plugins.loaded():  # what a user's module imports is not part of the hash
        cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
        depends = json.dumps([identity(scenario), provenance()], sort_keys=True)
        key = hashlib.sha256(depends.encode()).hexdigest()
        kept = cache / "hiltestbed" / "stability" / f"{key}.json"
        with suppress(OSError, ValueError):
            return json.loads(kept.read_text(encoding="utf-8"))
    from hiltestbed.analysis.stability import stability

    found = stability(scenario)
    with suppress(OSError):  # without a folder that can be written, it is computed each time
        if kept is not None:
            _write(kept, json.dumps(found))
    return found


def _write(file: Path, text: str) -> None:
    """Under a name of its own first: a process that reads meanwhile finds all of it or nothing."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(
        "w", dir=file.parent, suffix=".part", encoding="utf-8", delete=False
    ) as part:
        part.write(text)
    Path(part.name).replace(file)
