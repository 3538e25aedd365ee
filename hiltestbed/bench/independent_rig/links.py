"""What a rig of this kind is made of, what is drawn for a run of it, and what a run leaves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hiltestbed.bench.independent_rig.bodies import Bodies
from hiltestbed.bench.independent_rig.compensation import Compensator
from hiltestbed.bench.independent_rig.contact import Contact
from hiltestbed.bench.independent_rig.docking import Docking
from hiltestbed.bench.independent_rig.platform import Platform
from hiltestbed.bench.independent_rig.sensor import Sensor

SUBSTEPS = 20  # a tick, unless it is drawn


class Timing(NamedTuple):
    """How a facility divides its tick, beyond what can be said by delays of the links; see `nuisances`."""

    substeps: int = SUBSTEPS
    move: float = 0.0  # part of a tick by which a new attitude is obeyed late; of the position that is a delay of the platform
    encoder: float = 0.0  # part of a tick by which pose_act is read before its stamp
    rate: float = 0.0  # 0: the contact's rate is the slope of the tick, 1: that of the half tick that ends there


class Rig(NamedTuple):
    """The five links, with their departures in them, and how the run starts.

    Without `docking` the tip is a point that meets a plane: three translations. With it, tip and rod meet a surface: six axes.
    """

    bodies: Bodies
    platform: Platform
    contact: Contact
    sensor: Sensor
    compensator: Compensator
    approach: dict
    rate: float
    ticks: int
    docking: Docking | None = None
    timing: Timing = Timing()


class Noise(NamedTuple):
    """What is drawn for a run, (ticks, ...): of the reading [N, N m], of the pose [m, -], of the delay and of repeats [-]."""

    reading: np.ndarray  # (ticks, 6)
    pose: np.ndarray  # (ticks, 6)
    delay: np.ndarray  # (ticks,)
    repeat: np.ndarray  # (ticks,), uniform


class Records(NamedTuple):
    """What a run leaves, (ticks, 7) and (ticks, 6); `used` is the reading inside the loop, which the log may not hold.

    touching: (ticks,) whether the mechanisms touch or are latched. captured: the row after which the latch holds, -1 from the start,
    as many as there are rows where it never closes.
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
