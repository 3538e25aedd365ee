"""A servo-hydraulic press with a damper in it: commanded to reached displacement, chirps and a
sine of 15 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files, split

RUNS = {"chirp_0A": "0A.txt", "sine_0A": "15Hz0A.txt", "sine_1A": "15Hz1A.txt"}
RATE = 1000.0  # Hz, the header's sampling rate
CENTIMETRE = 0.01  # m


def _records(data: Path) -> list[Record]:
    found = {}
    for name, file in RUNS.items():
        table = (
            np.loadtxt(data / "press" / file, delimiter=",", skiprows=7, usecols=(2, 4))
            * CENTIMETRE
        )
        found[name] = Record(name, np.arange(len(table)) / RATE, table[:, 1], table[:, 0])
    chirp = split(found.pop("chirp_0A"), "chirp_0A_a", "chirp_0A_b")
    return [*chirp, *found.values()]


def _expert(records: Sequence[Record]) -> Predictor:
    """Two real poles, a gain and an offset."""

    def model(p: Array, record: Record) -> Array:
        one, two, gain, offset = p
        b, a = bilinear([gain * one * two], [1.0, one + two, one * two], RATE)
        before = lfilter_zi(b, a) * record.u[0]
        return lfilter(b, a, record.u, zi=before)[0] + offset

    p = experts.fitted(model, records, [40.0, 200.0, 1.0, 0.0])
    return lambda record: model(p, record)


DEVICE = Device(
    name="press",
    title="servo-hydraulic press with a damper: commanded to reached displacement",
    source="github:DanielMaurelE/vRTHS_AMBC_MRdamper, "
    "Cap6_ModeloActuador/Preprocesamiento/Datos/0A.txt, "
    "Cap7_ModeloMR/BoucWen Ajuste 2/Validacion/MRDAMPER/{15Hz0A,15Hz1A}.txt",
    licence="MIT",
    files=files("press/*"),
    kind="servo",
    units=("m", "m"),
    nominal={},
    fit=("chirp_0A_a", "sine_0A"),
    left_out=("chirp_0A_b", "sine_1A"),
    published={},
    records=_records,
    expert=_expert,
)
DEVICES = (DEVICE,)
