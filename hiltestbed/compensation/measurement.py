"""The measurements available to a compensation method at a tick."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array


@dataclass
class Measurement:
    """The measurements at t_k, for ``n`` runs. The arrays belong to other blocks and are reused:
    read them, do not store or modify them.

    Attributes:
        wrench: ``(n, 6)`` the sensor's reading.
        pose: ``(n, 7)`` pose of A in P that the rig reached.
        twist: ``(n, 6)`` its velocity.
        stiffness: ``(n, 6)`` stiffness identified so far, NaN before the first estimate.
        damping: ``(n, 6)`` damping identified so far, likewise.
        captured: ``(n,)`` bool, whether the mechanism is captured.
        lever: ``(n, 3)`` [m] from A, in A, to the reference point of the latch, to which the six
            identified axes refer; 0: A itself.
    """

    wrench: Array
    pose: Array
    twist: Array
    stiffness: Array
    damping: Array
    captured: NDArray[np.bool_]
    lever: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if len(self.lever) != len(self.captured):
            self.lever = np.zeros((len(self.captured), 3))
