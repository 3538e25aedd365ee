"""Motors on their own, force or current to position: EMPS, a carriage on a ball screw (and the loop
around it); three joints of a robot arm UR10e that do not lift, each moved alone on a sine of 10 s;
HSM150, two motors on a common shaft, in steps from one torque to another.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, AxisRecord, Device, Predictor, evenly, files, split

# --- EMPS

# 1/s, position loop, `kp` in the files
KP = 160.18
# Simulation_EMPS.m; the asymmetry of the dry friction is given there as an offset, -3.1648 N
EMPS = {"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}


def _emps_records(data: Path, loop: bool) -> list[AxisRecord]:
    found = []
    for name, file in (("steps", "DATA_EMPS.mat"), ("pulses", "DATA_EMPS_PULSES.mat")):
        table = scipy.io.loadmat(data / "emps" / file)
        keys = ("t", "vir", "qm", "qg", "gtau")
        t, vir, qm, qg, gtau = (table[key].ravel().astype(float) for key in keys)
        found.append(AxisRecord(name, t - t[0], qg if loop else gtau * vir, qm))
    return [found[0], *split(found[1], "pulses_a", "pulses_b")]


def _emps_expert(records: Sequence[AxisRecord]) -> Predictor:
    """Mass, viscous and dry friction each way: by regression first, then by the simulated path."""
    start = experts.drive_regression(records, window=0.01, slow=0.003)
    return experts.best_of(lambda p, r: experts.drive(p, r, window=0.01), records, [start])


def _loop_expert(records: Sequence[AxisRecord]) -> Predictor:
    """q'' = a (kp (reference - q) - q') - b q' - c sign q', kp of the position loop known."""
    # kv gtau / mass, viscous / mass and coulomb / mass of the published values
    start = [243.45 * 35.15 / 95.1, 2.1, 0.18, 0.25]

    def model(p: Array, record: AxisRecord) -> Array:
        stiff = p[0] * KP
        return experts.drive([stiff, p[0] + p[1], p[2], p[3]], record, window=0.0, spring=stiff)

    return experts.best_of(model, records, [start])


def _emps(loop: bool) -> Device:
    return Device(
        name="emps_loop" if loop else "emps",
        title="the same carriage in its position loop: reference to position"
        if loop
        else "carriage on a ball screw: force of the motor to position, open loop",
        source="github:wmkouw/NSI-EMPS, data/DATA_EMPS.mat, data/DATA_EMPS_PULSES.mat; "
        "parameters: sota-baselines/Simulation_EMPS.m",
        licence="MIT",
        files=files("emps/*"),
        kind="servo" if loop else "drive",
        units=("m" if loop else "N", "m"),
        nominal={} if loop else {"mass": 95.1089, "gain": 1.0},
        fit=("steps",),
        left_out=("pulses_a", "pulses_b"),
        published={"kp": KP, "kv": 243.45} if loop else EMPS,
        records=lambda data: _emps_records(data, loop),
        expert=_loop_expert if loop else _emps_expert,
    )


# --- UR10e

PERIOD = 0.01  # s, the log has gaps of 8 to 12 ms
PARTS = ("first", "second", "third")
# seconds after the log's start between which the joint alone follows its sine
SPANS = {1: (5.0, 59.5), 5: (8.0, 61.0), 6: (8.0, 64.0)}
# UR10E_parameters.txt of the source: (motor's gain [N m/A], inertia [kg m^2], friction: viscous
# [N m s/rad], Coulomb [N m], offset [N m]). The inertia of joint 1 is the whole stretched arm's
# (first base parameter), those of 5 and 6 are the motors' alone.
UR10E = {
    1: (10.0, 16.018, 21.2560, 12.5484, 0.1961),
    5: (9.48, 0.2342, 2.4909, 2.6905, -0.0096),
    6: (10.1232, 0.4365, 3.0256, 2.2979, 0.0425),
}


def _ur10e_records(data: Path, joint: int) -> list[AxisRecord]:
    table = np.loadtxt(data / "ur10e" / f"ur-20_01_22-joint_{joint}.csv", delimiter=",")
    t = table[:, 0] - table[0, 0]
    begin, end = SPANS[joint]
    rows = (t >= begin) & (t <= end)
    # columns: time, six angles, six speeds, six currents, six currents expected
    whole = AxisRecord("whole", t[rows], table[rows, 12 + joint], table[rows, joint])
    return split(evenly(whole, PERIOD), *PARTS)


def _ur10e_expert(records: Sequence[AxisRecord]) -> Predictor:
    """Inertia per gain, viscous and dry friction: regression, then the simulated path."""
    start = experts.drive_regression(records, window=0.3, slow=0.02)
    return experts.best_of(
        lambda p, r: experts.drive(p, r, window=0.1), records, [start], also=[start]
    )


def _ur10e(joint: int) -> Device:
    gain, mass, viscous, coulomb, offset = UR10E[joint]
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
        records=lambda data: _ur10e_records(data, joint),
        expert=_ur10e_expert,
    )


# --- HSM150

STEPS = ("neg_0.04", "neg_0.045", "pos_0.06", "pos_0.065")


def _hsm150_records(data: Path) -> list[AxisRecord]:
    found = []
    for run in (f"{step}_{number}" for number in (1, 2, 3) for step in STEPS):
        table = scipy.io.loadmat(data / "hsm150" / f"idf_{run}.mat")["data"]
        t, _, y, _, u = table[:, :5].astype(float).T
        found.append(AxisRecord(run, t - t[0], np.ascontiguousarray(u), np.ascontiguousarray(y)))
    return found


def _hsm150_expert(records: Sequence[AxisRecord]) -> Predictor:
    """Inertia, viscous and dry friction each way, by the simulated path."""
    # the catalogue's inertia 1.2e-4 kg m^2; friction from the speeds of the two levels of a run
    start = [1 / 1.2e-4, 0.7, 150.0, 150.0]
    return experts.best_of(lambda p, r: experts.drive(np.abs(p), r, window=0.0), records, [start])


HSM150 = Device(
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
    records=_hsm150_records,
    expert=_hsm150_expert,
)

DEVICES = (_emps(loop=False), _emps(loop=True), *map(_ur10e, UR10E), HSM150)
