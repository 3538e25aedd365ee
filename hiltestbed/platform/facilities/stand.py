"""A facility alone, with a payload on its mount: `n` copies in lockstep, for measurements.

A tick is that of the closed loop's plant without contact: aim, push and step, observe. A wrench may
act on the payload.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mujoco.batch import Batch

from hiltestbed.compiled.jit import njit
from hiltestbed.config.models import load
from hiltestbed.contact.composition import drawn
from hiltestbed.frames import Array, rotate, rotate_back
from hiltestbed.platform.facilities.composed import TOOL as ON_MECHANISM
from hiltestbed.platform.facilities.composed import facility_model
from hiltestbed.platform.facilities.drives import Drives
from hiltestbed.platform.facilities.facility import MOUNT, Facility, Runs, compiled

if TYPE_CHECKING:
    from hiltestbed.contact.settings import Mechanism

Stands = Callable[[int], "Stand"]  # so many rigs
PAYLOAD = "payload_"
TOOL = PAYLOAD + "A"
LIMIT = 1e3  # [m/s], [rad/s] a joint faster than this has diverged


@njit(cache=True)
def _apply(wrench, body, place, centre, applied):
    """Apply the wrench (n, 6) at A, in W, to a body with its centre (3,) from A, in A."""
    r = np.empty(3)
    for i in range(wrench.shape[0]):
        rotate(place[i, 3:7], centre, r)
        for c in range(3):
            k, l = (c + 1) % 3, (c + 2) % 3
            applied[i, body, c] = wrench[i, c]
            applied[i, body, 3 + c] = wrench[i, 3 + c] - (r[k] * wrench[i, l] - r[l] * wrench[i, k])


class Stand:
    """`n` facilities with a payload.

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
        """``settings``: of each run. ``mechanism``: both sides; None: the bumper's active one."""
        self.facility, self.tick, self.substeps = facility, 1.0 / rate, substeps
        tool = TOOL
        if mechanism is None:
            spec = facility.spec()
            spec.attach(load("bumper/active"), prefix=PAYLOAD, site=spec.site(MOUNT))
            self.model = compiled(spec, self.tick / substeps)
        else:
            tool = ON_MECHANISM
            self.model = facility_model(facility, drawn(mechanism), self.tick / substeps)
        self.batch = Batch(self.model, n, threads, persistent=True)
        runs = Runs(
            self.tick, substeps, list(settings or [facility.settings] * n), np.full(n, feed)
        )
        drives = facility.drives(self.model, runs, tool)
        assert isinstance(drives, Drives)
        self.drives = drives
        bind = self.batch.bind
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._applied = bind("xfrc_applied").reshape(n, -1, 6)
        site = self.model.site(tool)
        self._body = int(site.bodyid[0])
        self._centre = np.zeros(3)
        rotate_back(
            site.quat[[1, 2, 3, 0]], self.model.body(self._body).ipos - site.pos, self._centre
        )
        self.wrench = np.zeros((n, 6))
        self.diverged = np.zeros(n, dtype=bool)
        self.pose, self.twist = self.drives.pose, self.drives.twist
        self._observe = self.drives.observing(self.qpos, self.qvel, LIMIT, self.diverged)

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
                _apply(self.wrench, self._body, self.drives.place_A, self._centre, self._applied)
            self.drives.push(s, self.qpos, self.qvel, self.ctrl)
            self.batch.step()
        self.drives.arrive()
        self._observe()
