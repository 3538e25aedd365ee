"""HSM150: two motors on a common shaft; torque of the drive to angle, steps from one torque to
another.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Device, Predictor, Record, files

STEPS = ("neg_0.04", "neg_0.045", "pos_0.06", "pos_0.065")


def _records(data: Path) -> list[Record]:
    found = []
    for run in (f"{step}_{number}" for number in (1, 2, 3) for step in STEPS):
        table = scipy.io.loadmat(data / "hsm150" / f"idf_{run}.mat")["data"]
        t, _, y, _, u = table[:, :5].astype(float).T
        found.append(Record(run, t - t[0], np.ascontiguousarray(u), np.ascontiguousarray(y)))
    return found


def _expert(records: Sequence[Record]) -> Predictor:
    """Inertia, viscous friction and dry friction of its own size each way, by the simulated
    path.
    """
    # the catalogue's inertia 1.2e-4 kg m^2; friction from the speeds of the two levels of a run
    start = [1 / 1.2e-4, 0.7, 150.0, 150.0]
    p = experts.fitted(lambda p, r: experts.drive(np.abs(p), r, window=0.0), records, start)
    return lambda record: experts.drive(np.abs(p), record, window=0.0)


DEVICE = Device(
    name="hsm150",
    title="two-motor drive: torque to angle, open loop",
    source="github:malik-robert/HSM150-data, Data/Identification/idf_*.mat",
    licence="none stated",
    files=files("hsm150/*"),
    kind="drive",
    units=("N m", "rad"),
    nominal={"mass": 1.2e-4, "gain": 1.0},  # J in the files, from the catalogue
    fit=tuple(f"{step}_1" for step in STEPS),
    left_out=tuple(f"{step}_{number}" for number in (2, 3) for step in STEPS),
    published={"mass": 1.2e-4, "viscous": 7.03e-5},  # J and B in the files, from the catalogue
    records=_records,
    expert=_expert,
)
DEVICES = (DEVICE,)
