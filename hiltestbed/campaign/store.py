"""The results folder of a campaign while it runs: a chunk counts as finished once its complete file
has its final name.

campaign.json      the campaign that the folder belongs to, its progress, wall times
chunks/N.parquet   finished cases, N the first of them; deleted when cases.parquet is complete
cases/NNNNNNNN/    what is kept of each case besides its row
cases.parquet      every case in order, byte-identical for any division into chunks
"""

from __future__ import annotations

import copy
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hiltestbed.build import runnable_from
from hiltestbed.campaign.cases import ChunkResult
from hiltestbed.campaign.columns import schema, table
from hiltestbed.campaign.schema import LoadedCampaign
from hiltestbed.config.validation import UserFile, user_files
from hiltestbed.config.yaml_source import dotted, dump_yaml, key_path
from hiltestbed.errors import InputError, printable
from hiltestbed.run_folder.folders import parquet_table
from hiltestbed.run_folder.store import MODELS, keep_file, sync
from hiltestbed.run_folder.versions import provenance
from hiltestbed.scenario import file_sha256, identity, put

ABOUT, CHUNKS, CASES, KEPT, LOCK = "campaign.json", "chunks", "cases.parquet", "cases", ".lock"
CAMPAIGN, SCENARIO = "campaign.yaml", "scenario.yaml"
PARTIAL_ABOUT = f"{ABOUT}.partial"  # what a first write that failed leaves
ROW_GROUP = 16384  # rows of cases.parquet written, and held, at a time
_WALL = b"wall"


def campaign_sha256(campaign: LoadedCampaign) -> str:
    """Hash of all that determines the results: resolved scenario, how it varies, what is kept."""
    spec = campaign.spec.model_dump(mode="json")
    whole = {"scenario": identity(campaign.nominal)}
    whole |= {key: spec[key] for key in ("vary", "design", "keep")}
    for (key, k), (file, kind) in varied_files(campaign).items():
        whole["vary"][key]["values"][k] = file_sha256(file, kind)
    text = json.dumps(whole, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def varied_files(campaign: LoadedCampaign) -> dict[tuple[str, int], tuple[Path, UserFile]]:
    """The user's files among the values of the varied keys, by key and number of the value."""
    found = {}
    for key, variation in campaign.spec.vary.items():
        for k, value in enumerate(variation.values or ()):
            if isinstance(value, str):
                files = user_files(runnable_from(campaign.source, {key: value}))
                if key_path(key) in files:
                    found[key, k] = files[key_path(key)]
    return found


def files_sha256(campaign: LoadedCampaign) -> dict[str, str]:
    """SHA-256 of each of the user's files that the campaign needs, by key and path."""
    files = {dotted(path): entry for path, entry in user_files(campaign.nominal).items()}
    files |= {f"vary.{key}.{k}": entry for (key, k), entry in varied_files(campaign).items()}
    return {f"{key}: {file}": file_sha256(file, kind) for key, (file, kind) in files.items()}


class Store:
    """The folder of one campaign, locked by this process."""

    def __init__(self, folder: Path, campaign: LoadedCampaign) -> None:
        self.folder, self.campaign = folder, campaign
        self.chunks = folder / CHUNKS
        self.name = campaign.spec.name or printable(campaign.path.stem)

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, campaign: LoadedCampaign) -> Iterator[Store]:
        """The store in `folder`, new or resumed. Raises InputError if it is another campaign's, in
        use, or cannot be written.
        """
        refuse_another(folder, campaign)
        store = cls(folder, campaign)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock = (folder / LOCK).open("a")
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be written ({error.strerror}); choose another --out"
            ) from None
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"{folder}: another sweep is at work in it; wait for its end or choose "
                    f"another --out"
                ) from None
            for leftover in folder.rglob("*.partial"):
                shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
            if not (folder / ABOUT).exists():  # first, since it tells whose folder this is
                store.write_about({"status": "running"})
            if not (folder / CAMPAIGN).exists():
                store.write_files()
            store.chunks.mkdir(exist_ok=True)
            yield store

    def write_files(self) -> None:
        """campaign.yaml and scenario.yaml with every override, so that `--case` works anywhere."""
        spec = self.campaign.spec.model_dump(mode="json", exclude_none=True)
        spec |= {"name": self.name, "scenario": SCENARIO, "set": {}}
        shutil.rmtree(self.folder / MODELS, ignore_errors=True)
        data = copy.deepcopy(self.campaign.source.data)
        for path, (file, kind) in user_files(self.campaign.nominal).items():
            put(data, path, keep_file(file, kind, self.folder, dotted(path)))
        for (key, k), (file, kind) in varied_files(self.campaign).items():
            kept = keep_file(file, kind, self.folder, f"vary.{key}.{k}")
            spec["vary"][key]["values"][k] = kept
        write_whole(self.folder / SCENARIO, dump_yaml(data).encode())
        write_whole(self.folder / CAMPAIGN, dump_yaml(spec).encode())

    def write_about(self, more: dict[str, Any]) -> None:
        """campaign.json: the identity of the campaign, and `more`."""
        about = {
            "name": self.name,
            "campaign": str(self.campaign.path.resolve()),
            "campaign_sha256": campaign_sha256(self.campaign),
            "files": files_sha256(self.campaign),
            "versions": provenance(),
            "cases": self.campaign.spec.cases,
        }
        write_whole(self.folder / ABOUT, json.dumps(about | more, indent=2).encode() + b"\n")

    def done(self) -> np.ndarray:
        """For each case, whether it is on disk. A chunk that cannot be read is removed."""
        flags = np.zeros(self.campaign.spec.cases, dtype=bool)
        for file in self.chunks.glob("*.parquet"):
            try:
                flags[_cases_in(file)] = True
            except (pa.ArrowInvalid, OSError):
                file.unlink()
        return flags

    def add(self, result: ChunkResult) -> None:
        """Writes a finished chunk: the files of its cases first, its rows last."""
        for name, content in result.files.items():
            path = self.folder / KEPT / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content)
        about = {_WALL: repr(result.wall).encode()}
        rows = table(self.campaign.spec, result.rows).replace_schema_metadata(about)
        buffer = pa.BufferOutputStream()
        pq.write_table(rows, buffer, compression="zstd")
        file = self.chunks / f"{min(result.cases):08d}.parquet"
        write_whole(file, buffer.getvalue().to_pybytes())

    def walls(self) -> list[dict[str, Any]]:
        """First case, number of cases and wall time [s] of every chunk on disk."""
        found = []
        for file in sorted(self.chunks.glob("*.parquet")):
            with file.open("rb") as opened:
                metadata = pq.read_metadata(opened)
            wall = float((metadata.metadata or {}).get(_WALL, b"0"))
            found.append({"first": int(file.stem), "cases": metadata.num_rows, "wall": wall})
        return found

    def merge(self) -> None:
        """Writes cases.parquet from the chunks, a row group at a time."""
        files = [(file, _cases_in(file)) for file in sorted(self.chunks.glob("*.parquet"))]
        partial = self.folder / f"{CASES}.partial"
        with (
            partial.open("wb") as file,
            pq.ParquetWriter(file, schema(self.campaign.spec), compression="zstd") as writer,
        ):
            for start in range(0, self.campaign.spec.cases, ROW_GROUP):
                writer.write_table(
                    _window(files, start, start + ROW_GROUP), row_group_size=ROW_GROUP
                )
        sync(partial)
        partial.replace(self.folder / CASES)
        sync(self.folder)


