"""The joints of a mechanism's moving parts (stroke, ring, jaws) and of its mount, for the trace."""

from __future__ import annotations

import mujoco
import numpy as np

from hiltestbed.contact.composition import ACTIVE, PASSIVE
from hiltestbed.frames import Array
from hiltestbed.platform.plant import Plant

# of a joint in the composed model; the others are the rig's
OF_THE_MECHANISM = (ACTIVE, PASSIVE, "mount_")
UNITS = {mujoco.mjtJoint.mjJNT_SLIDE: "m", mujoco.mjtJoint.mjJNT_HINGE: "rad"}


class MovingParts:
    """The slide and hinge joints of the mechanisms of ``n`` rigs.

    Attributes:
        joints: name and unit of each; empty if nothing moves.
    """

    def __init__(self, plant: object) -> None:
        """``plant``: a :class:`Plant`; the parts of a real mechanism are not known."""
        found = []
        if isinstance(plant, Plant):
            model = plant.model
            self._positions = plant.watch("qpos", 1)[..., 0]
            # with an upper platform the passive side moves in a model of its own
            if self._positions.shape[1] == model.nq:
                found = [
                    (model.joint(i).name, UNITS[kind], int(model.jnt_qposadr[i]))
                    for i in range(model.njnt)
                    if (kind := mujoco.mjtJoint(int(model.jnt_type[i]))) in UNITS
                    and model.joint(i).name.startswith(OF_THE_MECHANISM)
                ]
        self.joints = tuple((name, unit) for name, unit, _ in found)
        self._places = np.array([place for *_, place in found], dtype=np.int64)

    def positions(self) -> Array:
        """``(n, joints)`` now, as in the MJCF [m, rad]."""
        return self._positions[:, self._places]
