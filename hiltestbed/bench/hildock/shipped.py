"""The methods of the package as entrants of HILDOCK-1: the very blocks that a scenario runs, with
one axis in use.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hiltestbed.bench.contacts import ARM, Contact
from hiltestbed.bench.contenders import CONTENDERS, Contender
from hiltestbed.bench.hildock.problem import START, TICK
from hiltestbed.compensation.blocks import make_drive
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.identification.settings import IDENTIFIERS
from hiltestbed.numerical_model.model import NumericalModel

AXIAL = 2
# a scenario needs a contact, which no method for a first contact reads
UNREAD = Contact(1.0, 0.01, 0.05)


class Shipped:
    """A method for a first contact, with the identification by least squares of a scenario."""

    def __init__(self, contender: Contender) -> None:
        self.name, self._contender = f"shipped {contender.name}", contender

    def start(self, case: int, ticks: int, delay: float, noise: float) -> None:
        changes: dict[str, Any] = {
            "sensor.delay": delay,
            "sensor.noise": noise,
            "sensor.torque_noise": ARM * noise,
            "approach.gap": -START,
            "duration": (ticks + 1) * TICK,
        }
        contact = Contact(1.0, delay, 0.05, changes=changes)
        runs = [contact.scenario(self._contender.force(UNREAD))]
        model = NumericalModel(runs)
        self._drive = make_drive(runs, model)
        self._identification = IDENTIFIERS["rls"].start(runs)
        pose, twist = self._drive.pose, self._drive.twist
        estimate = self._identification
        self._read = Measurement(
            np.zeros((1, 6)),
            pose.copy(),
            twist.copy(),
            estimate.stiffness,
            estimate.damping,
            np.zeros(1, dtype=bool),
        )

    def step(self, tick: int, force: float) -> float:
        read = self._read
        read.wrench[0, AXIAL] = force
        self._identification.update(read.wrench, read.pose, read.twist)
        before = self._drive.pose[0, AXIAL]
        self._drive.advance(read)
        read.pose[:] = self._drive.pose
        read.twist[0, AXIAL] = (self._drive.pose[0, AXIAL] - before) / TICK
        return float(self._drive.pose[0, AXIAL])

    def end(self) -> tuple[float, float] | None:
        k = float(self._identification.stiffness[0, AXIAL])
        c = float(self._identification.damping[0, AXIAL])
        return (k, c) if np.isfinite([k, c]).all() else None


def shipped() -> list[Shipped]:
    """Those for a first contact whose settings need nothing of it."""
    return [Shipped(c) for c in CONTENDERS if c.contact == "first" and c.name != "dead_zone"]
