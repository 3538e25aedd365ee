"""Random inputs: ``TRIALS[kind](rng, folder)`` tries one and returns how it ended; an exception is a
fault.
"""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from hiltestbed.campaign.schema import load_campaign
from hiltestbed.campaign.sweep import case_scenario
from hiltestbed.config.check import json_schema, look_at
from hiltestbed.config.gallery import shipped
from hiltestbed.config.yaml_source import dump_yaml, read_source
from hiltestbed.devices import rdt_page, rtde_wire
from hiltestbed.devices.layout import WireRecord, default_layout
from hiltestbed.devices.rsi import Odd, RsiSettings, read_telegram
from hiltestbed.errors import HiltestbedError, InputError
from hiltestbed.measured.formats import read_columns
from hiltestbed.scenario import scenario_from
from hiltestbed.signals import GROUPS
from hiltestbed.simulation import run
from tests.measured import bounce
from tests.measured.data_files import WRITERS
from tests.robustness.values import value_of

SURVIVED, REFUSED, REMARKED = "survived", "refused", "remarked"
Trial = Callable[[Generator, Path], str]
MOST_TICKS, MOST_INSTANTS = 600, 12_000  # limits of a scenario that is run, to save time
ROWS = 40


_schema = cache(json_schema)


def _shipped(rng: Generator) -> dict[str, Any]:
    """The data of a random shipped scenario."""
    files = sorted(shipped("scenarios").glob("*.yaml"))
    return read_source(files[int(rng.integers(len(files)))]).data


def scenario(rng: Generator, folder: Path) -> str:
    """A shipped scenario with some sections replaced by random ones, run if it is valid."""
    return _ended(_changed(rng))


