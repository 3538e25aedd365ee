"""Third-party readers in a separate process: if one crashes, hangs or exhausts memory, only that
process ends, and the file is refused.

The process gets a path and column names, and returns arrays in NumPy's own format, without pickled
objects, so that no code is executed.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Set
from pathlib import Path

import numpy as np

from hiltestbed import plugins
from hiltestbed.errors import Fault, HiltestbedError, InputError, MissingExtra
from hiltestbed.measured.columns import Columns, unreadable
from hiltestbed.measured.data_format import FORMATS, DataFormat

TIME_LIMIT = 60.0  # [s] per file, plus the same for each GB
MEMORY = 4 << 30  # [byte] limit of a reader's address space
COLUMNS = "columns.npz"
ANSWER = "answer.json"


def read_apart(form: DataFormat, path: Path, wanted: Set[str]) -> Columns:
    """The result of the reader of a format for a file. Raises InputError if it finds nothing
    usable, crashes or hangs; MissingExtra.
    """
    limit = TIME_LIMIT * (1.0 + path.stat().st_size / 1e9)
    with tempfile.TemporaryDirectory(prefix="hiltestbed-") as folder:
        order = json.dumps(
            {
                "format": form.model_dump(mode="json"),
                "path": str(path.absolute()),
                "wanted": sorted(wanted),
                "folder": folder,
                "given": str(path),
            }
        )
        try:
            ended = subprocess.run(
                [sys.executable, "-m", "hiltestbed.measured.apart"],
                input=order.encode(), capture_output=True, timeout=limit, env=_environment(),
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise unreadable(
                path,
                f"is not read within {limit:.0f} s",
                "it is damaged, or too large: export it again, as Parquet",
            ) from None
        answer = Path(folder) / ANSWER
        if not answer.is_file():
            how = (
                f"signal {-ended.returncode}"
                if ended.returncode < 0
                else f"exit status {ended.returncode}"
            )
            raise unreadable(
                path, f"crashes its reader ({how})", "it is damaged: copy or export it again"
            )
        return _answer(json.loads(answer.read_text(encoding="utf-8")), Path(folder) / COLUMNS)


def _environment() -> dict[str, str]:
    """This environment, with the import path of this process."""
    here = str(Path(__file__).parents[2])
    return os.environ | {
        "PYTHONPATH": os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    }


def _answer(answer: dict, file: Path) -> Columns:
    if "faults" in answer:
        raise InputError([Fault(**fault) for fault in answer["faults"]])
    if "error" in answer:
        raise HiltestbedError(answer["error"])
    with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as arrays:
        data = {name: arrays[f"data.{i}"] for i, name in enumerate(answer["data"])}
        clock = {name: arrays[f"clock.{i}"] for i, name in enumerate(answer["clock"])}
    return Columns(
        tuple(answer["names"]),
        data,
        clock,
        answer["units"],
        answer["missing"],
        answer["others"],
        tuple(answer["notes"]),
        answer["topics"],
    )


def _serve() -> None:
    """Read the file that standard input names, and write the result to the folder that it names."""
    order = json.loads(sys.stdin.buffer.read())
    if order["format"]["kind"] not in FORMATS:
        plugins.load()
    form = FORMATS[order["format"]["kind"]].model_validate(order["format"], strict=False)
    folder, given = Path(order["folder"]), order["given"]
    try:
        _limit_memory()
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
        answer = {
            "faults": [
                vars(
                    Fault(
                        given,
                        None,
                        None,
                        "",
                        "asks for more memory than there is; it is damaged, or cut it to the run",
                    )
                )
            ]
        }
    partial = folder / (ANSWER + ".partial")
    partial.write_text(json.dumps(answer), encoding="utf-8")
    partial.replace(folder / ANSWER)


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # no such limit on this system
        return
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(
        resource.RLIMIT_AS, (MEMORY if most == resource.RLIM_INFINITY else min(MEMORY, most), most)
    )


if __name__ == "__main__":
    _serve()
