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


def _records(data: Path, tension: str) -> list[Record]:
    found = []
    for frequency in ("0.5Hz", "1Hz"):
        path = data / "friction_damper" / f"{frequency}{tension}tension.json"
        t, x, force = np.array(json.loads(path.read_text())["data"], dtype=float)[:, :3].T
        found.append(Record(frequency, t - t[0], x * INCH, force * KIP))
    return [*split(found[0], "0.5Hz_a", "0.5Hz_b"), *split(found[1], "1Hz_a", "1Hz_b")]


def _expert(records: Sequence[Record]) -> Predictor:
    """One slider behind a spring with play, a dashpot and an offset: six numbers, from several
    starts of the play.
    """

    def model(p: Array, record: Record) -> Array:
        speed, _ = experts.derivatives(record, 0.02, "u")
        force = experts.slider(p[0], p[1], p[2], record.u, record.y[0] - p[4])
        return force + p[3] * speed + p[4] + p[5] * record.u

    spread = np.concatenate([r.y for r in records])
    stroke = np.ptp(np.concatenate([r.u for r in records]))
    limit = np.quantile(np.abs(spread), 0.8)
    starts = [
        [limit * k / stroke, limit, w * stroke, 0.0, spread.mean(), 0.0]
        for k in (4, 12)
        for w in (0.1, 0.4)
    ]
    fits = [experts.fitted(model, records, start) for start in starts]
    p = experts.best(model, records, fits)
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
        records=lambda data: _records(data, tension),
        expert=_expert,
    )


# k x + c v by least squares over the first half of the record at 0.5 Hz
DEVICES = (
    _tension("friction_damper_80lb", "80lb", {"stiffness": 365.1e3, "damping": 176.7e3}),
    _tension("friction_damper_25lb", "25lb", {"stiffness": 189.4e3, "damping": 111.2e3}),
)
