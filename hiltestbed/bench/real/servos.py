"""Machines that follow a command, position to position: the hobby servo arm SO-101 at about 50 Hz;
its servos, Feetech STS3215, on a test stand at 10 Hz; actuators that set camber and toe of a wheel;
a servo-hydraulic press with a damper in it, on chirps and a sine of 15 Hz.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from itertools import product
from pathlib import Path

import numpy as np
from scipy.constants import centi, milli
from scipy.signal import bilinear, lfilter, lfilter_zi

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, AxisRecord, Device, Predictor, evenly, files, split


def _offset(records: Sequence[AxisRecord]) -> float:
    return float(np.mean([np.mean(r.y - r.u) for r in records]))


def _with_unit_gain(
    records: Sequence[AxisRecord],
    starts: Sequence[Sequence[float]],
    bounds: tuple[Sequence[float], Sequence[float]],
    steps: int,
) -> Predictor:
    """Second order with delay, play, speed limit and offset: six numbers, from several starts."""
    return experts.best_of(
        lambda p, r: experts.servo(np.append(p, 1.0), r, steps), records, starts, bounds
    )


# --- SO-101

MOTIONS = ("chirp_sweep", "step_response", "velocity_ramp", "multisine")


def _so101_column(path: Path, joint: int) -> tuple[Array, Array]:
    """Times [s] (stamps in microseconds) and angles [rad] of a joint; rows hold a JSON list."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    t = np.array([float(row["timestamp"]) for row in rows]) * 1e-6
    return t, np.array([json.loads(row["positions"])[joint] for row in rows])


def _so101_records(data: Path, joint: int) -> list[AxisRecord]:
    found = []
    for motion in MOTIONS:
        folder = data / "so101_servo" / motion
        sent, u = _so101_column(folder / "control.csv", joint)
        t, y = _so101_column(folder / "state_motor.csv", joint)
        held = np.clip(np.searchsorted(sent, t, side="right") - 1, 0, sent.size - 1)
        found.append(AxisRecord(motion, t - t[0], u[held], y))
    return found


def _so101_expert(records: Sequence[AxisRecord]) -> Predictor:
    offset = _offset(records)
    bounds = ([1.0, 0.05, 0.0, 0.0, 0.2, -0.3], [200.0, 5.0, 0.2, 0.3, 20.0, 0.3])
    starts = [[w, 0.7, 0.02, 0.02, 1.6, offset] for w in (12.0, 22.0, 40.0)]
    return _with_unit_gain(records, starts, bounds, steps=10)


def _so101(joint: int, name: str, title: str) -> Device:
    return Device(
        name=name,
        title=title,
        source="github:isaac-sim2real/sage, output/real/so101/custom/*/{control,state_motor}.csv",
        licence="Apache-2.0",
        files=files("so101_servo/*"),
        kind="servo",
        units=("rad", "rad"),
        fit=MOTIONS[:2],
        left_out=MOTIONS[2:],
        records=lambda data: _so101_records(data, joint),
        expert=_so101_expert,
    )


# --- STS3215

COUNT = 2 * np.pi / 4096  # rad, 12 bits a turn


def _sts3215_record(data: Path, log: str, motor: int, name: str) -> AxisRecord:
    with (data / "sts3215" / f"motor_telemetry_{log}.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row[f"pos ({motor})"]]
    stamps = [datetime.fromisoformat(row["timestamp"].replace("Z", "+00:00")) for row in rows]
    t = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])
    y, u = (
        np.array([float(row[f"{column} ({motor})"]) for row in rows]) * COUNT
        for column in ("pos", "target pos")
    )
    return AxisRecord(name, t, u, y)


def _sts3215_expert(records: Sequence[AxisRecord]) -> Predictor:
    offset = _offset(records)
    bounds = ([2.0, 0.2, 0.0, 0.0, 0.1, -0.1], [60.0, 3.0, 0.3, 0.1, 10.0, 0.1])
    each = product((10.0, 25.0), (0.02, 0.1), (0.6, 1.5))
    starts = [[w, 1.0, delay, 0.005, speed, offset] for w, delay, speed in each]
    return _with_unit_gain(records, starts, bounds, steps=50)


TESTED = Device(
    name="sts3215_tested",
    title="hobby servo under test, pulled by two others: commanded to reached angle",
    source="github:roboninecom/Measuring-Backlash-in-Popular-UART-Servos, "
    "logs/motor_telemetry_*.csv",
    licence="CC BY 4.0",
    files=files("sts3215/motor_telemetry_single.csv"),
    kind="servo",
    units=("rad", "rad"),
    fit=("first",),
    left_out=("second",),
    records=lambda data: split(_sts3215_record(data, "single", 5, "whole"), "first", "second"),
    expert=_sts3215_expert,
)
PULLER = replace(
    TESTED,
    name="sts3215_puller",
    title="hobby servo that pulls another: commanded to reached angle",
    files=files("sts3215/motor_telemetry_*comp2.csv"),
    fit=("short",),
    left_out=("long",),
    records=lambda data: [
        _sts3215_record(data, log, 3, name)
        for log, name in (("nocomp2", "short"), ("comp2", "long"))
    ],
)

