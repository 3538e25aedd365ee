"""Data shared by the lanes of a replay of contact and sensor: the paths of A, and the contact
geometry along them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.contact.geometry import Geometry, arm
from hiltestbed.contact.mount_dynamics import MountDynamics
from hiltestbed.contact.parameters import BLUNT, LEVER, OFFSET, PARAMETERS
from hiltestbed.contact.wrench import meet_all
from hiltestbed.frames import Array, twist_between

# [byte] of contact wrenches that are cached, for replays that change only the sensor
KEPT = 64_000_000
# [m] largest shift of the surfaces, relative to nominal, for which rows can be skipped by their
# geometry alone
NEAR = 2.5e-3

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
        lever: point of application of the force within the overlap. rates: (R, N, 6) twist at t_k
            if known, as with a servo; None: the mean twist over the tick that ends there.
        least_creep: [m/s per N] limits the slope of friction, see
            :class:`hiltestbed.contact.contacts.Contacts`.
        leapfrog: whether a mount is integrated to second order, instead of as by MuJoCo. hastened:
            number of the touch of a run, from 1, that then is taken to be earlier by one standard
            deviation of an instant within a step; 0: none.
        twists: (R, N, 6) mean over the tick that ends at each row. clear: (R, N) lower bound of the
            surfaces' distance in that tick [m].
        kept: cached contact wrenches of the latest replays.
        met: contact geometry at t_k without tilt, while the surfaces are near, see
            :func:`hiltestbed.contact.wrench.meet_all`: it does not depend on the hypothesis about
            the force law.
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
    leapfrog: bool = False
    hastened: int = 0
    twists: Array = field(init=False)
    clear: Array = field(init=False)
    met: tuple[Array, Array, Array, Array, Array] = field(init=False)
    kept: Kept = field(default_factory=Kept, init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "twists", slopes(self.poses, self.before, self.tick))
        met, clear = zip(*(self._met(r) for r in range(len(self.poses))), strict=True)
        object.__setattr__(self, "met", tuple(np.stack(one) for one in zip(*met, strict=True)))
        object.__setattr__(self, "clear", np.stack(clear))

    def _met(self, r: int) -> tuple[tuple[Array, ...], Array]:
        rows, count = self.poses.shape[1], self.geometry.count
        depth, rate, clear = np.full((rows, count), -1.0), np.zeros((rows, count)), np.empty(rows)
        met = depth, rate, *(np.zeros((rows, count, 3)) for _ in range(3))
        levers = (self.lever, self.blunt)
        _meet(tuple(self.geometry), levers, self.poses[r], self.ends[r], self.before[r], clear, met)
        return met, clear

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
def _meet(geometry, levers, poses, twists, before, clear, met):
    """Contact geometry at each row, and a lower bound of the surfaces' distance in the tick that
    ends there.
    """
    index, values = geometry
    depth, rate, point, normal, slip = met
    count = depth.shape[1]
    frames, motions, work = np.zeros((2, 7)), np.zeros((2, 6)), np.empty((9, 7))
    p = np.ones((max(count, 1), PARAMETERS))
    frames[1, 6] = 1.0
    p[:, LEVER], p[:, BLUNT] = levers
    p[:, OFFSET] = -NEAR
    longest = arm(values, count)
    last, nearest = before, -np.inf
    for k in range(len(poses)):
        frames[0], motions[0] = poses[k], twists[k]
        row = depth[k], rate[k], point[k], normal[k], slip[k]
        meet_all(index, values, p, frames, motions, work, *row)
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
