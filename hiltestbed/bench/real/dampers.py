"""Dampers, displacement to force: a band brake with play in its linkage, on sines of 0.5 Hz and
1 Hz at several tensions of the band; a magnetorheological damper at several currents of its coil,
on sines; a hydraulic damper of a racing car on a dynamometer (Scotch yoke), 300 Hz.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.constants import centi, inch, kilo, lbf, milli
from scipy.signal import lfilter

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, AxisRecord, Device, Predictor, files, split

# `nominal` of each: k x + c v by least squares over the first record to fit
UNITS = ("m", "N")

# --- band brake


def _brake_record(data: Path, file: str, name: str) -> AxisRecord:
    path = data / "friction_damper" / f"{file}.json"
    t, x, force = np.array(json.loads(path.read_text())["data"], dtype=float)[:, :3].T
    return AxisRecord(name, t - t[0], x * inch, force * kilo * lbf)


def _halves(data: Path, tension: str) -> list[AxisRecord]:
    runs = [_brake_record(data, f"{f}{tension}tension", f) for f in ("0.5Hz", "1Hz")]
    return [part for run in runs for part in split(run, f"{run.name}_a", f"{run.name}_b")]


def _earthquakes(data: Path) -> list[AxisRecord]:
    sines = {f: f"{f}36lbtension1amplitude" for f in ("0.5Hz", "1Hz")}
    quakes = {quake: quake for quake in ("KocaeliDBE", "ImperialValleyDBE")}
    return [_brake_record(data, file, name) for name, file in (sines | quakes).items()]


def _brake_expert(records: Sequence[AxisRecord]) -> Predictor:
    """One slider behind a spring with play; beside it a dashpot, a spring and an offset. A record
    that starts below a twentieth of the greatest force starts in the middle of the play.
    """
    stroke = np.ptp(np.concatenate([r.u for r in records]))
    force = np.concatenate([r.y for r in records])
    idle = 0.05 * np.max(np.abs(force))

    def model(p: Array, record: AxisRecord) -> Array:
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
    return experts.best_of(model, records, starts)


def _brake(tension: str, stiffness: float, damping: float) -> Device:
    return Device(
        name=f"friction_damper_{tension}",
        title=f"band brake with play, {tension[:-2]} lb of tension: displacement to force",
        source="github:ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash, "
        f"data/dataset-1/characterization datasets/{{0.5Hz,1Hz}}{tension}tension.json",
        licence="CC BY-SA 4.0",
        files=files(f"friction_damper/*{tension}tension.json"),
        kind="damper",
        units=UNITS,
        nominal={"stiffness": stiffness, "damping": damping},
        fit=("0.5Hz_a", "0.5Hz_b"),
        left_out=("1Hz_a", "1Hz_b"),
        records=lambda data: _halves(data, tension),
        expert=_brake_expert,
    )


QUAKES = Device(
    name="friction_damper_36lb",
    title="band brake with play, 36 lb of tension: fitted to a sine, left out are earthquakes",
    source="github:ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash, data/dataset-2/"
    "{characterization datasets/*36lbtension1amplitude,earthquake profiles/*DBE}.json",
    licence="CC BY-SA 4.0",
    files=files("friction_damper/*36lb*") | files("friction_damper/*DBE.json"),
    kind="damper",
    units=UNITS,
    nominal={"stiffness": 493.7e3, "damping": 223.6e3},
    fit=("0.5Hz",),
    left_out=("1Hz", "KocaeliDBE", "ImperialValleyDBE"),
    records=_earthquakes,
    expert=_brake_expert,
)

# --- magnetorheological damper

MR_FIT = ("10mm1Hz", "25mm0x25Hz", "5mm3Hz")
MR_LEFT_OUT = ("25mm0x1Hz", "25mm0x5Hz", "2mm5Hz")


def _mr_records(data: Path, current: str) -> list[AxisRecord]:
    found = []
    for run in MR_FIT + MR_LEFT_OUT:
        t, x, _, force = np.loadtxt(data / "mr_damper" / f"{run}{current}.txt").T
        found.append(AxisRecord(run, t - t[0], x * centi, force))
    return found


def _mr_expert(records: Sequence[AxisRecord]) -> Predictor:
    """Modified Bouc-Wen, seven numbers for all amplitudes."""
    peak = float(np.mean([np.quantile(np.abs(r.y), 0.95) for r in records]))
    starts = [[0.8 * peak, reach, 2.0, 2.0 * peak, 50 * peak, 0.0, 0.0] for reach in (2e-4, 1e-3)]
    return experts.best_of(experts.bouc_wen, records, starts)


def _mr(current: str, stiffness: float, damping: float) -> Device:
    ampere = current.replace("x", ".")
    return Device(
        name=f"mr_damper_{ampere}",
        title=f"magnetorheological damper at {ampere[:-1]} A: displacement to force",
        source="github:DanielMaurelE/vRTHS_AMBC_MRdamper, Cap7_ModeloMR/BoucWen Ajuste 1/"
        f"Preprocesamiento-sinusoidales/Preprocesados/*{current}.txt",
        licence="MIT",
        files=files(f"mr_damper/*Hz{current}.txt"),
        kind="damper",
        units=UNITS,
        nominal={"stiffness": stiffness, "damping": damping},
        fit=MR_FIT,
        left_out=MR_LEFT_OUT,
        records=lambda data: _mr_records(data, current),
        expert=_mr_expert,
    )


# --- hydraulic damper


def _dyno_record(data: Path, log: str, name: str) -> AxisRecord:
    """The load cell's sign is the opposite of the yoke's: the displacement is turned about."""
    with (data / "dyno_damper" / f"{log}_n10_100psi.csv").open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    stamps = [datetime.fromisoformat(row[0]) for row in rows]
    t = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])
    force, x = (np.array([float(row[column]) for row in rows]) for column in (2, 4))
    sign = -1.0 if np.mean(np.gradient(x) * force) < 0 else 1.0
    return AxisRecord(name, t, sign * (x - x.mean()) * milli, force)


def _open_records(data: Path) -> list[AxisRecord]:
    slow = _dyno_record(data, "t1_1_1_18_18_s1", "slow")
    fast = _dyno_record(data, "t1_1_1_18_18_s6", "fast")
    return [*split(slow, "slow_a", "slow_b"), *split(fast, "fast_a", "fast_b")]


def _dyno_expert(records: Sequence[AxisRecord]) -> Predictor:
    """A valve with a knee and a slope of its own each way, gas preload, gas spring, oil's lag."""

    def model(p: Array, record: AxisRecord) -> Array:
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
    return experts.best_of(model, records, starts)


