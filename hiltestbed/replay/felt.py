"""What the lanes of a replay of contact and sensor share: the paths that A took, and the geometry along them."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.contact.geometry import Geometry, arm
from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.contact.parameters import BLUNT, LEVER, OFFSET, PARAMETERS
from hiltestbed.contact.wrench import meet_all
from hiltestbed.frames import Array, twist_between
from hiltestbed.jit import njit

KEPT = 64_000_000  # [byte] of what contacts exerted, for replays that change the sensor alone
NEAR = 2.5e-3  # [m] by which the surfaces may be nearer than believed for rows to be passed over by geometry alone

ContactKey = tuple[int, bool, bytes, bytes]  # run, whether read between instants, these within a tick, numbers of the contact


class Kept:
    """What contacts exerted in the latest replays, the latest last: at least one, else no more than :data:`KEPT`."""

    def __init__(self) -> None:
        self._exerted: OrderedDict[ContactKey, Array] = OrderedDict()
        self._size = 0  # [byte] of them all

    def get(self, key: ContactKey) -> Array | None:
        """What was exerted under ``key``, where it is still known."""
        return self._exerted.get(key)

    def keep(self, key: ContactKey, exerted: Array) -> None:
        """Keep it as the latest, and let go of the oldest."""
        before = self._exerted.pop(key, None)
        self._exerted[key] = exerted
        self._size += exerted.nbytes - (0 if before is None else before.nbytes)
        while len(self._exerted) > 1 and self._size > KEPT:
            self._size -= self._exerted.popitem(last=False)[1].nbytes


@dataclass(frozen=True)
class Felt:
    """What the lanes of a replay share: recorded paths and the mechanism that moved along them.

    Attributes:
        poses: (R, N, 7) of A in P at t_k. before: (R, 7) at t_(-1). tick: [s]. geometry: of the mechanism, both of whose sides are rigid.
        captured: (R,) bool, latched from the start. latch: (R, 3) least depth [m], cosine, speed [m/s] of the latch condition; never met
            where there is no latch. mount: of the runs, or None for a rigid one.
        substeps: instants of the physics a tick, at which a compliant mount is integrated.
        lever: where in the overlap the force acts. rates: (R, N, 6) twist at t_k, where it is known, as under a servo; None: the slope of
            the pose over the tick that ends there.
        least_creep: [m/s per N] bounds the slope of friction from above, see :class:`hiltestbed.contact.contacts.Contacts`.
        twists: (R, N, 6) over the tick that ends at each row. clear: (R, N) least distance of the surfaces in that tick [m].
        kept: what contacts exerted in the latest replays.
        met: geometry at t_k while nothing is tilted and the surfaces are near, see :func:`hiltestbed.contact.wrench.meet_all`: it does
            not depend on what the law is thought to be.
    """

    poses: Array
    before: Array
    tick: float
    geometry: Geometry
    captured: np.ndarray
    latch: Array
    mount: MountDynamics | None
    substeps: int
    lever: float = 0.5
    blunt: float = 1.0
    rates: Array | None = None
    least_creep: float = 0.0
    twists: Array = field(init=False)
    clear: Array = field(init=False)
    met: tuple[Array, Array, Array, Array, Array] = field(init=False)
    kept: Kept = field(default_factory=Kept, init=False, repr=False)

    def __post_init__(self) -> None:
        runs, rows = self.poses.shape[:2]
        count = self.geometry.count
        twists, clear = np.empty((runs, rows, 6)), np.empty((runs, rows))
        scalars, vectors = (runs, rows, count), (runs, rows, count, 3)
        met = (np.full(scalars, -1.0), np.zeros(scalars), np.zeros(vectors), np.zeros(vectors), np.zeros(vectors))
        _slopes(self.poses, self.before, self.tick, twists)
        object.__setattr__(self, "twists", twists)
        _meet(*self.geometry, self.lever, self.blunt, self.poses, self.ends, self.before, clear, *met)
        object.__setattr__(self, "clear", clear)
        object.__setattr__(self, "met", met)

    def instants(self, grid: int | None) -> int:
        """How many instants a tick are computed where a reading lies on straight lines between ``grid`` of them; 0: only its own."""
        return (grid or 0) if self.mount is None else max(grid or 0, self.substeps)

    @property
    def ends(self) -> Array:
        """(R, N, 6) twist with which the contact is felt at t_k."""
        return self.twists if self.rates is None else self.rates


@njit(cache=True)
def _meet(index, values, lever, blunt, poses, twists, before, clear, depth, rate, point, normal, slip):
    """Geometry of the rows at which the surfaces may touch, and how far they stay apart in the tick that ends at each row."""
    count = depth.shape[2]
    frames, motions, work, p = np.zeros((2, 7)), np.zeros((2, 6)), np.empty((9, 7)), np.ones((max(count, 1), PARAMETERS))
    frames[1, 6] = 1.0
    p[:, LEVER], p[:, BLUNT], p[:, OFFSET] = lever, blunt, -NEAR
    longest = arm(values, count)
    for r in range(poses.shape[0]):
        nearest = -np.inf
        for k in range(poses.shape[1]):
            frames[0], motions[0] = poses[r, k], twists[r, k]
            meet_all(index, values, p, frames, motions, work, depth[r, k], rate[r, k], point[r, k], normal[r, k], slip[r, k])
            last = before[r] if k == 0 else poses[r, k - 1]
            now = -np.inf
            for c in range(count):
                now = max(now, depth[r, k, c])
            clear[r, k] = -max(now, nearest if k > 0 else now) - way_between(last, poses[r, k], longest)
            nearest = now


@njit(cache=True)
def way_between(last, pose, longest):
    """By how much the surfaces may come nearer between two poses (7,) of A [m]; ``longest``: from A to what touches."""
    way, turned = 0.0, 0.0
    for j in range(3):
        way += (pose[j] - last[j]) ** 2
        turned += (pose[3 + j] - last[3 + j]) ** 2
    return math.sqrt(way) + 2.0 * longest * math.sqrt(turned)


@njit(cache=True)
def _slopes(poses, before, h, out):
    for r in range(poses.shape[0]):
        for k in range(poses.shape[1]):
            twist_between(before[r] if k == 0 else poses[r, k - 1], poses[r, k], h, out[r, k])
