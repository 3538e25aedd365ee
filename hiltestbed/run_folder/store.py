"""The run folder: scenario.yaml, summary.json, trace.parquet, report.html, recording.rrd. A folder
that exists is complete.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hiltestbed import plugins
from hiltestbed.config.mjcf import packed
from hiltestbed.config.validation import UserFile, user_files
from hiltestbed.config.yaml_source import dotted, dump_yaml
from hiltestbed.errors import Fault, HiltestbedError, InputError
from hiltestbed.frames import Array
from hiltestbed.run_folder.folders import parquet_table
from hiltestbed.run_folder.result import Run
from hiltestbed.scenario import Scenario, load_scenario, put, resolved
from hiltestbed.signals import RunTrace, about_column, groups
from hiltestbed.supervision.snapshot import flatten, unflatten

if TYPE_CHECKING:
    import pyarrow as pa

SUMMARY, SCENARIO, TRACE, RECORDING, FAILURE = (
    "summary.json",
    "scenario.yaml",
    "trace.parquet",
    "recording.rrd",
    "failure.npz",
)
MODELS = "models"


@contextmanager
def whole_folder(path: Path, mark: str = SUMMARY) -> Iterator[Path]:
    """A temporary folder beside ``path``; it is renamed to ``path`` if the block succeeds, and
    removed otherwise.

    An earlier result at ``path``, recognised by its file ``mark``, is replaced; anything else there
    is refused.

    Raises:
        InputError: ``path`` exists and holds something else, or cannot be written.
    """
    refuse_foreign(path, mark)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=".hiltestbed.", suffix=".partial", dir=path.parent))
    except OSError as error:
        raise _not_writable(path, error.strerror) from None
    try:
        yield beside
        for file in beside.rglob("*"):
            if file.is_file():
                sync(file)
        beside.chmod(0o755)
        _swap(beside, path)
    except OSError as error:
        shutil.rmtree(beside, ignore_errors=True)
        raise HiltestbedError(
            f"{path}: cannot be written ({error.strerror or error}); nothing is left of it; with "
            f"more space, or another --out, the same command works"
        ) from error
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise


def refuse_foreign(path: Path, mark: str = SUMMARY) -> None:
    """Refuse to replace anything that is not a result of hiltestbed, and what cannot be replaced as
    a whole.

    Raises:
        InputError: ``path`` is a file, a folder with other things in it, one that is in use as a
            whole, or in a folder that cannot be written.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError:
        if not path.is_absolute():
            raise _not_writable(path, "the working folder has been removed") from None
        here = Path(path.anchor)
    if path.is_dir():
        if any(path.iterdir()) and not (path / mark).exists():
            raise InputError(
                f"{path}: is a folder with other things in it; allowed is a new folder or an "
                f"earlier result; choose another --out"
            )
        whole = path.resolve()
        if os.path.ismount(whole) or here.is_relative_to(whole):
            use = "a mount point" if os.path.ismount(whole) else "the working folder, or holds it"
            raise InputError(
                f"{path}: is {use}, and cannot be replaced as a whole; allowed is a new folder or "
                f"an earlier result; choose a folder in it, --out {path / 'result'}"
            )
    elif path.exists() or path.is_symlink():
        raise InputError(
            f"{path}: is not a folder; allowed is a new folder or an earlier result; choose "
            f"another --out"
        )
    above = next(folder for folder in (here / path).parents if folder.exists())
    if not above.is_dir():
        raise _not_writable(path, f"{above} is not a folder")
    if not os.access(above, os.W_OK | os.X_OK):
        raise _not_writable(path, f"{above} is read-only")


def _not_writable(path: Path, why: str | None) -> InputError:
    return InputError(f"{path}: cannot be written ({why}); choose another --out")


def _swap(beside: Path, path: Path) -> None:
    """Move the finished folder into place, an earlier one away first: never a mixture."""
    if path.exists():
        old = Path(tempfile.mkdtemp(prefix=".hiltestbed.", suffix=".old", dir=path.parent))
        os.rename(path, old / path.name)
        os.rename(beside, path)
        shutil.rmtree(old, ignore_errors=True)
    else:
        os.rename(beside, path)


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, written to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_run(run: Run, path: str | Path, *, rerun: bool = True, report: bool = True) -> Path:
    """Write the run folder and return its path; ``rerun=False`` leaves recording.rrd out,
    ``report=False`` report.html.

    Raises:
        InputError: the folder cannot be written, or holds something else.
    """
    path = Path(path)
    with whole_folder(path) as folder:
        data = resolved(run.scenario)  # the user's models are copied, and their keys name copies
        for key, (file, kind) in user_files(run.scenario).items():
            put(data, key, keep_file(file, kind, folder, dotted(key)))
        (folder / SCENARIO).write_text(dump_yaml(data), encoding="utf-8")
        (folder / SUMMARY).write_text(
            json.dumps(run.summary, indent=2, allow_nan=False) + "\n", encoding="utf-8"
        )
        if run.trace is not None:
            write_trace(run.trace, folder / TRACE)
            if rerun:
                from hiltestbed.viewer import write_recording

                write_recording(folder / RECORDING, run)
        if report:
            from hiltestbed.report.run import REPORT, run_report

            run_report(run).write(folder / REPORT)
        if run.failure is not None:
            np.savez(folder / FAILURE, **flatten(run.failure))  # type: ignore[arg-type]
    return path


