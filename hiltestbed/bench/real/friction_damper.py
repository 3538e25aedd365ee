"""A band brake with play in its linkage: displacement to force, sines at 0.5 Hz and 1 Hz at two
tensions of the band.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files, split

INCH = 0.0254  # m, exact
KIP = 4448.2216  # N, 1000 lbf


def _read(data: Path, file: str, name: str) -> Record:
    path = data / "friction_damper" / f"{file}.json"
    t, x, force = np.array(json.loads(path.read_text())["data"], dtype=float)[:, :3].T
    return Record(name, t - t[0], x * INCH, force * KIP)


def _halves(data: Path, tension: str) -> list[Record]:
    runs = [_read(data, f"{f}{tension}tension", f) for f in ("0.5Hz", "1Hz")]
    return [part for run in runs for part in split(run, f"{run.name}_a", f"{run.name}_b")]


def _earthquakes(data: Path) -> list[Record]:
    files = {f: f"{f}36lbtension1amplitude" for f in ("0.5Hz", "1Hz")}
    files |= {quake: quake for quake in ("KocaeliDBE", "ImperialValleyDBE")}
    return [_read(data, file, name) for name, file in files.items()]


def _expert(records: Sequence[Record]) -> Predictor:
    """One slider behind a spring with play; beside it a dashpot, a spring and an offset.

    Six numbers, from several starts of stiffness and play. A record that starts below a twentieth
    of the greatest force starts in the middle of the play: the idle linkage carries that much.
    """
    stroke = np.ptp(np.concatenate([r.u for r in records]))
    force = np.concatenate([r.y for r in records])
    idle = 0.05 * np.max(np.abs(force))

    def model(p: Array, record: Record) -> Array:
        stiffness, limit, play, damping, spring, offset = p
        speed, _ = experts.derivatives(record, 0.02, "u")
        first = record.y[0] - offset if abs(record.y[0]) > idle else 0.0
        slider = np.array([stiffness, limit, limit, play])
        beside = damping * speed + spring * record.u + offset
        return experts.slider(slider, record.u, first) + beside

    limit = np.quantile(np.abs(force), 0.8)
    starts = [
        [limit * k / stroke, limit, w * stroke, 0.01 * limit, 0.1 * limit / stroke, force.mean()]
        for k in (4, 12, 25)
        for w in (0.05, 0.2)
    ]
    p = experts.best(model, records, [experts.fitted(model, records, start) for start in starts])
    return lambda record: model(p, record)


def _tension(name: str, tension: str, nominal: dict[str, float]) -> Device:
    return Device(
        name=name,
        title=f"band brake with play, {tension[:-2]} lb of tension: displacement to force",
        source="github:ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash, "
        f"data/dataset-1/characterization datasets/{{0.5Hz,1Hz}}{tension}tension.json",
        licence="CC BY-SA 4.0",
        files=files(f"friction_damper/*{tension}tension.json"),
        kind="damper",
        units=("m", "N"),
        nominal=nominal,
        fit=("0.5Hz_a", "0.5Hz_b"),
        left_out=("1Hz_a", "1Hz_b"),
        published={},
        records=lambda data: _halves(data, tension),
        expert=_expert,
    )


# k x + c v by least squares over the first record to fit
DEVICES = (
    _tension("friction_damper_80lb", "80lb", {"stiffness": 365.1e3, "damping": 176.7e3}),
    _tension("friction_damper_25lb", "25lb", {"stiffness": 189.4e3, "damping": 111.2e3}),
    Device(
        name="friction_damper_36lb",
        title="band brake with play, 36 lb of tension: fitted to a sine, left out are earthquakes",
        source="github:ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash, data/dataset-2/"
        "{characterization datasets/*36lbtension1amplitude,earthquake profiles/*DBE}.json",
        licence="CC BY-SA 4.0",
        files=files("friction_damper/*36lb*") | files("friction_damper/*DBE.json"),
        kind="damper",
        units=("m", "N"),
        nominal={"stiffness": 493.7e3, "damping": 223.6e3},
        fit=("0.5Hz",),
        left_out=("1Hz", "KocaeliDBE", "ImperialValleyDBE"),
        published={},
        records=_earthquakes,
        expert=_expert,
    ),
)