def _cases_in(file: Path) -> np.ndarray:
    return parquet_table(file, ["case"])["case"].to_numpy()


def _window(files: list[tuple[Path, np.ndarray]], start: int, end: int) -> pa.Table:
    """The rows of cases [start, end) in case order, from the chunks that contain them."""
    parts = []
    for file, cases in files:
        inside = (cases >= start) & (cases < end)
        if inside.any():
            parts.append(parquet_table(file).filter(pa.array(inside)).replace_schema_metadata(None))
    return pa.concat_tables(parts).sort_by("case").combine_chunks()


def refuse_another(folder: Path, campaign: LoadedCampaign) -> None:
    """Raises InputError if `folder` holds anything but this campaign; the folder is not changed."""
    if not folder.exists() and not folder.is_symlink():
        return
    if not folder.is_dir():
        raise InputError(
            f"{folder}: is not a folder; allowed is a new folder or this campaign's own; choose "
            f"another --out"
        )
    if not (folder / ABOUT).is_file():
        if any(item.name not in (LOCK, PARTIAL_ABOUT) for item in folder.iterdir()):
            raise InputError(
                f"{folder}: is a folder with other things in it; allowed is a new folder or this "
                f"campaign's own"
            )
        return
    about = read_about(folder)
    if about.get("campaign_sha256") != campaign_sha256(campaign):
        before, now = about.get("files") or {}, files_sha256(campaign)
        changed = [name for name, digest in now.items() if before.get(name, digest) != digest]
        if changed:
            raise InputError(
                f"{folder}: was begun with another content of {', '.join(changed)}; undo the "
                f"change, or choose another --out"
            )
        raise InputError(
            f"{folder}: belongs to another campaign (got {about.get('name')!r} from "
            f"{about.get('campaign')}, with another scenario, vary, "
            "design or keep); allowed is a new folder or this campaign's own; choose another --out"
        )
    if about.get("versions") != provenance():
        before, now = about.get("versions") or {}, provenance()
        changed = [name for name, version in now.items() if before.get(name) != version]
        raise InputError(
            f"{folder}: was begun with other versions of {', '.join(changed) or 'its packages'}, "
            f"whose numbers may differ; choose another --out"
        )


def read_about(folder: Path) -> dict[str, Any]:
    """campaign.json of a results folder. Raises InputError if the folder is not one."""
    try:
        about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InputError(f"{folder}: is not a campaign's folder (no readable {ABOUT})") from None
    return about if isinstance(about, dict) else {}


def write_whole(path: Path, content: bytes) -> None:
    """Writes a temporary file, syncs it to disk and renames it: the file is complete or absent."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as handle:
            handle.write(content)
            handle.flush()
            os.fsync(handle.fileno())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from None
    sync(path.parent)
