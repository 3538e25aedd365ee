"""Three joints of the hobby servo arm SO-101 (Feetech STS3215): angle commanded to angle
reached, about 50 Hz.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files

MOTIONS = ("chirp_sweep", "step_response", "velocity_ramp", "multisine")


def _column(path: Path, joint: int) -> tuple[Array, Array]:
    """Times [s] (stamps are in microseconds) and angles [rad] of one joint of a log whose rows
    hold a JSON list.
    """
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    t = np.array([float(row["timestamp"]) for row in rows]) * 1e-6
    return t, np.array([json.loads(row["positions"])[joint] for row in rows])


def _records(data: Path, joint: int) -> list[Record]:
    found = []
    for motion in MOTIONS:
        folder = data / "so101_servo" / motion
        sent, u = _column(folder / "control.csv", joint)
        t, y = _column(folder / "state_motor.csv", joint)
        held = np.clip(np.searchsorted(sent, t, side="right") - 1, 0, sent.size - 1)
        found.append(Record(motion, t - t[0], u[held], y))
    return found


def _expert(records: Sequence[Record]) -> Predictor:
    """Second order with delay, play, a speed limit and an offset: six numbers, from several
    starts of the bandwidth.
    """

    def model(p: Array, record: Record) -> Array:
        return experts.servo(np.append(p, 1.0), record)

    offset = np.mean([np.mean(r.y - r.u) for r in records])
    bounds = ([1.0, 0.05, 0.0, 0.0, 0.2, -0.3], [200.0, 5.0, 0.2, 0.3, 20.0, 0.3])
    starts = ([w, 0.7, 0.02, 0.02, 1.6, offset] for w in (12.0, 22.0, 40.0))
    fits = [experts.fitted(model, records, start, bounds) for start in starts]
    p = experts.best(model, records, fits)
    return lambda record: model(p, record)


def _joint(name: str, title: str, joint: int) -> Device:
    return Device(
        name=name,
        title=title,
        source="github:isaac-sim2real/sage, output/real/so101/custom/*/{control,state_motor}.csv",
        licence="Apache-2.0",
        files=files("so101_servo/*"),
        kind="servo",
        units=("rad", "rad"),
        nominal={},
        fit=("chirp_sweep", "step_response"),
        left_out=("velocity_ramp", "multisine"),
        published={},
        records=lambda data: _records(data, joint),
        expert=_expert,
    )


DEVICES = (
    _joint("so101_base", "hobby servo, base joint: commanded to reached angle", 0),
    _joint("so101_pitch", "hobby servo, pitch joint, which carries weight", 1),
    _joint("so101_elbow", "hobby servo, elbow joint, which carries weight", 2),
)
