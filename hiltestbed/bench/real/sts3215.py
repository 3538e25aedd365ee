"""Feetech STS3215 hobby servos on a test stand: angle commanded to angle reached, telemetry at
10 Hz.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files, split

COUNT = 2 * np.pi / 4096  # rad, 12 bits a turn


def _read(data: Path, log: str, motor: int, name: str) -> Record:
    with (data / "sts3215" / f"motor_telemetry_{log}.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row[f"pos ({motor})"]]
    stamps = [datetime.fromisoformat(row["timestamp"].replace("Z", "+00:00")) for row in rows]
    t = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])
    y, u = (
        np.array([float(row[f"{column} ({motor})"]) for row in rows]) * COUNT
        for column in ("pos", "target pos")
    )
    return Record(name, t, u, y)


def _tested(data: Path) -> list[Record]:
    return split(_read(data, "single", 5, "whole"), "first", "second")


def _puller(data: Path) -> list[Record]:
    return [_read(data, "nocomp2", 3, "short"), _read(data, "comp2", 3, "long")]


def _expert(records: Sequence[Record]) -> Predictor:
    """Second order with delay, play, a speed limit and an offset, many steps between two rows."""

    def model(p: Array, record: Record) -> Array:
        return experts.servo(np.append(p, 1.0), record, steps=50)

    offset = np.mean([np.mean(r.y - r.u) for r in records])
    bounds = ([2.0, 0.2, 0.0, 0.0, 0.1, -0.1], [60.0, 3.0, 0.3, 0.1, 10.0, 0.1])
    starts = (
        [w, 1.0, delay, 0.005, speed, offset]
        for w in (10.0, 25.0)
        for delay in (0.02, 0.1)
        for speed in (0.6, 1.5)
    )
    fits = [experts.fitted(model, records, start, bounds) for start in starts]
    p = experts.best(model, records, fits)
    return lambda record: model(p, record)


SOURCE = "github:roboninecom/Measuring-Backlash-in-Popular-UART-Servos, logs/motor_telemetry_*.csv"
DEVICES = (
    Device(
        name="sts3215_tested",
        title="hobby servo under test, pulled by two others: commanded to reached angle",
        source=SOURCE,
        licence="CC BY 4.0",
        files=files("sts3215/motor_telemetry_single.csv"),
        kind="servo",
        units=("rad", "rad"),
        nominal={},
        fit=("first",),
        left_out=("second",),
        published={},
        records=_tested,
        expert=_expert,
    ),
    Device(
        name="sts3215_puller",
        title="hobby servo that pulls another: commanded to reached angle",
        source=SOURCE,
        licence="CC BY 4.0",
        files=files("sts3215/motor_telemetry_*comp2.csv"),
        kind="servo",
        units=("rad", "rad"),
        nominal={},
        fit=("short",),
        left_out=("long",),
        published={},
        records=_puller,
        expert=_expert,
    ),
)
