"""Actuators that set camber and toe of a wheel: position demanded by the profile to position
reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, evenly, files

RUNS = {
    "EccA": (
        "load-square-wave-full-travel-0.5Hz",
        "load-square-wave-full-travel-1Hz",
        "load-square-wave-half-travel-1Hz",
    ),
    "LinD": (
        "no-pp-sine-sweep-10mm-0.5Hz",
        "no-pp-square-wave-10mm-0.5Hz",
        "no-pp-square-wave-10mm-1Hz",
    ),
}
MILLISECOND = 1e-3  # s
SCALE = {"EccA": np.pi / 180, "LinD": 1e-3}  # rad/deg, m/mm
PERIOD = 0.01  # s


def _records(data: Path, actuator: str) -> list[Record]:
    found = []
    for run in RUNS[actuator]:
        table = np.loadtxt(data / "camber" / actuator / f"{run}.txt")
        # columns: time, target, demand of the profile, position, speed, current
        t, target, _, y = table[:, :4].T
        name = run.replace("load-", "").replace("no-pp-", "")
        u = (target if actuator == "LinD" else table[:, 2]) * SCALE[actuator]
        found.append(evenly(Record(name, t * MILLISECOND, u, y * SCALE[actuator]), PERIOD))
    return found


def _expert(records: Sequence[Record]) -> Predictor:
    """Second order with delay, a speed limit, play, gain and offset."""
    fastest = max(float(np.max(np.abs(np.gradient(r.y, r.t)))) for r in records)
    size = float(np.std(np.concatenate([r.y for r in records])))

    def model(p: Array, record: Record) -> Array:
        return experts.servo(p, record, steps=20)

    bounds = (
        [5.0, 0.1, 0.0, 0.0, 0.1 * fastest, -0.2 * size, 0.8],
        [800.0, 5.0, 0.1, 0.2 * size, 5 * fastest, 0.2 * size, 1.2],
    )
    starts = [
        [w, 0.8, d, 0.01 * size, fastest, 0.0, 1.0] for w in (20, 60, 150) for d in (0.003, 0.02)
    ]
    fits = [experts.fitted(model, records, start, bounds) for start in starts]
    p = experts.best(model, records, fits)
    return lambda record: model(p, record)


def _actuator(actuator: str, title: str, unit: str) -> Device:
    names = [run.replace("load-", "").replace("no-pp-", "") for run in RUNS[actuator]]
    return Device(
        name=f"camber_{actuator.lower()}",
        title=title,
        source=f"github:nicolazande/camber-control, actuators/{actuator}/data/*.txt",
        licence="none stated",
        files=files(f"camber/{actuator}/*"),
        kind="servo",
        units=(unit, unit),
        nominal={},
        fit=tuple(names[:2]),
        left_out=tuple(names[2:]),
        published={},
        records=lambda data: _records(data, actuator),
        expert=_expert,
    )


DEVICES = (
    _actuator("EccA", "eccentric camber actuator under load: demand to angle", "rad"),
    _actuator("LinD", "linear toe actuator without load: target to position", "m"),
)
