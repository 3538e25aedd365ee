"""A hydraulic damper of a racing car on a dynamometer (Scotch yoke): displacement to force, 300
Hz.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files, split

MILLIMETRE = 1e-3  # m


def _read(path: Path, name: str) -> Record:
    """The load cell's sign is the opposite of the yoke's: the displacement is turned about."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    stamps = [datetime.fromisoformat(row[0]) for row in rows]
    t = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])
    force, x = (np.array([float(row[column]) for row in rows]) for column in (2, 4))
    sign = -1.0 if np.mean(np.gradient(x) * force) < 0 else 1.0
    return Record(name, t, sign * (x - x.mean()) * MILLIMETRE, force)


def _open(data: Path) -> list[Record]:
    folder = data / "dyno_damper"
    slow = _read(folder / "t1_1_1_18_18_s1_n10_100psi.csv", "slow")
    fast = _read(folder / "t1_1_1_18_18_s6_n10_100psi.csv", "fast")
    return [*split(slow, "slow_a", "slow_b"), *split(fast, "fast_a", "fast_b")]


def _closed(data: Path) -> list[Record]:
    whole = _read(data / "dyno_damper" / "t1_3_3_24_24_s5_n10_100psi.csv", "whole")
    return split(whole, "first", "second")


def _expert(records: Sequence[Record]) -> Predictor:
    """A valve with a knee and a slope of its own each way, gas preload, gas spring, oil's lag."""

    def model(p: Array, record: Record) -> Array:
        preload, spring, tau, knee, *slopes = p
        speed, _ = experts.derivatives(record, 0.05, "u")
        shape = np.tanh(speed / abs(knee))
        out = slopes[0] * speed + slopes[1] * shape
        back = slopes[2] * speed + slopes[3] * shape
        force = preload + spring * record.u + np.where(speed > 0, out, back)
        decay = np.exp(-np.median(np.diff(record.t)) / max(abs(tau), 1e-6))
        before = [decay * record.y[0]]
        return np.asarray(lfilter([1 - decay], [1, -decay], force, zi=before)[0])

    middle = float(np.mean(np.concatenate([r.y for r in records])))
    peak = float(np.max(np.abs(np.concatenate([r.y for r in records]))))
    starts = [[middle, 1.0, 0.02, v, peak, peak / 2, peak, peak / 2] for v in (0.01, 0.04)]
    p = experts.best(model, records, [experts.fitted(model, records, start) for start in starts])
    return lambda record: model(p, record)


SOURCE = "github:LucasDudley/damper_characterization, Test_Data/Phase1_temp_sensitivity/"
# nominal: k x + c v by least squares over the first record to fit
DEVICES = (
    Device(
        name="dyno_damper_open",
        title="hydraulic damper, open valves, 100 psi: displacement to force at two speeds",
        source=SOURCE + "pressure_testing/t1_1_1_18_18_{s1,s6}_n10_100psi.csv",
        licence="none stated",
        files=files("dyno_damper/t1_1_1_*"),
        kind="damper",
        units=("m", "N"),
        nominal={"stiffness": 393.7, "damping": 1617.0},
        fit=("slow_a", "fast_a"),
        left_out=("slow_b", "fast_b"),
        published={},
        records=_open,
        expert=_expert,
    ),
    Device(
        name="dyno_damper_closed",
        title="hydraulic damper, valves nearly closed: displacement to force",
        source=SOURCE + "t1_3_3_24_24_s5_n10_100psi.csv",
        licence="none stated",
        files=files("dyno_damper/t1_3_3_*"),
        kind="damper",
        units=("m", "N"),
        nominal={"stiffness": 6202.0, "damping": 4663.0},
        fit=("first",),
        left_out=("second",),
        published={},
        records=_closed,
        expert=_expert,
    ),
)
