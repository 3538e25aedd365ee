"""Data shared by the lanes of a replay of contact and sensor: the paths of A, and how near the
surfaces come along them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.compiled.jit import copied, njit
from hiltestbed.contact.geometry import Geometry, arm, unmet
from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.contact.parameters import BLUNT, OFFSET, PARAMETERS, latch_limits
from hiltestbed.contact.settings import Mechanism
from hiltestbed.contact.sides import sides_of
from hiltestbed.contact.wrench import meet_all
from hiltestbed.frames import Array, pose_step, twist_between
from hiltestbed.platform.driven import least_creep
from hiltestbed.platform.facilities.facility import Runs

# [byte] of contact wrenches that are cached, for replays that change only the sensor
KEPT = 64_000_000
NEAR = 2.5e-3  # [m] distance of the surfaces up to which it is exact

# run, whether read between instants, the instants within a tick, contact parameters
ContactKey = tuple[int, bool, bytes, bytes]


class Kept:
    """Cache of the contact wrenches of the latest replays: at least one entry, otherwise at most
    :data:`KEPT` bytes.
    """

    def __init__(self) -> None:
        self._exerted: OrderedDict[ContactKey, Array] = OrderedDict()
        self._size = 0  # [byte] of all entries

    def get(self, key: ContactKey) -> Array | None:
        """The wrenches for ``key``, or None if they are not cached."""
        return self._exerted.get(key)

    def keep(self, key: ContactKey, exerted: Array) -> None:
        """Store the wrenches as the latest entry, and discard the oldest ones."""
        before = self._exerted.pop(key, None)
        self._exerted[key] = exerted
        self._size += exerted.nbytes - (0 if before is None else before.nbytes)
        while len(self._exerted) > 1 and self._size > KEPT:
            self._size -= self._exerted.popitem(last=False)[1].nbytes


@dataclass(frozen=True)
class Felt:
    """Data shared by the lanes of a replay: recorded paths, and the mechanism that moved along
    them.

    Attributes:
        poses: (R, N, 7) of A in P at t_k. before: (R, 7) at t_(-1). tick: [s]. geometry: of the
            mechanism, with two rigid sides.
        captured: (R,) bool, captured from the start. latch: (R, 3) depth [m], cosine, speed [m/s]
            of the latch condition; never met
            without a latch. mount: of the runs, or None for a rigid one.
        substeps: physics instants per tick, at which a compliant mount is integrated.
        blunt: 1 where the ball of a tip touches, 0 where its foremost point does. rates: (R, N, 6)
            twist at t_k if known, as with a servo; None: the mean twist over the tick that ends
            there.
        least_creep: [m/s per N] limits the slope of friction, see
            :class:`hiltestbed.contact.contacts.Contacts`.
        leapfrog: whether a mount is integrated to second order, instead of as by MuJoCo. hastened:
            number of the touch of a run, from 1, that then is taken to be earlier by one standard
            deviation of an instant within a step; 0: none.
        twists: (R, N, 6) mean over the tick that ends at each row. clear: (R, N) lower bound of the
            surfaces' distance in that tick [m].
        kept: cached contact wrenches of the latest replays.
        depth: (R, N, C) penetration of each candidate at t_k without tilt [m]; below -NEAR an
            upper bound.
    """

    poses: Array
    before: Array
    tick: float
    geometry: Geometry
    captured: np.ndarray
    latch: Array
    mount: MountDynamics | None
    substeps: int
    blunt: float = 1.0
    rates: Array | None = None
    least_creep: float = 0.0
    leapfrog: bool = False
    hastened: int = 0
    twists: Array = field(init=False)
    clear: Array = field(init=False)
    depth: Array = field(init=False)
    kept: Kept = field(default_factory=Kept, init=False, repr=False)

    @classmethod
    def along(
        cls,
        mechanisms: Sequence[Mechanism],
        start: Array,
        rig: Runs,
        poses: Array,
        rates: Array | None = None,
    ) -> Felt:
        """The believed mechanisms of R runs, of one shape, with two rigid sides. ``start``: (R, 13)
        of A in P. ``rig``: on which they are.
        """
        before = np.empty((len(poses), 7))
        for path, twist, place in zip(poses, start[:, 7:], before, strict=True):
            pose_step(path[0], twist, -rig.tick, place)
        return cls(
            poses,
            before,
            rig.tick,
            sides_of(mechanisms[0]).geometry,
            np.array([m.captured for m in mechanisms]),
            latch_limits(m.latch for m in mechanisms),
            MountDynamics.of(mechanisms),
            rig.substeps,
            rates=rates,
            least_creep=0.0 if rig.settings[0].prescribed else least_creep(rig.step),
        )

    def __post_init__(self) -> None:
        object.__setattr__(self, "twists", slopes(self.poses, self.before, self.tick))
        shape = *self.poses.shape[:2], self.geometry.count
        object.__setattr__(self, "depth", np.full(shape, -1.0))
        object.__setattr__(self, "clear", np.empty(shape[:2]))
        for r, path in enumerate(zip(self.poses, self.ends, self.before, strict=True)):
            _meet(self.geometry, self.blunt, *path, self.clear[r], self.depth[r])

    def instants(self, grid: int | None) -> int:
        """Number of instants per tick to compute if readings are interpolated between ``grid``
        instants; 0: only each reading's own.
        """
        return (grid or 0) if self.mount is None else max(grid or 0, self.substeps)

    @property
    def ends(self) -> Array:
        """(R, N, 6) twist for the contact force at t_k."""
        return self.twists if self.rates is None else self.rates


@njit(cache=True)
def _meet(geometry, blunt, poses, twists, before, clear, depth):
    """Penetrations at each row, and a lower bound of the surfaces' distance in the tick that ends
    there.
    """
    count = depth.shape[1]
    frames, motions, work = np.zeros((2, 7)), np.zeros((2, 6)), np.empty((9, 7))
    p, met = np.ones((max(count, 1), PARAMETERS)), unmet(count)
    frames[1, 6] = 1.0
    p[:, BLUNT], p[:, OFFSET] = blunt, -NEAR
    longest = arm(geometry.values, count)
    last, nearest = before, -np.inf
    for k in range(len(poses)):
        copied(poses[k], frames[0])
        copied(twists[k], motions[0])
        meet_all(geometry, p, frames, motions, work, met)
        copied(met.depth, depth[k])
        now = -np.inf
        for c in range(count):
            now = max(now, depth[k, c])
        clear[k] = -max(now, nearest if k > 0 else now) - way_between(last, poses[k], longest)
        last, nearest = poses[k], now


@njit(cache=True)
def way_between(last, pose, longest):
    """Upper bound of the approach of the surfaces [m] between two poses (7,) of A; ``longest``:
    largest distance of a round from A.
    """
    way, turned = 0.0, 0.0
    for j in range(3):
        way += (pose[j] - last[j]) ** 2
        turned += (pose[3 + j] - last[3 + j]) ** 2
    return math.sqrt(way) + 2.0 * longest * math.sqrt(turned)


def slopes(poses: Array, start: Array, tick: float) -> Array:
    """``(R, N, 6)`` twists that take each pose of ``(R, N, 7)`` to the next in a tick, from
    ``start`` (R, 7) before the first.
    """
    out = np.empty((*poses.shape[:2], 6))
    _slopes(poses, start, tick, out)
    return out


@njit(cache=True)
def _slopes(poses, before, h, out):
    for r in range(poses.shape[0]):
        for k in range(poses.shape[1]):
            twist_between(before[r] if k == 0 else poses[r, k - 1], poses[r, k], h, out[r, k])
