"""Records of a long benchmark, saved to disk as they arrive, so that the same command resumes an
interrupted benchmark.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable
from hashlib import sha256
from pathlib import Path
from typing import Any

from hiltestbed.errors import InputError
from hiltestbed.run_folder.versions import provenance


def made_by() -> str:
    """SHA-256 of what makes a record: package, test equipment and versions of dependencies."""
    seen = sha256(json.dumps(provenance(), sort_keys=True).encode())
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        seen.update(file.read_bytes())
    return seen.hexdigest()


class Kept:
    """Records by key in a file of one JSON object per line, the first of which identifies the
    program that made them.

    Records of another program are discarded, and so is a truncated last line.
    """

    def __init__(self, path: Path | None, key_of: Callable[[dict[str, Any]], Hashable]) -> None:
        """``path``: of the file, None to save nothing. ``key_of``: unique key of a record."""
        self._path, self._key_of = path, key_of
        self.records: dict[Hashable, dict[str, Any]] = {}
        if path is None:
            return
        lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
        program = {"made_by": made_by()}
        if lines and _parsed(lines[0]) == program:
            self.records = {
                key_of(record): record
                for line in lines[1:]
                if (record := _parsed(line)) is not None
            }
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_name(path.name + ".new")
            beside.write_text(
                "".join(json.dumps(one) + "\n" for one in (program, *self.records.values())),
                encoding="utf-8",
            )
            beside.replace(path)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); choose another --out"
            ) from None

    def add(self, record: dict[str, Any]) -> None:
        """Add a record, and save it."""
        self.records[self._key_of(record)] = record
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")

    def done(self) -> None:
        """Delete the file, once all records are in the result."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None