def keep_file(file: Path, kind: UserFile, folder: Path, name: str) -> str:
    """Copy a user's file, an MJCF file with every file that it names, into ``folder``, below
    ``name``; returns the path of the copy in it.
    """
    below = Path(MODELS) / name
    if kind.mjcf:
        packed(file).write(folder / below, file.name)
    else:
        (folder / below).mkdir(parents=True)
        shutil.copyfile(file, folder / below / file.name)
    return str(below / file.name)


def read_run(path: str | Path) -> Run:
    """The run in a run folder.

    Raises:
        InputError: it is not a run folder.
    """
    path = Path(path)
    if not (path / SUMMARY).is_file():
        raise InputError(
            f"{path}: is not a run folder (no {SUMMARY}); allowed is a folder that `hiltestbed "
            f"run --out` wrote"
        )
    summary: dict[str, Any] = json.loads((path / SUMMARY).read_text(encoding="utf-8"))
    trace = read_trace(path / TRACE) if (path / TRACE).is_file() else None
    failure = None
    if (path / FAILURE).is_file():
        with np.load(path / FAILURE) as arrays:
            failure = unflatten(dict(arrays))
    return Run(_scenario_of(path, summary), summary, trace, failure)


def _scenario_of(path: Path, summary: dict[str, Any]) -> Scenario:
    """The scenario of a run folder. Raises InputError, which names plugins that are not loaded."""
    try:
        return load_scenario(path / SCENARIO)
    except InputError as error:
        lacking = [name for name in summary.get("plugins", {}) if name not in plugins.loaded()]
        if not lacking:
            raise
        options = " ".join(f"--plugin {name}" for name in lacking)
        hint = (
            f"was made with a plugin that is not loaded; give {options} (or its current "
            f"path), from Python hiltestbed.load_plugins"
        )
        raise InputError([*error.faults, Fault(str(path), None, None, "", hint)]) from None


def write_trace(trace: RunTrace, path: Path) -> None:
    """One row per tick; fields have unit, frame, meaning. The same rows give the same bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = trace.columns()
    fields = []
    for name, values in columns.items():
        kind = pa.bool_() if values.dtype == bool else pa.float64()
        fields.append(pa.field(name, kind, metadata=about_column(name, trace.joints, trace.moving)))
    arrays = [
        pa.Array.from_buffers(field.type, len(v), [None, _buffer(v)])
        for field, v in zip(fields, columns.values(), strict=True)
    ]
    with path.open("wb") as file:  # Arrow itself opens only files whose names are UTF-8
        pq.write_table(
            pa.table(arrays, schema=pa.schema(fields)),
            file,
            compression="zstd",
            compression_level=1,
            use_dictionary=False,
        )


def _buffer(values: np.ndarray) -> pa.Buffer:
    """A column as Arrow has it; ``pa.array`` does the same but imports pandas: 0.25 s."""
    import pyarrow as pa

    return pa.py_buffer(
        np.packbits(values, bitorder="little")
        if values.dtype == bool
        else np.ascontiguousarray(values, dtype=float)
    )


def read_trace(path: Path) -> RunTrace:
    """The trace in a Parquet file."""
    table = parquet_table(path)
    columns: dict[str, Array] = {name: table[name].to_numpy() for name in table.column_names}
    joints = tuple(
        _unit(table, name) for name in table.column_names if name.startswith("slider_cmd.")
    )
    moving = tuple(
        (name.removeprefix("joint."), _unit(table, name))
        for name in table.column_names
        if name.startswith("joint.")
    )
    found = groups(joints, moving).values()
    present = [g for g in found if g.columns and g.columns[0] in columns]
    data = {g.name: np.stack([columns[c] for c in g.columns], axis=-1) for g in present}
    return RunTrace(columns["t"], data, columns["contact"].astype(bool), joints, moving)


def _unit(table: pa.Table, column: str) -> str:
    """The unit of a column of a trace file."""
    return ((table.schema.field(column).metadata or {}).get(b"unit", b"m")).decode()
