"""The links of a rig, the noise of a run, and the records of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tests.equipment.independent_rig.bodies import Bodies
from tests.equipment.independent_rig.compensation import Compensator
from tests.equipment.independent_rig.contact import Contact
from tests.equipment.independent_rig.docking import Docking
from tests.equipment.independent_rig.platform import Platform
from tests.equipment.independent_rig.sensor import Sensor

SUBSTEPS = 20  # per tick, unless drawn at random


class Timing(NamedTuple):
    """A facility's timing within a tick, as far as it is not a delay of a link; see `nuisances`."""

    substeps: int = SUBSTEPS
    # delay of a new commanded attitude, in ticks; that of the position is part of the platform's
    # delay
    move: float = 0.0
    encoder: float = 0.0  # time by which pose_act is read before its stamp, in ticks
    # 0: the contact's rate is the slope of the tick, 1: that of the half tick that ends there
    rate: float = 0.0


class Rig(NamedTuple):
    """The five links, with their deviations, the mechanism's geometry, and the start of the run."""

    bodies: Bodies
    platform: Platform
    contact: Contact
    sensor: Sensor
    compensator: Compensator
    approach: dict
    rate: float
    ticks: int
    docking: Docking
    timing: Timing = Timing()


class Noise(NamedTuple):
    """Random numbers of a run, (ticks, ...): for the reading [N, N m], the pose [m, -], the delay
    and repeats [-].
    """

    reading: np.ndarray  # (ticks, 6)
    pose: np.ndarray  # (ticks, 6)
    delay: np.ndarray  # (ticks,)
    repeat: np.ndarray  # (ticks,), uniform


class Records(NamedTuple):
    """The records of a run, (ticks, 7) and (ticks, 6); `used` is the reading inside the loop, which
    the log may not contain.

    touching: (ticks,) whether the mechanisms touch or are latched. captured: the row after which
        the latch holds; -1: from the start;
    the number of rows: never.
    """

    pose_cmd: np.ndarray
    pose_act: np.ndarray
    wrench_meas: np.ndarray
    wrench_comp: np.ndarray
    used: np.ndarray
    physical: np.ndarray
    touching: np.ndarray
    captured: int


def silence(ticks: int) -> Noise:
    """No noise at all."""
    return Noise(np.zeros((ticks, 6)), np.zeros((ticks, 6)), np.zeros(ticks), np.ones(ticks))
