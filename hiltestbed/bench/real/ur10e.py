"""Joints of a robot arm UR10e whose axes do not lift: current to angle, each moved alone on a
sine of 10 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Device, Predictor, Record, evenly, files, split

PERIOD = 0.01  # s, the log has gaps of 8 to 12 ms
PARTS = ("first", "second", "third")
# seconds after the log's start between which the joint alone follows its sine
SPANS = {1: (5.0, 59.5), 5: (8.0, 61.0), 6: (8.0, 64.0)}
# UR10E_parameters.txt of the source: (motor's gain [N m/A], inertia [kg m^2], friction: viscous
# [N m s/rad], Coulomb [N m], offset [N m]). The inertia of joint 1 is the whole stretched arm's
# (first base parameter), those of 5 and 6 are the motors' alone.
PUBLISHED = {
    1: (10.0, 16.018, 21.2560, 12.5484, 0.1961),
    5: (9.48, 0.2342, 2.4909, 2.6905, -0.0096),
    6: (10.1232, 0.4365, 3.0256, 2.2979, 0.0425),
}


def _records(data: Path, joint: int) -> list[Record]:
    table = np.loadtxt(data / "ur10e" / f"ur-20_01_22-joint_{joint}.csv", delimiter=",")
    t = table[:, 0] - table[0, 0]
    begin, end = SPANS[joint]
    rows = (t >= begin) & (t <= end)
    # columns: time, six angles, six speeds, six currents, six currents expected
    whole = Record("whole", t[rows], table[rows, 12 + joint], table[rows, joint])
    return split(evenly(whole, PERIOD), *PARTS)


def _expert(records: Sequence[Record]) -> Predictor:
    """Inertia per gain, viscous and dry friction: regression, then the simulated path."""
    start = experts.drive_regression(records, window=0.3, slow=0.02)
    model = experts.drive
    p = experts.fitted(lambda p, r: model(p, r, window=0.1), records, start)
    p = experts.best(lambda p, r: model(p, r, window=0.1), records, [start, p])
    return lambda record: model(p, record, window=0.1)


def _joint(joint: int) -> Device:
    gain, mass, viscous, coulomb, offset = PUBLISHED[joint]
    return Device(
        name=f"ur10e_joint_{joint}",
        title=f"robot arm, joint {joint}: current of its motor to its angle, open loop",
        source="github:shamilmamedov/dynamic_calibration, "
        f"dataset_ur10e/jointwise_motion/ur-20_01_22-joint_{joint}.csv; "
        "parameters: UR10E_parameters.txt",
        licence="none stated",
        files=files(f"ur10e/ur-20_01_22-joint_{joint}.csv"),
        kind="drive",
        units=("A", "rad"),
        nominal={"mass": mass, "gain": gain},
        fit=PARTS[:1],
        left_out=PARTS[1:],
        published={"gain": gain, "viscous": viscous, "coulomb": coulomb, "offset": offset},
        records=lambda data: _records(data, joint),
        expert=_expert,
    )


DEVICES = (_joint(1), _joint(5), _joint(6))