def _ended(data: dict[str, Any]) -> str:
    """How a short run of the scenario ends."""
    try:
        given = scenario_from(data)
        if given.ticks > MOST_TICKS or given.ticks * given.substeps > MOST_INSTANTS:
            shorter = min(MOST_TICKS, MOST_INSTANTS // given.substeps) / given.rate
            given = scenario_from(given.model_dump(mode="json"), set={"duration": shorter})
        status = run(given).summary["status"]
    except InputError:
        return REFUSED
    return SURVIVED if status == "completed" else status


def _changed(rng: Generator) -> dict[str, Any]:
    schema, data = _schema("scenario"), _shipped(rng)
    names = list(schema["properties"])
    for name in rng.choice(names, size=int(rng.integers(1, 5)), replace=False):
        data[str(name)] = value_of(schema["properties"][str(name)], rng, schema)
    data.setdefault("name", "random")
    return data


def extremes(rng: Generator, folder: Path) -> str:
    """A shipped scenario with a few numbers changed by orders of magnitude, run if it is valid."""
    data = _shipped(rng)
    for _ in range(int(rng.integers(1, 4))):
        _stretch(data, rng)
    data["duration"] = min(float(data.get("duration", 3.0)), 0.2)
    return _ended(data)


def _stretch(node: Any, rng: Generator) -> None:
    """Multiply one number below ``node`` by a power of ten, or make it 0."""
    while isinstance(node, (dict, list)) and node:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = keys[int(rng.integers(len(keys)))]
        inner = node[key]
        if isinstance(inner, (int, float)) and not isinstance(inner, bool):
            factor = 0.0 if rng.random() < 0.1 else 10.0 ** int(rng.integers(-9, 10))
            node[key] = float(inner) * factor
            return
        node = inner


def text(rng: Generator, folder: Path) -> str:
    """A scenario file with some bytes changed."""
    files = sorted(shipped("scenarios").glob("*.yaml"))
    path = folder / "text.yaml"
    data = files[int(rng.integers(len(files)))].read_bytes()
    path.write_bytes(mutated(data, rng) if rng.random() < 0.4 else _mistyped(data, rng))
    return REFUSED if look_at(path).faults else SURVIVED


def _mistyped(data: bytes, rng: Generator) -> bytes:
    """``data`` with a few digits and punctuation characters replaced by others."""
    out, typed = bytearray(data), b"0123456789.-+eE,:[]{} #"
    places = [i for i, c in enumerate(out) if c in typed]
    for at in rng.choice(places, size=int(rng.integers(1, 4))):
        out[at] = typed[int(rng.integers(len(typed)))]
    return bytes(out)


def dataset(rng: Generator, folder: Path) -> str:
    """A random dataset file from its schema, mostly with an existing scenario and files."""
    if not (folder / "nominal.yaml").exists():
        bounce.write_dataset(folder, bounce.columns())
    data = value_of(_schema("dataset"), rng)
    if isinstance(data, dict) and rng.random() < 0.8:
        data["scenario"] = "nominal.yaml"
        data["runs"] = [{"file": "run_0.parquet"}] * int(rng.integers(1, 3))
    path = folder / "random.yaml"
    try:
        path.write_text(dump_yaml(data) if data else "", encoding="utf-8")
    except (ValueError, OverflowError):  # not every value can be written as YAML
        return REFUSED
    found = look_at(path)
    return REFUSED if found.faults else REMARKED if found.remarks else SURVIVED


def data_file(rng: Generator, folder: Path) -> str:
    """A data file of one of the formats with some bytes changed."""
    name = list(WRITERS)[int(rng.integers(len(WRITERS)))]
    path = folder / name
    path.write_bytes(mutated(_seed_file(name), rng))
    try:
        read_columns(path, frozenset({"t", "pose_act.pz", "wrench_meas.fz"}))
    except HiltestbedError:
        return REFUSED
    return SURVIVED


@cache
def _seed_file(name: str) -> bytes:
    """A valid file of a format."""
    rng = np.random.default_rng(1)
    table = {"t": np.arange(ROWS) / 1000.0}
    for group in ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp"):
        table |= {name: rng.standard_normal(ROWS) for name in GROUPS[group].columns}
    with tempfile.TemporaryDirectory() as folder:
        WRITERS[name](Path(folder) / name, table)
        return (Path(folder) / name).read_bytes()


def campaign(rng: Generator, folder: Path) -> str:
    """A random campaign file with a shipped scenario; its first case is made if it is valid."""
    data = value_of(_schema("campaign"), rng)
    if not isinstance(data, dict):
        data = {}
    (folder / "base.yaml").write_text(dump_yaml(_shipped(rng)), encoding="utf-8")
    keys = [
        "sensor.delay",
        "approach.velocity.2",
        "mechanism.contact.stiffness",
        "rate",
        "seed",
        "effects",
        "no.such.key",
    ]
    if rng.random() < 0.9:
        data["scenario"] = "base.yaml"
    if rng.random() < 0.8:
        schema = _schema("campaign")
        varied = rng.choice(keys, size=int(rng.integers(1, 3)), replace=False)
        data["vary"] = {
            str(key): value_of(schema["$defs"]["Variation"], rng, schema) for key in varied
        }
    if rng.random() < 0.5:  # a meaningful one, at any scale
        low = 10.0 ** rng.uniform(-6, 6)
        way = (
            {"values": [low, 2 * low]},
            {"uniform": [low, 3 * low]},
            {"log_uniform": [low, 9 * low]},
            {"normal": [low, low]},
        )
        data |= {"vary": {keys[int(rng.integers(3))]: way[int(rng.integers(4))]}, "set": {}}
        data["design"] = {"kind": "grid"}
        if rng.random() < 0.5:
            data["design"] = {"kind": "sobol", "cases": int(rng.integers(1, 2**20))}
    path = folder / "campaign.yaml"
    try:
        path.write_text(dump_yaml(data), encoding="utf-8")
    except (ValueError, OverflowError):
        return REFUSED
    try:
        case_scenario(load_campaign(path), 0)
    except InputError:
        return REFUSED
    return SURVIVED


def packet(rng: Generator, folder: Path) -> str:
    """Valid messages with some bytes changed, for the parsers of the device protocols."""
    which = int(rng.integers(4))
    if which == 0:
        record = WireRecord(default_layout(), "sensor")
        data = mutated(record.pack(np.arange(6.0), 1, 0.5), rng)
        return SURVIVED if record.unpack(data) else REFUSED
    if which == 1:
        try:
            read_telegram(mutated(RsiSettings().answer(np.zeros(6), 123), rng), "Sen", "RKorr")
        except Odd:
            return REFUSED
        return SURVIVED
    if which == 2:
        page = (
            b"<netft><cfgcpf>1000000</cfgcpf><cfgcpt>1000</cfgcpt>"
            b"<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu></netft>"
        )
        try:
            rdt_page.understood(mutated(page, rng), "page", ())
        except HiltestbedError:
            return REFUSED
        return SURVIVED
    here, there = socket.socketpair()
    try:
        stream = rtde_wire.Stream(here)
        there.sendall(mutated(rtde_wire.package(ord("U"), b"\x01" + bytes(48)) * 3, rng))
        rtde_wire.text_of(b"".join(payload for _, payload in stream.receive()))
    except (rtde_wire.Broken, ConnectionError):
        return REFUSED
    finally:
        here.close()
        there.close()
    return SURVIVED


def mutated(data: bytes, rng: Generator) -> bytes:
    """``data`` with bytes flipped, cut, repeated or inserted, or overwritten by extreme numbers."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        if not out:
            break
        at, how = int(rng.integers(len(out))), int(rng.integers(7))
        if how == 0:
            out[at] = int(rng.integers(256))
        elif how == 1:
            out[at] ^= 1 << int(rng.integers(8))
        elif how == 2:
            del out[at:]
        elif how == 3:
            del out[at : at + int(rng.integers(1, 64))]
        elif how == 4:
            out[at:at] = rng.bytes(int(rng.integers(1, 64)))
        elif how == 5:
            part = out[at : at + int(rng.integers(1, 64))]
            out[at:at] = part * int(rng.integers(1, 4))
        else:
            width = int(rng.choice([1, 2, 4, 8]))
            first = (b"\xff", b"\x00", b"\x7f")[int(rng.integers(3))]
            out[at : at + width] = first + (first if first != b"\x7f" else b"\xff") * (width - 1)
    return bytes(out)


TRIALS: dict[str, Trial] = {
    "scenario": scenario,
    "extremes": extremes,
    "text": text,
    "dataset": dataset,
    "file": data_file,
    "campaign": campaign,
    "packet": packet,
}
