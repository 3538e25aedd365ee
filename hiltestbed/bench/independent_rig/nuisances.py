"""How a facility computes, as far as no definition says: numbers that a diagnosis does not know and that are not its findings.

    nuisances = draw_nuisances(rng)             # at random; width=0.5: half as far from today's values
    rig = with_nuisances(rig, nuisances)
    records = restamped(records, nuisances.stamps)

Instants are parts of a tick. None is larger than one half, so that a whole tick remains an effect that can be named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.random import Generator

from hiltestbed.bench.independent_rig import platform, sensor
from hiltestbed.bench.independent_rig.links import SUBSTEPS, Records, Rig, Timing

Scheme = Literal["as drawn", "exact", "semi_implicit", "trapezoidal"]
PLATFORM = {
    "as drawn": platform.AS_COARSE, "exact": platform.RUNGE_KUTTA, "semi_implicit": platform.SEMI_IMPLICIT,
    "trapezoidal": platform.TRAPEZOIDAL,
}  # fmt: skip
SENSOR = {
    "as drawn": sensor.EXPONENTIAL, "exact": sensor.EXPONENTIAL, "semi_implicit": sensor.BACKWARD, "trapezoidal": sensor.TRAPEZOIDAL,
}  # fmt: skip
FEWEST, MOST = 2, 200  # sub-steps
LONGEST = 0.5  # ticks, of an instant
CHANNELS = ("pose_cmd", "pose_act", "wrench_meas", "wrench_comp")
FARTHEST = 1.0  # rows, of a stamp


@dataclass(frozen=True)
class Nuisances:
    """The choices of a facility; the defaults are those of the plain rig.

    Attributes:
        substeps: a tick is divided into. lever: where along the overlap the force acts, 0 at the undeformed surface, 1 at the tip;
            None: as the rig has it.
        read: the sensor samples this part of a tick before the stamp. move: a new command is obeyed this part of a tick late.
        encoder: pose_act is sampled this part of a tick before its stamp.
        step: part of the old twist in the numerical model's new pose: 0 semi-implicit, 1 would be explicit Euler.
        rate: the contact's rate is the slope of the tick (0), of the half tick that ends there (1), or between.
        scheme: how platform and sensor integrate their filters.
        stamps: channel to the rows by which its stamp is late: what stands in row k was measured that much before.
    """

    substeps: int = SUBSTEPS
    lever: float | None = None
    read: float = 0.0
    move: float = 0.0
    encoder: float = 0.0
    step: float = 0.0
    rate: float = 0.0
    scheme: Scheme = "as drawn"
    stamps: Mapping[str, float] = field(default_factory=dict)


PLAIN = Nuisances()


def draw_nuisances(rng: Generator, width: float = 1.0) -> Nuisances:
    """Choices at random; `width` from 0 (the plain rig) to 1 (2 to 200 sub-steps, any lever, instants up to half a tick, stamps to a row).

    Two of the four channels keep their stamps on average; half of the others are off by whole rows where the width allows it.
    """
    low, high = (SUBSTEPS * (end / SUBSTEPS) ** width for end in (FEWEST, MOST))
    substeps = round(math.exp(rng.uniform(math.log(low), math.log(high))))
    lever = min(max(0.5 + width * rng.uniform(-0.5, 0.5), 0.0), 1.0)
    read, move, encoder, step = (width * LONGEST * float(rng.random()) for _ in range(4))
    rate = width * float(rng.random())
    scheme = str(rng.choice(["exact", "semi_implicit", "trapezoidal"])) if width > 0.0 else "as drawn"
    stamps = {}
    for channel in CHANNELS:
        late, stays, whole = width * FARTHEST * rng.uniform(-1.0, 1.0), rng.random() < 0.5, rng.random() < 0.5
        if width > 0.0 and not stays:
            stamps[channel] = float(np.round(late)) if whole and width >= 0.5 else float(late)
    return Nuisances(substeps, lever if width > 0.0 else None, read, move, encoder, step, rate, scheme, stamps)  # type: ignore[arg-type]


def with_nuisances(rig: Rig, nuisances: Nuisances) -> Rig:
    """The rig of a facility that computes so; stamps are the log's (`restamped`)."""
    h = 1.0 / rig.rate
    contact = rig.contact if nuisances.lever is None else rig.contact._replace(lever=nuisances.lever)
    return rig._replace(
        bodies=rig.bodies._replace(old_part=nuisances.step),
        platform=rig.platform._replace(delay=rig.platform.delay + nuisances.move * h, scheme=PLATFORM[nuisances.scheme]),
        contact=contact,
        sensor=rig.sensor._replace(delay=rig.sensor.delay + nuisances.read * h, lag_scheme=SENSOR[nuisances.scheme]),
        timing=Timing(nuisances.substeps, nuisances.move, nuisances.encoder, nuisances.rate),
    )


def restamped(records: Records, stamps: Mapping[str, float]) -> Records:
    """The records with the channels in `stamps` moved by whole or part rows; beyond the ends the first and last rows stand."""
    return records._replace(**{channel: shifted(getattr(records, channel), rows) for channel, rows in stamps.items()})


def shifted(rows: np.ndarray, late: float) -> np.ndarray:
    """Rows (n, m) as they were `late` rows before, linear in between; quaternions (columns 3 to 6 of 7) keep their length."""
    at = np.clip(np.arange(len(rows)) - late, 0.0, len(rows) - 1.0)
    whole = np.minimum(at.astype(np.int64), len(rows) - 2)
    part = (at - whole)[:, None]
    out = (1.0 - part) * rows[whole] + part * rows[whole + 1]
    if rows.shape[1] == 7:
        out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=1, keepdims=True)
    return out
