"""All interaction between the two sides of `n` rigs, for the plants that move them: contacts,
latch, mount, applied wrenches.
"""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np
from mujoco.batch import Batch

from hiltestbed.compiled.jit import interpreted, njit
from hiltestbed.contact.composition import ACTIVE, Structure, set_linear
from hiltestbed.contact.engagement import Engagement
from hiltestbed.contact.mount import Mounts
from hiltestbed.contact.parameters import MechanismParameters
from hiltestbed.contact.wrench import load_body
from hiltestbed.errors import InputError
from hiltestbed.frames import Array, rotate, rotate_back, wrench_moved


class AppliedForce(Protocol):
    """A wrench that replaces the contact."""

    def next(self) -> Array:
        """(6,) [N, N m] at the next physics instant, active on passive, in P at P's origin."""
        ...


class Contacts:
    """The sides of `n` runs.

    Attributes:
        written: whether :meth:`meet` must be called at every instant; otherwise MuJoCo computes the
            contacts alone.
        stage: up to which MuJoCo must have computed the forward dynamics before that.
        touching: (n,) bool, whether they touch; latched: (n,) bool. mount: of the passive side.
    """

    def __init__(
        self,
        batch: Batch,
        parameters: MechanismParameters,
        structure: Structure,
        dt: float,
        least_creep: float,
        force: AppliedForce | None,
    ) -> None:
        """``dt``, ``least_creep``: see :class:`Engagement`. ``force``: replaces the contacts."""
        n, model = len(parameters.laws), batch.model
        self._force, self._engagement = force, None
        if structure.touches and structure.constant:
            set_linear(batch, parameters.laws)
        elif structure.touches:
            self._engagement = Engagement(batch, parameters.laws, structure, dt, least_creep)
        engagement = self._engagement
        tilt = (
            engagement.tilt if engagement else np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (n, 1))
        )
        self.mount = Mounts(batch, parameters.mounts, tilt)
        self.written = engagement is not None or force is not None or self.mount.moves
        self.stage = engagement.stage if engagement else int(mujoco.mjtStage.mjSTAGE_NONE)
        self.touching = engagement.touching if engagement else np.zeros(n, dtype=bool)
        self.latched = engagement.latched if engagement else np.zeros(n, dtype=bool)
        self._ncon = batch.bind("ncon")
        self._qpos = batch.bind("qpos")
        self._qvel = batch.bind("qvel")
        self._applied = batch.bind("xfrc_applied").reshape(n, -1, 6)
        self._pulls = force is not None or (engagement is not None and engagement.pulls)
        self._pull = engagement.pull if engagement else np.zeros((n, 6))
        site = model.site(ACTIVE + "A")
        self._active = int(model.site_bodyid[site.id])
        self._arm = np.zeros(3)
        rotate_back.py_func(
            site.quat[[1, 2, 3, 0]], model.body_ipos[self._active] - site.pos, self._arm
        )
        self._centre, self._load = np.zeros((n, 3)), np.zeros((n, 6))
        self._alone = engagement is None and force is None

    @property
    def engagement(self) -> Engagement:
        """Geometry and forces. Raises InputError if MuJoCo's own collision computes them."""
        if self._engagement is None:
            raise InputError(
                "a spring and damper without friction, mount or effects is MuJoCo's own contact: "
                "only its force is available"
            )
        return self._engagement

    def reset(self) -> None:
        """Return to the start of a run."""
        if self._engagement is not None:
            self._engagement.reset()

    def balance(self) -> None:
        """Balance the weight on the mount with nothing latched; undone by :meth:`reset`."""
        if self._engagement is not None:
            self._engagement.latches.open(captured=False)
        balance = self.mount.balance
        interpreted(load_body)(1.0, balance, self.mount.body, self.mount.centre, self._applied)

    def meet(
        self, pose: Array, twist: Array, place: Array | None = None, motion: Array | None = None
    ) -> None:
        """Make MuJoCo exert the forces for the state: pose (n, 7) and twist (n, 6) of A in W, and
        that of the mount's joints.

        place, motion: (n, 7), (n, 6) pose and twist of P if the passive side moves; otherwise it is
            fixed in W.
        """
        mount = self.mount
        if place is None or motion is None:
            mount.observe(self._qpos, self._qvel)
        else:
            mount.ride(place, motion)
        if self._engagement is not None:
            self._engagement.update(pose, twist, mount.place, mount.motion)
        elif self._force is not None:
            self._pull[:] = self._force.next()
            if place is not None:
                for at, wrench in zip(place, self._pull, strict=True):
                    wrench_moved(at, wrench.copy(), wrench)
        if self._pulls:
            centres(pose, self._arm, self._centre)
            load_body(-1.0, self._pull, self._active, self._centre, self._applied)
        if self._pulls or mount.moves:
            np.add(self._pull, mount.balance, out=self._load)
            load_body(1.0, self._load, mount.body, mount.centre, self._applied)

    def look(self) -> None:
        """Set ``touching`` where MuJoCo computes the contacts alone."""
        if self._alone:
            np.greater(self._ncon, 0, out=self.touching)


@njit(cache=True)
def centres(pose, offset, out):
    """``out`` (n, 3) [m]: the position in W of a point at ``offset`` (3,) from A's origin, in A."""
    for i in range(pose.shape[0]):
        rotate(pose[i, 3:7], offset, out[i])
        for j in range(3):
            out[i, j] += pose[i, j]
