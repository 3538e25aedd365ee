"""What a compensation method may know at a tick."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hiltestbed.frames import Array


@dataclass
class Measurement:
    """The rig's side of the loop at t_k, for ``n`` runs. The arrays are the blocks' own: read, do not keep, do not write.

    Attributes:
        wrench: ``(n, 6)`` what the sensor gave.
        pose: ``(n, 7)`` pose of A in P that the rig reached.
        twist: ``(n, 6)`` its velocity.
        stiffness: ``(n, 6)`` stiffness identified so far, NaN before the first estimate.
        damping: ``(n, 6)`` likewise damping.
        captured: ``(n,)`` bool, whether the latches hold.
        lever: ``(n, 3)`` [m] from A, in A, of the latched place whose shift, turn, force and torque the six axes are; 0: A itself.
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
