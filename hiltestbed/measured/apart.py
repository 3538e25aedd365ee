"""Third-party readers in a separate process: if one crashes, hangs or exhausts memory, only that
process ends, and the file is refused.

The process gets a path and column names, and returns arrays in NumPy's own format, without pickled
objects, so that no code is executed.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Set
from pathlib import Path

import numpy as np

from hiltestbed import plugins
from hiltestbed.config.trial import MEMORY, in_own_process, limit_resources
from hiltestbed.errors import Fault, HiltestbedError, InputError, MissingExtra
from hiltestbed.measured.columns import Columns, unreadable
from hiltestbed.measured.data_format import FORMATS, DataFormat

TIME_LIMIT = 60.0  # [s] per file, plus the same for each GB
COLUMNS = "columns.npz"
ANSWER = "answer.json"


def read_apart(form: DataFormat, path: Path, wanted: Set[str]) -> Columns:
    """What the reader of a format finds. Raises InputError if it crashes or hangs; MissingExtra."""
    limit = TIME_LIMIT * (1.0 + path.stat().st_size / 1e9)
    with tempfile.TemporaryDirectory(prefix="hiltestbed-") as folder:
        order = {
            "format": form.model_dump(mode="json"),
            "path": str(path.absolute()),
            "wanted": sorted(wanted),
            "folder": folder,
            "given": str(path),
        }
        try:
            ended = in_own_process("hiltestbed.measured.apart", order, limit)
        except subprocess.TimeoutExpired:
            do = "it is damaged, or too large: export it again, as Parquet"
            raise unreadable(path, f"is not read within {limit:.0f} s", do) from None
        answer, status = Path(folder) / ANSWER, ended.returncode
        if not answer.is_file():
            how = f"signal {-status}" if status < 0 else f"exit status {status}"
            do = "it is damaged: copy or export it again"
            raise unreadable(path, f"crashes its reader ({how})", do)
        return _answer(json.loads(answer.read_text(encoding="utf-8")), Path(folder) / COLUMNS)


def _answer(answer: dict, file: Path) -> Columns:
    if "faults" in answer:
        raise InputError([Fault(**fault) for fault in answer["faults"]])
    if "error" in answer:
        raise HiltestbedError(answer["error"])
    with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as arrays:
        for part in ("data", "clock"):
            names = answer[part]
            answer[part] = {name: arrays[f"{part}.{i}"] for i, name in enumerate(names)}
    answer |= {part: tuple(answer[part]) for part in ("names", "notes")}
    return Columns(**answer)


def _serve() -> None:
    """Read the file that standard input names, and write the result to the folder that it names."""
    order = json.loads(sys.stdin.buffer.read())
    if order["format"]["kind"] not in FORMATS:
        plugins.load()
    form = FORMATS[order["format"]["kind"]].model_validate(order["format"], strict=False)
    folder, given = Path(order["folder"]), order["given"]
    try:
        limit_resources(AS=MEMORY)
        columns = form.read(Path(order["path"]), frozenset(order["wanted"]))
        answer = vars(columns) | {"data": list(columns.data), "clock": list(columns.clock)}
        arrays = {f"data.{i}": a for i, a in enumerate(columns.data.values())}
        arrays |= {f"clock.{i}": a for i, a in enumerate(columns.clock.values())}
        np.savez(folder / COLUMNS, **arrays)  # type: ignore[arg-type]
    except InputError as error:
        faults = error.faults or (Fault(given, None, None, "", str(error)),)
        answer = {"faults": [vars(fault) | {"file": given} for fault in faults]}
    except MissingExtra as error:
        answer = {"error": str(error).replace(order["path"], given)}
    except MemoryError:
        what = "asks for more memory than there is; it is damaged, or cut it to the run"
        answer = {"faults": [vars(Fault(given, None, None, "", what))]}
    partial = folder / (ANSWER + ".partial")
    partial.write_text(json.dumps(answer), encoding="utf-8")
    partial.replace(folder / ANSWER)


if __name__ == "__main__":
    _serve()