# --- camber and toe

PERIOD = 0.01  # s
# of each actuator: prefix of its files, its runs, and the unit of its positions in SI
CAMBER = {
    "EccA": (
        "load-",
        ("square-wave-full-travel-0.5Hz", "square-wave-full-travel-1Hz",
         "square-wave-half-travel-1Hz"),
        np.pi / 180,  # rad/deg
    ),
    "LinD": (
        "no-pp-",
        ("sine-sweep-10mm-0.5Hz", "square-wave-10mm-0.5Hz", "square-wave-10mm-1Hz"),
        1e-3,  # m/mm
    ),
}  # fmt: skip


def _camber_records(data: Path, actuator: str) -> list[AxisRecord]:
    prefix, runs, scale = CAMBER[actuator]
    found = []
    for run in runs:
        table = np.loadtxt(data / "camber" / actuator / f"{prefix}{run}.txt")
        # columns: time, target, demand of the profile, position, speed, current
        t, target, demand, y = table[:, :4].T
        u = (target if actuator == "LinD" else demand) * scale
        found.append(evenly(AxisRecord(run, t * milli, u, y * scale), PERIOD))
    return found


def _camber_expert(records: Sequence[AxisRecord]) -> Predictor:
    """Second order with delay, a speed limit, play, gain and offset."""
    fastest = max(float(np.max(np.abs(np.gradient(r.y, r.t)))) for r in records)
    size = float(np.std(np.concatenate([r.y for r in records])))
    bounds = (
        [5.0, 0.1, 0.0, 0.0, 0.1 * fastest, -0.2 * size, 0.8],
        [800.0, 5.0, 0.1, 0.2 * size, 5 * fastest, 0.2 * size, 1.2],
    )
    starts = [
        [w, 0.8, d, 0.01 * size, fastest, 0.0, 1.0] for w in (20, 60, 150) for d in (0.003, 0.02)
    ]
    return experts.best_of(lambda p, r: experts.servo(p, r, steps=20), records, starts, bounds)


def _camber(actuator: str, title: str, unit: str) -> Device:
    runs = CAMBER[actuator][1]
    return Device(
        name=f"camber_{actuator.lower()}",
        title=title,
        source=f"github:nicolazande/camber-control, actuators/{actuator}/data/*.txt",
        licence="none stated",
        files=files(f"camber/{actuator}/*"),
        kind="servo",
        units=(unit, unit),
        fit=runs[:2],
        left_out=runs[2:],
        records=lambda data: _camber_records(data, actuator),
        expert=_camber_expert,
    )


# --- press

PRESS_RUNS = {"chirp_0A": "0A.txt", "sine_0A": "15Hz0A.txt", "sine_1A": "15Hz1A.txt"}
RATE = 1000.0  # Hz, the header's sampling rate


def _press_records(data: Path) -> list[AxisRecord]:
    found = {}
    for name, file in PRESS_RUNS.items():
        path = data / "press" / file
        table = np.loadtxt(path, delimiter=",", skiprows=7, usecols=(2, 4)) * centi
        found[name] = AxisRecord(name, np.arange(len(table)) / RATE, table[:, 1], table[:, 0])
    chirp = split(found.pop("chirp_0A"), "chirp_0A_a", "chirp_0A_b")
    return [*chirp, *found.values()]


def _press_expert(records: Sequence[AxisRecord]) -> Predictor:
    """Two real poles, a gain and an offset."""

    def model(p: Array, record: AxisRecord) -> Array:
        one, two, gain, offset = p
        b, a = bilinear([gain * one * two], [1.0, one + two, one * two], RATE)
        before = lfilter_zi(b, a) * record.u[0]
        return lfilter(b, a, record.u, zi=before)[0] + offset

    return experts.best_of(model, records, [[40.0, 200.0, 1.0, 0.0]])


PRESS = Device(
    name="press",
    title="servo-hydraulic press with a damper: commanded to reached displacement",
    source="github:DanielMaurelE/vRTHS_AMBC_MRdamper, "
    "Cap6_ModeloActuador/Preprocesamiento/Datos/0A.txt, "
    "Cap7_ModeloMR/BoucWen Ajuste 2/Validacion/MRDAMPER/{15Hz0A,15Hz1A}.txt",
    licence="MIT",
    files=files("press/*"),
    kind="servo",
    units=("m", "m"),
    fit=("chirp_0A_a", "sine_0A"),
    left_out=("chirp_0A_b", "sine_1A"),
    records=_press_records,
    expert=_press_expert,
)

DEVICES = (
    _so101(0, "so101_base", "hobby servo, base joint: commanded to reached angle"),
    _so101(1, "so101_pitch", "hobby servo, pitch joint, which carries weight"),
    _so101(2, "so101_elbow", "hobby servo, elbow joint, which carries weight"),
    TESTED,
    PULLER,
    _camber("EccA", "eccentric camber actuator under load: demand to angle", "rad"),
    _camber("LinD", "linear toe actuator without load: target to position", "m"),
    PRESS,
)
