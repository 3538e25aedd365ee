"""A facility with a mechanism that touches nothing: `n` copies in lockstep, for measurements.

A tick is that of the closed loop's plant without contact: aim, push and step, observe. A wrench may
act on its active side at A, in W.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mujoco.batch import Batch

from hiltestbed.contact.composition import drawn
from hiltestbed.contact.contacts import centres
from hiltestbed.contact.mechanisms import Bumper
from hiltestbed.contact.wrench import load_body
from hiltestbed.frames import Array, rotate_back
from hiltestbed.platform.driven import SPEED_LIMIT
from hiltestbed.platform.facilities.composed import TOOL, facility_model
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import Facility, Runs

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

Stands = Callable[[int], "Stand"]  # so many rigs


class Stand:
    """`n` facilities with a mechanism.

    Attributes:
        drives: their drives. pose, twist: those of A relative to P, in P, at t_k. diverged: (n,)
            which runs have diverged.
    """

    def __init__(
        self,
        facility: Facility,
        n: int = 1,
        *,
        settings: Sequence[Any] | None = None,
        rate: float = 2000.0,
        substeps: int = 2,
        feed: bool = False,
        mechanism: Mechanism | None = None,
        threads: int = 0,
    ) -> None:
        """``settings``: of each run. ``mechanism``: by default a bumper."""
        self.facility, self.tick, self.substeps = facility, 1.0 / rate, substeps
        # without contact: its stiffness is not used
        bumper = Bumper.model_validate({"contact": {"stiffness": 1.0}})
        sides = drawn(mechanism or bumper)
        self.model = facility_model(facility, sides, self.tick / substeps)
        self.batch = Batch(self.model, n, threads, persistent=True)
        runs = Runs(
            self.tick, substeps, list(settings or [facility.settings] * n), np.full(n, feed)
        )
        drives = facility.drives(self.model, runs, TOOL)
        assert isinstance(drives, Drives)
        self.drives = drives
        bind = self.batch.bind
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._applied = bind("xfrc_applied").reshape(n, -1, 6)
        site = self.model.site(TOOL)
        self._body = int(site.bodyid[0])
        self._centre, self._at = np.zeros(3), np.zeros((n, 3))
        rotate_back(
            site.quat[[1, 2, 3, 0]], self.model.body(self._body).ipos - site.pos, self._centre
        )
        self.wrench = np.zeros((n, 6))
        self.diverged = np.zeros(n, dtype=bool)
        self.pose, self.twist = self.drives.pose, self.drives.twist
        self._observe = self.drives.observing(self.qpos, self.qvel, SPEED_LIMIT, self.diverged)

    def reset(self, pose: Array, twist: Array) -> None:
        """Start in a uniform motion with ``twist`` (n, 6) whose command is at ``pose`` (n, 7)."""
        self.batch.reset(stage=0)
        self.diverged[:] = False
        self.wrench[:] = 0.0
        self._applied[:] = 0.0
        self.drives.settle(pose, twist, self.qpos, self.qvel)
        self.batch.forward()
        self._observe()

    def advance(self, pose: Array, twist: Array, accel: Array) -> None:
        """One tick towards ``pose`` (n, 7), with ``twist`` and ``accel`` (n, 6)."""
        self.drives.aim(pose, twist, accel)
        for s in range(self.substeps):
            if self.wrench.any():
                place = self.drives.place_A
                centres(place, self._centre, self._at)
                load_body(1.0, self.wrench, self._body, self._at - place[:, :3], self._applied)
            self.drives.push(s, self.qpos, self.qvel, self.ctrl)
            self.batch.step()
        self.drives.arrive()
        self._observe()