SOURCE = "github:LucasDudley/damper_characterization, Test_Data/Phase1_temp_sensitivity/"
OPEN = Device(
    name="dyno_damper_open",
    title="hydraulic damper, open valves, 100 psi: displacement to force at two speeds",
    source=SOURCE + "pressure_testing/t1_1_1_18_18_{s1,s6}_n10_100psi.csv",
    licence="none stated",
    files=files("dyno_damper/t1_1_1_*"),
    kind="damper",
    units=UNITS,
    nominal={"stiffness": 393.7, "damping": 1617.0},
    fit=("slow_a", "fast_a"),
    left_out=("slow_b", "fast_b"),
    records=_open_records,
    expert=_dyno_expert,
)
CLOSED = replace(
    OPEN,
    name="dyno_damper_closed",
    title="hydraulic damper, valves nearly closed: displacement to force",
    source=SOURCE + "t1_3_3_24_24_s5_n10_100psi.csv",
    files=files("dyno_damper/t1_3_3_*"),
    nominal={"stiffness": 6202.0, "damping": 4663.0},
    fit=("first",),
    left_out=("second",),
    records=lambda data: split(_dyno_record(data, "t1_3_3_24_24_s5", "whole"), "first", "second"),
)

DEVICES = (
    _brake("80lb", stiffness=365.1e3, damping=176.7e3),
    _brake("25lb", stiffness=189.4e3, damping=111.2e3),
    QUAKES,
    _mr("0A", stiffness=143.0, damping=341.5),
    _mr("0x5A", stiffness=819.6, damping=1700.0),
    _mr("1A", stiffness=1839.0, damping=2758.0),
    OPEN,
    CLOSED,
)
