"""A magnetorheological damper at two currents of its coil: displacement to force, sines."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files

FIT = ("10mm1Hz", "25mm0x25Hz", "5mm3Hz")
LEFT_OUT = ("25mm0x1Hz", "25mm0x5Hz", "2mm5Hz")
CENTIMETRE = 0.01  # m


def _records(data: Path, current: str) -> list[Record]:
    found = []
    for run in FIT + LEFT_OUT:
        t, x, _, force = np.loadtxt(data / "mr_damper" / f"{run}{current}.txt").T
        found.append(Record(run, t - t[0], x * CENTIMETRE, force))
    return found


def _expert(records: Sequence[Record]) -> Predictor:
    """Modified Bouc-Wen, seven numbers for all amplitudes."""
    peak = float(np.mean([np.quantile(np.abs(r.y), 0.95) for r in records]))

    def model(p: Array, record: Record) -> Array:
        return experts.bouc_wen(p, record)

    starts = [[0.8 * peak, reach, 2.0, 2.0 * peak, 50 * peak, 0.0, 0.0] for reach in (2e-4, 1e-3)]
    fits = [experts.fitted(model, records, start) for start in starts]
    p = experts.best(model, records, fits)
    return lambda record: model(p, record)


def _current(name: str, current: str, nominal: dict[str, float]) -> Device:
    return Device(
        name=name,
        title=f"magnetorheological damper at {current[:-1].replace('x', '.')} A: "
        "displacement to force",
        source="github:DanielMaurelE/vRTHS_AMBC_MRdamper, Cap7_ModeloMR/BoucWen Ajuste 1/"
        f"Preprocesamiento-sinusoidales/Preprocesados/*{current}.txt",
        licence="MIT",
        files=files(f"mr_damper/*Hz{current}.txt"),
        kind="damper",
        units=("m", "N"),
        nominal=nominal,
        fit=FIT,
        left_out=LEFT_OUT,
        published={},
        records=lambda data: _records(data, current),
        expert=_expert,
    )


# k x + c v by least squares over the sine of 10 mm and 1 Hz
DEVICES = (
    _current("mr_damper_0A", "0A", {"stiffness": 143.0, "damping": 341.5}),
    _current("mr_damper_0.5A", "0x5A", {"stiffness": 819.6, "damping": 1700.0}),
    _current("mr_damper_1A", "1A", {"stiffness": 1839.0, "damping": 2758.0}),
)
