"""EMPS: a carriage on a ball screw with a motor; force to position, and the loop around it,
reference to position.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numba
import numpy as np
import scipy.io

from hiltestbed.bench.real import experts
from hiltestbed.bench.real.device import Array, Device, Predictor, Record, files, split

SOURCE = (
    "github:wmkouw/NSI-EMPS, data/DATA_EMPS.mat, data/DATA_EMPS_PULSES.mat; "
    "parameters: sota-baselines/Simulation_EMPS.m"
)
# Simulation_EMPS.m; the asymmetry of the dry friction is given there as an offset, -3.1648 N
PUBLISHED = {"mass": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}
KP = 160.18  # 1/s, position loop, `kp` in the files


def _tables(data: Path) -> dict[str, dict[str, Array]]:
    files = {"steps": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
    tables = {name: scipy.io.loadmat(data / "emps" / file) for name, file in files.items()}
    keys = ("t", "vir", "qm", "qg", "gtau")
    return {n: {k: table[k].ravel().astype(float) for k in keys} for n, table in tables.items()}


def _records(data: Path, loop: bool) -> list[Record]:
    found = []
    for name, c in _tables(data).items():
        u = c["qg"] if loop else c["gtau"] * c["vir"]
        found.append(Record(name, c["t"] - c["t"][0], u, c["qm"]))
    return [found[0], *split(found[1], "pulses_a", "pulses_b")]


def _expert(records: Sequence[Record]) -> Predictor:
    """Mass, viscous friction and dry friction of its own size each way: regression first, then
    the simulated path.
    """
    start = experts.drive_regression(records, window=0.01, slow=0.003)
    p = experts.fitted(lambda p, r: experts.drive(p, r, window=0.01), records, start)
    return lambda record: experts.drive(p, record, window=0.01)


@numba.njit(cache=True)
def _loop(p: Array, t: Array, u: Array, start: float) -> Array:
    gain, viscous, forwards, backwards = p
    y = np.empty(t.size)
    q, v = start, 0.0
    for i in range(t.size):
        y[i] = q
        if i + 1 < t.size:
            dt = t[i + 1] - t[i]
            w = v + dt * (gain * (KP * (u[i] - q) - v) - viscous * v)
            v = max(0.0, w - dt * forwards) if w > 0 else min(0.0, w + dt * backwards)
            q += dt * v
    return y


def _loop_expert(records: Sequence[Record]) -> Predictor:
    """The cascade q'' = a (kp (reference - q) - q') - b q' - c sign q' with the known kp of the
    position loop.
    """
    # kv gtau / mass, viscous / mass and coulomb / mass of the published values
    start = [243.45 * 35.15 / 95.1, 2.1, 0.18, 0.25]
    p = experts.fitted(lambda p, r: _loop(p, r.t, r.u, r.y[0]), records, start)
    return lambda record: _loop(p, record.t, record.u, record.y[0])


DRIVE = Device(
    name="emps",
    title="carriage on a ball screw: force of the motor to position, open loop",
    source=SOURCE,
    licence="MIT",
    files=files("emps/*"),
    kind="drive",
    units=("N", "m"),
    nominal={"mass": 95.1089, "gain": 1.0},
    fit=("steps",),
    left_out=("pulses_a", "pulses_b"),
    published=PUBLISHED,
    records=lambda data: _records(data, loop=False),
    expert=_expert,
)
LOOP = Device(
    name="emps_loop",
    title="the same carriage in its position loop: reference to position",
    source=SOURCE,
    licence="MIT",
    files=files("emps/*"),
    kind="servo",
    units=("m", "m"),
    nominal={},
    fit=("steps",),
    left_out=("pulses_a", "pulses_b"),
    published={"kp": 160.18, "kv": 243.45},
    records=lambda data: _records(data, loop=True),
    expert=_loop_expert,
)
DEVICES = (DRIVE, LOOP)
