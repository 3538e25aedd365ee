"""Nuisance parameters: details of a facility's computation that no definition fixes, unknown to the
diagnosis and not to be found by it.

    nuisances = draw_nuisances(rng)
    rig = with_nuisances(rig, nuisances)
    records = restamped(records, nuisances.stamps)

Instants are fractions of a tick. None is larger than one half, so that a whole tick remains a
nameable effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.random import Generator

from tests.equipment.independent_rig import platform, sensor
from tests.equipment.independent_rig.links import SUBSTEPS, Records, Rig, Timing
from tests.equipment.independent_rig.log import POSES, WRENCHES

Scheme = Literal["as drawn", "exact", "semi_implicit", "trapezoidal"]
SCHEMES = {  # of the platform and of the sensor
    "as drawn": (platform.AS_COARSE, sensor.EXPONENTIAL),
    "exact": (platform.RUNGE_KUTTA, sensor.EXPONENTIAL),
    "semi_implicit": (platform.SEMI_IMPLICIT, sensor.BACKWARD),
    "trapezoidal": (platform.TRAPEZOIDAL, sensor.TRAPEZOIDAL),
}
FEWEST, MOST = 2, 200  # sub-steps
LONGEST = 0.5  # ticks, largest offset of an instant
FARTHEST = 1.0  # rows, largest offset of a stamp


@dataclass(frozen=True)
class Nuisances:
    """The choices of a facility; the defaults are those of the plain rig.

    Attributes:
        substeps: per tick. lever: point of application of the force along the overlap, 0 at the
            undeformed surface, 1 at the tip;
            None: that of the rig.
        read: the sensor samples by this fraction of a tick before the stamp. move: delay of a new
            command, in ticks.
        encoder: pose_act is sampled by this fraction of a tick before its stamp.
        step: fraction of the old twist in the numerical model's new pose: 0 semi-implicit, 1 would
            be explicit Euler.
        rate: the contact's rate is the slope of the tick (0), of the half tick that ends there (1),
            or in between.
        scheme: integration of the filters of platform and sensor.
        stamps: channel to the delay of its stamps in rows: row k was measured that many rows
            before.
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


def draw_nuisances(rng: Generator) -> Nuisances:
    """Random choices: 2 to 200 sub-steps, any lever, instants up to half a tick, stamps to a row.

    On average two of the four channels have exact stamps; half of the others are off by whole rows.
    """
    substeps = round(math.exp(rng.uniform(math.log(FEWEST), math.log(MOST))))
    lever = 0.5 + rng.uniform(-0.5, 0.5)
    read, move, encoder, step = (LONGEST * float(rng.random()) for _ in range(4))
    rate = float(rng.random())
    scheme: Any = str(rng.choice(["exact", "semi_implicit", "trapezoidal"]))
    stamps = {}
    for channel in (*POSES, *WRENCHES):
        late = FARTHEST * rng.uniform(-1.0, 1.0)
        stays, whole = rng.random() < 0.5, rng.random() < 0.5
        if not stays:
            stamps[channel] = float(np.round(late)) if whole else float(late)
    return Nuisances(substeps, lever, read, move, encoder, step, rate, scheme, stamps)


def with_nuisances(rig: Rig, nuisances: Nuisances) -> Rig:
    """The rig with these nuisance parameters, except the stamps of its log (`restamped`)."""
    h = 1.0 / rig.rate
    of_platform, of_sensor = SCHEMES[nuisances.scheme]
    contact = rig.contact
    if nuisances.lever is not None:
        contact = contact._replace(lever=nuisances.lever)
    return rig._replace(
        bodies=rig.bodies._replace(old_part=nuisances.step),
        platform=rig.platform._replace(
            delay=rig.platform.delay + nuisances.move * h, scheme=of_platform
        ),
        contact=contact,
        sensor=rig.sensor._replace(
            delay=rig.sensor.delay + nuisances.read * h, lag_scheme=of_sensor
        ),
        timing=Timing(nuisances.substeps, nuisances.move, nuisances.encoder, nuisances.rate),
    )


def restamped(records: Records, stamps: Mapping[str, float]) -> Records:
    """The records with the channels in `stamps` shifted by whole or fractional rows."""
    return records._replace(
        **{channel: shifted(getattr(records, channel), rows) for channel, rows in stamps.items()}
    )


def shifted(rows: np.ndarray, late: float) -> np.ndarray:
    """Rows (n, m) delayed by `late` rows, linear in between; the ends are repeated."""
    at = np.clip(np.arange(len(rows)) - late, 0.0, len(rows) - 1.0)
    whole = np.minimum(at.astype(np.int64), len(rows) - 2)
    part = (at - whole)[:, None]
    out = (1.0 - part) * rows[whole] + part * rows[whole + 1]
    if rows.shape[1] == 7:
        out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=1, keepdims=True)
    return out
